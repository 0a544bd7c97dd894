"""The demo on the mock arm: an effect is drawn at random, hidden in the arm, and searched for with the ordinary commands.

The effect is in the [emulation] table of a cell file, which only the mock driver reads. The commands know only what the recordings
show.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from calib.claims.diagnosis_sentences import quantity
from calib.validation.tracking import Tracking, tracked
from drivers.preflight import GRAVITY_TOLERANCE
from safety.plan import load_plan
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell
from sim.effects import checked, effect_named, with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

Draw = Callable[[np.random.Generator, Arm, int, float], dict[str, float]]  # (rng, arm, joint, angle at home) -> parameters
# share of the tolerance of `calib check` at rest: above the tolerance the demo would end at step 1, where a forgotten tool is suspected
# (a much stronger spring would end it at step 3: the guard stops an arm whose torques are far from those expected)
UNSEEN_AT_REST = 0.8


def _share_of_torque(parameter: str, least: float, most: float, **others: float) -> Draw:
    """Draw `parameter` between `least` and `most` times the joint's maximum torque."""

    def draw(rng: np.random.Generator, arm: Arm, joint: int, home: float) -> dict[str, float]:
        return {parameter: float(arm.tau_max[joint]) * rng.uniform(least, most), **others}

    return draw


# Effects that may be hidden, and their size. For an easy first case they are clearly above the noise of a two-minute recording, and no
# refit of the ordinary parameters (friction, masses, reflected inertia) absorbs them.
HIDDEN: dict[str, Draw] = {
    "payload": lambda rng, arm, joint, home: {
        "mass": rng.uniform(1.5, 3),
        "com_x": 0.0,
        "com_y": 0.0,
        "com_z": rng.uniform(0.02, 0.08),
    },
    "torque_offset": _share_of_torque("offset", 0.02, 0.04),
    "joint_spring": lambda rng, arm, joint, home: {
        "stiffness": float(arm.tau_max[joint]) * rng.uniform(0.03, 0.06),
        "rest_angle": home + rng.uniform(-0.5, 0.5),
    },
    "torque_ripple": _share_of_torque("amplitude", 0.02, 0.04, cycles=10.0, phase=0.5),
    "torque_gain": lambda rng, arm, joint, home: {"gain": rng.uniform(1.1, 1.2)},
}
# Hz: half the arm's own rate, which halves the time for recording and diagnosing the same two minutes
RATE = 250.0
WHOLE_ARM = ("payload",)
EXPECTED = "A poor result is expected while an effect is missing; step 6 searches for it."


def hide(arm: Arm, home: np.ndarray, seed: int) -> ArmEffect:
    """Draw the effect to hide from `seed`: its name, joint and parameters.

    The parameters are drawn again while `calib check` would notice the effect in the torques at rest at `home`, (n,) rad.
    """
    rng = np.random.default_rng(seed)
    name = str(rng.choice(list(HIDDEN)))
    joint = int(rng.integers(1, 4))  # these joints carry weight; without it a gain looks like friction
    while True:
        parameters = {key: float(f"{value:.4g}") for key, value in HIDDEN[name](rng, arm, joint, home[joint]).items()}
        hidden = checked(arm, ArmEffect(name, None if name in WHOLE_ARM else arm.joint_names[joint], parameters))
        if np.all(np.abs(torque_at_rest(arm, home, hidden)) <= UNSEEN_AT_REST * GRAVITY_TOLERANCE * arm.tau_max):
            return hidden


def under_control(arm: Arm, hidden: ArmEffect, folder: Path, diagnosis: Mapping[str, Any]) -> dict[str, Tracking]:
    """Tracking of the validation motion by the arm with the hidden effect, for a controller with the nominal, calibrated or true model."""
    place = folder / "diagnosis" / str(diagnosis["arm_out"]) if diagnosis.get("arm_out") else folder / "fit" / "arm"
    truth = with_effect(arm, hidden)
    motion = next(m.trajectory for m in load_plan(folder / "plan").motions if m.name == "validation")
    models = {"nominal": arm, "calibrated": load_arm(str(place)), "true arm": truth}
    return {name: tracked(truth, model, arm, motion) for name, model in models.items()}


def torque_at_rest(arm: Arm, home: np.ndarray, hidden: ArmEffect) -> np.ndarray:
    """tau(arm with `hidden`) - tau(arm) at rest at `home`, (n,) N m."""
    still = np.zeros((2, len(home)))
    motion = Trajectory(np.array([0.0, 1.0]), np.tile(home, (2, 1)), still, still)
    difference: np.ndarray = (predict(with_effect(arm, hidden), motion) - predict(arm, motion))[-1]
    return difference


