"""Effects hidden in the mock, over the catalogue and the shipped arms: is the hidden effect identified, and nothing else?

`python -m benchmarks mock_effects`: five sessions of each effect, distributed over the shipped arms, recorded and diagnosed as
those of `clean_mock`. The joint and the size are drawn: the torque that the effect adds to the joint is 1 to 4 times the
noise of a reading (RMS), as far as the effect stays plausible. Dry and viscous friction and reflected inertia are not hidden:
on a shipped arm they are free, and a new value of one is no effect. A run continues where the last one stopped
(build/mock_effects.jsonl), for `minutes` at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from benchmarks.clean_mock import recorded
from benchmarks.kept import FOLDER, Kept
from benchmarks.known_truth import fitting_motion
from benchmarks.results import digest
from benchmarks.sliced import findings
from calib import demo
from calib.diagnosis.diagnose import diagnose
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import checked, with_effect
from sim.prediction import predict
from sim.resources import shipped_configs

SESSIONS = 5  # of each effect
LEAST, MOST = 1.0, 4.0  # torque that an effect adds, over the noise of a reading
EVERY, WEIGHTY, WRISTS, LIGHT = range(6), (1, 2, 3), (3, 4, 5), (0, 3, 4)
TURNING = ("phase", "cycles")  # of a sine, which another pair describes nearly as well
MEASURES = ("benchmarks.mock_effects",)
Values = dict[str, float]
# values at a size, near 1 at first, for an arm, a joint, and drawn numbers
Make = Callable[[float, Arm, int, np.random.Generator], Values]


@dataclass(frozen=True)
class Hidden:
    """An effect, the joints at which it may be hidden (none: the whole arm), its parameters at a size, and the largest size."""

    name: str
    joints: Sequence[int]
    values: Make
    most: float = 4.0


def _share(parameter: str, share: float, **others: tuple[float, float]) -> Make:
    """`share` of the joint's largest torque per unit of size; `others` drawn between two values."""

    def make(size: float, arm: Arm, j: int, rng: np.random.Generator) -> Values:
        drawn = {key: float(rng.uniform(*ends)) for key, ends in others.items()}
        return {parameter: size * share * float(arm.tau_max[j]), **drawn}

    return make


def _plain(**values: float) -> Make:
    """Values in proportion to the size."""
    return lambda size, arm, j, rng: {key: size * value for key, value in values.items()}


def _link(size: float, arm: Arm, j: int, rng: np.random.Generator) -> Values:
    com = arm.tree.com[j].tolist()
    return {"mass": float(arm.tree.mass[j]) * (1 + 0.1 * size), **dict(zip(("com_x", "com_y", "com_z"), com, strict=True))}


def _saturation(size: float, arm: Arm, j: int, rng: np.random.Generator) -> Values:
    motion = fitting_motion(arm, int(rng.integers(1000)))
    return {"limit": float(np.abs(predict(arm, motion)[:, j]).max()) / (1 + 0.2 * size)}


