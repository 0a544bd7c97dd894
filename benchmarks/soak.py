"""False stops and missed faults on rough arms: backlash, elasticity, a spring, every parameter 10 % wrong; simulated time.

Each arm is driven through cleared motions in sections of SECTION s until it has moved for `each` minutes. The faults FAULTS are
injected in turn, one per section. A run continues where the last one stopped (build/soak.jsonl), for `minutes` at a time: `make
soak`.
"""

from __future__ import annotations

import time
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from benchmarks.faults import TROUBLES
from benchmarks.injection import Injection
from benchmarks.kept import FOLDER, Kept
from benchmarks.reaction import RATE, SETTLE, Run
from benchmarks.results import digest
from benchmarks.sines import sines
from drivers.mock import MockDriver
from safety import ClearedTrajectory, MotionStopped, clear
from safety.collision import Clearance
from safety.guard import Guard
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell, load_cell
from sim.clock import SimulatedClock
from sim.effects import with_effect
from sim.errors import SafetyStop
from sim.plant import Plant

MEASURES = ("benchmarks.soak",)
ARMS = ("ur10e", "ur5e", "ur3e", "ur16e", "ur20", "servo6")
SECTION = 60.0
WRONG = 0.1
# faults for a rough arm: those that must stop it and need no plant of their own
FAULTS = tuple(t for t in TROUBLES if t.stops and t.plant is None)
# following error that the cell states: a soft gear and a spring are beside the drive's own encoder
FOLLOWING = 0.02
HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def rough(arm: Arm, seed: int = 0) -> Arm:
    """The truth: every mass, centre of mass, inertia and effect parameter 10 % wrong, plus elasticity, backlash and a spring.

    The three are at three different joints.
    """
    rng, tree = np.random.default_rng(seed), arm.tree

    def off(*shape: int) -> np.ndarray:
        return 1 + WRONG * rng.choice((-1.0, 1.0), shape)

    n = arm.n
    inertia = tree.inertia * off(n)[:, None, None]
    truth = replace(arm, tree=replace(tree, mass=tree.mass * off(n), com=tree.com * off(n)[:, None], inertia=inertia))
    for item in arm.effects:
        truth = with_effect(
            truth, replace(item, parameters={key: value * float(off(1)[0]) for key, value in item.parameters.items()})
        )
    soft, loose, sprung = rng.choice(n, 3, replace=False)
    names, most = arm.joint_names, arm.tau_max
    # gear twist of 5 mrad at the largest torque, a gap of 1 mrad, a spring with a tenth of the largest torque at 1 rad
    truth = with_effect(truth, ArmEffect("joint_elasticity", names[soft], {"stiffness": float(most[soft] / 5e-3)}))
    truth = with_effect(truth, ArmEffect("backlash", names[loose], {"half_gap": 5e-4}))
    return with_effect(
        truth,
        ArmEffect("joint_spring", names[sprung], {"stiffness": 0.1 * float(most[sprung]), "rest_angle": float(HOME[sprung])}),
    )


def plant_of(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant:
    """The rough arm with a drive that knows the nominal one; a different arm for each `at`."""
    return Plant(rough(arm, at), drive=arm, seed=at, obstacles=cell.table.obstacles)


def section(arm: Arm, cell: Cell, number: int) -> dict[str, Any]:
    """One section of one arm: s of motion, and the message of a stop, if any."""
    clearance, rng = Clearance(arm, cell), np.random.default_rng(number)
    motions: list[ClearedTrajectory] = []
    for size in rng.permutation((0.1, 0.2, 0.3)):
        for seed in rng.integers(1_000_000, size=3).tolist():
            try:
                motions.append(
                    clear(sines(HOME, SECTION / 6, float(size), harmonics=4, seed=seed), arm, cell, RATE, clearance=clearance)
                )
            except SafetyStop:
                continue
    driver = MockDriver(
        Plant(rough(arm, number), drive=arm, seed=number, obstacles=cell.table.obstacles),
        arm,
        RATE,
        SimulatedClock(),
        start=HOME,
    )
    driver.connect()
    for _ in range(SETTLE):
        driver.read()
    moved = 0.0
    try:
        with Guard(driver, arm, cell, clearance) as guard:
            while moved < SECTION and motions:
                motion = motions[int(rng.integers(len(motions)))]
                guard.run(motion, "soak")
                moved += len(motion) / RATE
    except (MotionStopped, SafetyStop) as stop:
        return {"seconds": moved, "stopped": str(stop)}
    return {"seconds": moved, "stopped": None}


def run(minutes: float = 10.0, each: float = 30.0) -> list[dict[str, Any]]:
    """Measure for `minutes`; return rows (what, value, unit, bar, note) over everything found so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "soak.jsonl", " ".join(digest(path) for path in MEASURES))
    base = load_cell("mock-ur10e")
    motion = base.table.motion.model_copy(update={"following_error": FOLLOWING})
    cell = replace(base, table=base.table.model_copy(update={"motion": motion}))
    arms = {name: load_arm(name) for name in ARMS}
    for number in range(round(60 * each / SECTION)):
        for name, arm in arms.items():
            if (what := f"{name} section {number}") not in kept.found and time.monotonic() < end:
                kept.keep(what, section(arm, cell, number))
            fault = FAULTS[number % len(FAULTS)]
            if (what := f"{name} fault {number} {fault.name}") not in kept.found and time.monotonic() < end:
                kept.keep(what, asdict(Injection(replace(fault, plant=plant_of), arm, cell, (0.2, 0.12)).run(number)))
    return [row for name in ARMS for row in rows(name, kept.found, each)]


def rows(name: str, found: dict[str, Any], each: float) -> list[dict[str, Any]]:
    """False stops and missed faults of one arm."""
    sections = [value for what, value in found.items() if what.startswith(f"{name} section")]
    faults = {what: Run(**value) for what, value in found.items() if what.startswith(f"{name} fault")}
    stops = [s["stopped"] for s in sections if s["stopped"]]
    missed = [f"{what.split(maxsplit=3)[3]}: {run.missed}" for what, run in faults.items() if run.missed]
    moved = sum(s["seconds"] for s in sections) / 60
    return [
        {
            "what": f"{name}: false stops",
            "value": len(stops),
            "bar": "0",
            "note": "; ".join([f"{moved:.1f} of {each:g} minutes", *stops[:1]]),
        },
        {
            "what": f"{name}: missed faults",
            "value": len(missed),
            "bar": "0",
            "note": "; ".join([f"{len(faults)} faults", *missed[:1]]),
        },
    ]
