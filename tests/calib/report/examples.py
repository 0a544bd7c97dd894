"""Made-up data for the pages, in the form that the commands pass."""

from typing import Any

import numpy as np

JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]


def motion(samples: int = 3000) -> dict[str, Any]:
    """A held-out log in which the elbow's dry friction is 3 N m higher than in the model."""
    rng = np.random.default_rng(7)
    t = np.linspace(0, 30, samples)
    rate = 0.4 + 0.13 * np.arange(6)
    q = np.sin(np.outer(t, rate)) * 1.2
    dq = np.cos(np.outer(t, rate)) * rate * 1.2
    after = 40 * np.cos(q) / (1 + np.arange(6)) ** 1.5 + 2 * np.tanh(dq / 0.02)
    before = after.copy()
    before[:, 2] -= 3 * np.tanh(dq[:, 2] / 0.02)
    refit = after.copy()
    refit[:, 2] -= np.tanh(dq[:, 2] / 0.02)
    tau = after + rng.normal(0, 0.15, after.shape)
    return {"joint_names": JOINTS, "t": t, "q": q, "dq": dq, "tau": tau, "before": before, "refit": refit, "after": after}


def diagnosis(verdict: str = "effects_found") -> tuple[dict[str, Any], dict[str, Any]]:
    """diagnosis.json and its evidence for a verdict."""
    evidence = motion()
    gap = {k: np.sqrt(np.mean((evidence["tau"] - evidence[k]) ** 2, axis=0)).tolist() for k in ("before", "refit", "after")}
    effect = {
        "effect": "coulomb_friction",
        "joint": "elbow_joint",
        "parameters": {"coulomb": {"value": 8.213, "std": 0.041, "nominal": 5.2, "unit": "N*m"}},
        "confidence": 0.98,
        "gap_share": 0.93,
        "indistinguishable_from": [],
        "experiment": None,
    }
    data: dict[str, Any] = {
        "schema": "diagnosis/1",
        "arm": "ur10e",
        "verdict": verdict,
        "effects": [effect] if verdict == "effects_found" else [],
        "unexplained": [],
        "gap": {"unit": "N*m", "log": "validation.mcap", "held_out": True, "joints": JOINTS, "noise_floor": [0.15] * 6, **gap},
        "data_checks": [{"check": "gaps", "ok": True, "detail": "no sample is missing"}],
        "arm_out": "arm",
    }
    evidence["candidates"] = [
        ("coulomb_friction", "elbow_joint", 4100.0),
        ("asymmetric_friction", "elbow_joint", 120.0),
        ("payload", None, 3.0),
    ]
    evidence["threshold"] = 30.0
    loops = ((0.25, "open"), (1.0, "open"), (5.0, "closed"))
    data["motion"] = [
        {
            when: {"horizon_s": seconds, "loop": loop, "angle_rad": [error] * 6, "flange_m": error}
            for when, error in (("before", 0.02), ("after", 0.002))
        }
        for seconds, loop in loops
    ]
    if verdict == "unexplained":
        data["unexplained"] = [
            {"joint": "elbow_joint", "depends_on": ["q:elbow_joint", "dq:wrist_1_joint"], "rms": 1.2, "unit": "N*m"}
        ]
    if verdict == "bad_data":
        data["data_checks"] = [{"check": "time", "ok": False, "detail": "time runs backwards at sample 812"}]
        data["gap"] |= {"noise_floor": [], "before": [], "refit": [], "after": []}
        evidence = {}
    return data, evidence