HIDDEN = (
    Hidden("asymmetric_friction", EVERY, _share("half_difference", 0.02)),
    Hidden("stribeck_friction", EVERY, _share("stiction_excess", 0.05, stribeck_velocity=(0.06, 0.22))),
    Hidden("nonlinear_viscous_friction", EVERY, _share("coefficient", 0.03, exponent=(1.8, 2.6))),
    Hidden("load_dependent_friction", WEIGHTY, _plain(coefficient=0.08)),
    Hidden("thermal_friction", EVERY, lambda size, arm, j, rng: {"relative_drop": min(0.3 * size, 0.8), "time_constant": rng.uniform(8, 30)}),
    Hidden("presliding_friction", EVERY, lambda size, arm, j, rng: {"stiffness": float(arm.tau_max[j]) / size}),
    Hidden("joint_elasticity", (0, 1, 2, 3), lambda size, arm, j, rng: {"stiffness": 40 * float(arm.tau_max[j]) / size}),
    Hidden("backlash", LIGHT, _plain(half_gap=2e-3), 2.0),
    Hidden("torque_ripple", EVERY, _share("amplitude", 0.03, cycles=(3.0, 12.0), phase=(-3.0, 3.0))),
    Hidden("joint_spring", EVERY, _share("stiffness", 0.04, rest_angle=(-1.0, 1.0))),
    Hidden("torque_gain", WEIGHTY, lambda size, arm, j, rng: {"gain": 1 + 0.08 * size}),
    Hidden("torque_offset", EVERY, _share("offset", 0.02)),
    Hidden("torque_saturation", WEIGHTY, _saturation),
    Hidden("encoder_offset", WEIGHTY, _plain(offset=0.02)),
    Hidden("encoder_eccentricity", WEIGHTY, lambda size, arm, j, rng: {"amplitude": 0.02 * size, "cycles": float(rng.integers(1, 3)), "phase": rng.uniform(-3, 3)}),
    Hidden("time_delay", (), _plain(delay=4e-3)),
    Hidden("payload", (), lambda size, arm, j, rng: {"mass": 0.05 * size * float(arm.tree.mass.sum()), "com_x": rng.uniform(-0.04, 0.04), "com_y": rng.uniform(-0.04, 0.04), "com_z": rng.uniform(0.02, 0.1)}),
    Hidden("link_inertia", WEIGHTY, _link),
    Hidden("base_tilt", (), _plain(roll=0.02, pitch=-0.015)),
    Hidden("tool_force", (), lambda size, arm, j, rng: {f"force_{x}": 0.02 * size * float(arm.tau_max[2]) * f for x, f in zip("xyz", rng.uniform(-1, 1, 3), strict=True)}),
    Hidden("transmission_coupling", WRISTS, lambda size, arm, j, rng: {"ratio": 1.0, "inertia": 0.02 * size * float(arm.tau_max[j] / arm.ddq_max[j]), "viscous": 0.05 * size * float(arm.tau_max[j] / arm.dq_max[j]), "coulomb": 0.02 * size * float(arm.tau_max[j])}),
)  # fmt: skip


def drawn(effect: Hidden, arm: Arm, seed: int) -> tuple[ArmEffect, float]:
    """An instance of the effect, and the torque it adds along the first motion of the session over the noise (RMS, strongest joint)."""
    rng = np.random.default_rng([seed, 7])
    joint = int(rng.choice(effect.joints)) if effect.joints else None
    wanted, size = float(np.exp(rng.uniform(np.log(LEAST), np.log(MOST)))), 1.0
    motion = fitting_motion(arm, 1000 + 10 * seed)
    without, j, own = predict(arm, motion), joint or 0, int(rng.integers(1 << 30))
    for _ in range(8):
        values = {k: float(f"{v:.4g}") for k, v in effect.values(size, arm, j, np.random.default_rng(own)).items()}
        item = checked(arm, ArmEffect(effect.name, None if joint is None else arm.joint_names[j], values))
        added = (predict(with_effect(arm, item), motion) - without) / np.array(arm.sensors.torque_noise)
        seen = float(np.sqrt(np.mean(added**2, axis=0)).max())
        if 0.9 < seen / wanted < 1.1:
            break
        size = min(size * float(np.clip(wanted / max(seen, 1e-6), 0.25, 4.0)), effect.most)
    return item, seen


def session(name: str, effect: Hidden, seed: int) -> dict[str, Any]:
    """Hide, record and diagnose: what was hidden, the names found, the verdict, and per parameter (found - true) / std."""
    arm = load_arm(name)
    item, seen = drawn(effect, arm, seed)
    held = recorded(with_effect(arm, item), arm, seed)
    answer = diagnose(arm, held[:2], held[2:]).answer
    revealed = demo.reveal(item, answer)
    own = next((e["parameters"] for e in answer["effects"] if (e["effect"], e["joint"]) == item.key), {})
    scores = {k: (p["value"] - item.parameters[k]) / p["std"] for k, p in own.items() if p.get("std")}
    rivals = [[r["effect"], r["joint"]] for e in answer["effects"] for r in e.get("indistinguishable_from") or ()]
    return {
        "arm": name, "hidden": [*item.key], "parameters": item.parameters, "seen": seen, "right": revealed.right, "scores": scores,
        "names": [[e["effect"], e["joint"]] for e in answer["effects"]], "rivals": rivals, "verdict": answer["verdict"],
        "unexplained": [u["joint"] for u in answer["unexplained"]], "refused": answer["refused"],
    }  # fmt: skip