def write_cell(file: Path, cell: Cell, hidden: ArmEffect, seed: int) -> None:
    """Write `cell` with an effect hidden in its arm and a rate of `RATE` Hz as a cell file."""
    data = tomllib.loads(cell.path.read_text(encoding="utf-8"))
    effect: dict[str, Any] = {"effect": hidden.effect, "parameters": hidden.parameters}
    if hidden.joint is not None:
        effect["joint"] = hidden.joint
    data |= {"name": file.stem, "options": {"rate": RATE}, "emulation": {"seed": seed, "effects": [effect]}}
    file.write_text(tomli_w.dumps(data), encoding="utf-8")


@dataclass(frozen=True)
class DemoStep:
    """One command of the demo: its reason, its arguments, the exit codes after which the demo continues, and what exit code 1 means then."""

    why: str
    arguments: tuple[str, ...]
    fine: tuple[int, ...] = (0,)
    if_poor: str = ""


def story(arm: str, cell: Path, folder: Path) -> list[DemoStep]:
    """The commands in order; everything that they write is below `folder`."""
    plan, logs, fit = str(folder / "plan"), folder / "logs", folder / "fit"
    recorded = [str(logs / "friction.mcap"), str(logs / "excitation.mcap")]
    held_out = str(logs / "validation.mcap")
    return [
        DemoStep("Check the arm before anything moves.", ("check", str(cell), "--seconds", "1")),
        DemoStep(
            "Plan motions that excite all parameters of the arm.",
            ("plan", arm, "--cell", str(cell), "--quick", "--out", plan),
        ),
        DemoStep(
            "Verify every motion against limits and collisions, then run it under supervision and record.",
            ("record", str(cell), plan, "--yes", "--out", str(logs)),
        ),
        DemoStep(
            "Fit the ordinary parameters: friction, masses, inertias.",
            ("identify", arm, *recorded, "--holdout", held_out, "--out", str(fit)),
            (0, 1),
            EXPECTED,
        ),
        DemoStep(
            "Test the fitted arm on a motion that the fit has not seen, by torque and by forward simulation.",
            ("validate", str(fit / "arm"), held_out, "--out", str(folder / "check")),
            (0, 1),
            EXPECTED,
        ),
        DemoStep(
            "Identify the effect behind what no ordinary parameter explains.",
            ("diagnose", arm, *recorded, "--holdout", held_out, "--out", str(folder / "diagnosis")),
            (0, 1),
        ),
    ]


@dataclass(frozen=True)
class Reveal:
    """Hidden and found effects. rows: effect, joint, parameter, hidden value, found value, with units; None for a missing value."""

    rows: list[list[Any]]
    right: bool
    sentence: str


def reveal(hidden: ArmEffect, diagnosis: Mapping[str, Any]) -> Reveal:
    """Compare `hidden` with the content of diagnosis.json."""
    found = {(e["effect"], e["joint"]): e["parameters"] for e in diagnosis["effects"]}
    key = hidden.key
    units = {p.name: p.unit for p in effect_named(hidden.effect).parameters}
    rows: list[list[Any]] = []
    for name, value in hidden.parameters.items():
        seen = found.get(key, {}).get(name)
        truth = quantity({"value": value, "unit": units[name]})
        rows.append([hidden.effect, hidden.joint or "whole arm", name, truth, quantity(seen) if seen else None])
    for (effect, joint), parameters in found.items():
        if (effect, joint) != key:
            rows += [[effect, joint or "whole arm", name, None, quantity(p)] for name, p in parameters.items()]
    others = len(found) - (key in found)
    beside = f"{others} more {'effect that was' if others == 1 else 'effects that were'} not hidden"
    rivals = {(r["effect"], r["joint"]) for e in diagnosis["effects"] for r in e.get("indistinguishable_from") or ()}
    if key not in found and key in rivals:
        sentence = "these recordings cannot distinguish the hidden effect from the identified one; `calib plan --discriminate` plans a motion that can"
    elif key not in found:
        sentence = "the hidden effect was not found; the report shows the evidence for each candidate"
    elif others:
        sentence = f"the hidden effect was found, and also {beside}"
    else:
        sentence = "the hidden effect was found, and nothing else"
    return Reveal(rows, key in found and not others, sentence)