def run(minutes: float = 10.0, count: int = SESSIONS) -> list[dict[str, Any]]:
    """Run sessions for `minutes`; return rows (what, value, unit, bar, note) over all sessions finished so far."""
    kept = Kept(FOLDER / "mock_effects.jsonl", " ".join(digest(path) for path in MEASURES))
    arms = sorted(folder.name for folder in (shipped_configs() / "arms").iterdir())
    jobs = {}
    for k in range(count * len(HIDDEN)):
        effect, seed = HIDDEN[k % len(HIDDEN)], 500 + k
        jobs[f"{effect.name} {seed}"] = partial(session, arms[seed % len(arms)], effect, seed)
    return rows(list(findings(jobs, kept, minutes).values()), len(jobs))


def rows(found: Sequence[Mapping[str, Any]], count: int) -> list[dict[str, Any]]:
    """Rows over the finished sessions: all, then by effect."""
    total, what = len(found), "mock, an effect hidden"
    alone = sum(f["right"] for f in found)
    named = sum(f["hidden"] in f["names"] for f in found)
    either = sum(f["hidden"] in f["names"] + f["rivals"] for f in found)
    wrong = [f for f in found if _wrong(f)]
    by_name = sum(any(name != f["hidden"] for name in f["names"]) for f in found)
    silent = sum(not f["names"] for f in found)
    scores = [abs(x) for f in found for key, x in f["scores"].items() if key not in TURNING]
    out: list[dict[str, Any]] = [
        {"what": f"{what}: sessions", "value": total, "bar": str(count), "note": f"{len({f['arm'] for f in found})} shipped arms, {len({f['hidden'][0] for f in found})} effects"},
        {"what": f"{what}: it is identified, and nothing else", "value": round(100 * alone / total, 1), "unit": "%"},
        {"what": f"{what}: it is identified", "value": round(100 * named / total, 1), "unit": "%", "note": f"{100 * either / total:.1f} % with the effects listed as indistinguishable from the identified ones"},
        {"what": f"{what}: nothing is named", "value": round(100 * silent / total, 1), "unit": "%"},
        {"what": f"{what}: sessions with a wrong name", "value": round(100 * len(wrong) / total, 1), "unit": "%", "bar": "<= 3", "note": "; ".join(_confused(f) for f in wrong)},
        {"what": f"{what}: ... also where the hidden effect is listed as indistinguishable", "value": round(100 * by_name / total, 1), "unit": "%"},
    ]  # fmt: skip
    if scores:
        out.append({"what": f"{what}: parameters within 2 standard deviations of the hidden value", "value": round(100 * float(np.mean(np.array(scores) <= 2)), 1), "unit": "%", "note": f"{len(scores)} parameters, without the phase and the cycles of a sine"})  # fmt: skip
    for effect in HIDDEN:
        mine = [f for f in found if f["hidden"][0] == effect.name]
        missed = [_confused(f) for f in mine if not f["right"]]
        if mine:
            out.append(
                {
                    "what": f"{what}: {effect.name}",
                    "value": f"{len(mine) - len(missed)} of {len(mine)} right",
                    "note": "; ".join(missed),
                }
            )
    return out


def _wrong(f: Mapping[str, Any]) -> bool:
    """Whether an effect is named that was not hidden; a single one is not wrong if the hidden one is listed as indistinguishable."""
    return any(name != f["hidden"] for name in f["names"]) and not (len(f["names"]) == 1 and f["hidden"] in f["rivals"])


def _confused(f: Mapping[str, Any]) -> str:
    """What was hidden in a session, and what was found."""
    hidden, *names = (" at ".join(filter(None, name)) for name in [f["hidden"], *f["names"]])
    return f"{f['arm']}: {hidden}, found {', '.join(names) or _without(f)}"


def _without(f: Mapping[str, Any]) -> str:
    """The verdict of a session without names, and the effects that were fitted and refused."""
    refused = "; ".join(text.partition(" was fitted")[0] for text in f["refused"])
    return f["verdict"].replace("_", " ") + (f" ({refused} refused)" if refused else "")
