"""The tube that safety.clear proves, looked at again: random arms beside their path, late, in either stop, from any instant.

Clearance is measured by Clearance.distances at postures that this file makes up by itself from the samples that were sent.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.injection import AT_REST, Trouble, inject
from benchmarks.sines import sines
from drivers.driver import DeviceStop
from safety.braking import stop_profile
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.limits import sampled
from sim.arm import Arm, load_arm
from sim.cell import Cell, PayloadTable, load_cell
from sim.errors import SafetyStop
from sim.trajectory import Trajectory

RATE = 500.0
HEAVY = PayloadTable(mass=10.0, com=[0.0, 0.0, 0.0])


# the forearm stands up: stretched out, the elbow cannot hold 10 kg for every mass of the parameter box
RAISED = [0.0, -1.8, 0.6, -1.2, -1.3, 0.3]


def loaded(cell: Cell, load: PayloadTable) -> Cell:
    return replace(cell, table=cell.table.model_copy(update={"payload": load, "home": RAISED}))


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def posture(motion: ClearedTrajectory, arm: Arm, stop: DeviceStop, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Where an arm may be: in the motion, or some time into a stop that begins at any instant; and the room that was proved there."""
    path = Trajectory(motion.t, motion.q, motion.dq, motion.ddq)
    t = rng.uniform(0, motion.t[-1] - 1e-3)
    k = min(int(t * motion.rate), len(motion) - 2)
    room = float(min(motion.room[k], motion.room[k + 1]))
    kind = rng.integers(3)
    if kind == 0:
        return sampled(path, np.array([t, t + 1e-6])).q[0], room
    if kind == 1:
        profile = stop_profile(motion.dq[k : k + 1], motion.ddq[k : k + 1], motion.braking, arm.jerk_max)
        return motion.q[k] + profile.travel(rng.uniform(0, 1) * profile.duration.max())[0], room
    begin = sampled(path, np.array([t, t + 1e-6]))
    q, dq = begin.q[0], begin.dq[0]
    deceleration = stop.deceleration * rng.uniform(motion.verdict.device_braking, 1.0)
    braking = np.abs(dq) / deceleration
    after = rng.uniform(0, stop.reaction + motion.latency + braking.max())
    u = np.clip(after - stop.reaction - motion.latency, 0, braking)
    slowing = np.divide(u**2, 2 * braking, out=np.zeros_like(u), where=braking > 0)
    return q + dq * (min(after, stop.reaction + motion.latency) + u - slowing), room


def looked_at(arm: Arm, cell: Cell, count: int) -> list[dict[str, Any]]:
    """Margins at `count` random places of the tubes of random motions, every joint beside the path by up to the proved room."""
    rng, stop, motions = np.random.default_rng(0), DeviceStop(), []
    heavy, refused = loaded(cell, HEAVY), 0
    home = np.array(RAISED)
    clearance = Clearance(arm, heavy)
    for seed in range(12):
        try:
            motions.append(clear(sines(home, 6.0, 0.12, harmonics=2, seed=seed), arm, heavy, RATE, stop, 0.01))
        except SafetyStop:
            refused += 1
    spare = []
    for _ in range(count):
        motion = motions[int(rng.integers(len(motions)))]
        q, room = posture(motion, arm, stop, rng)
        beside = room * (rng.uniform(-1, 1, arm.n) if rng.random() < 0.5 else rng.choice((-1.0, 1.0), arm.n))
        spare.append(float(np.min(clearance.distances(q + beside) - clearance.margin)))
    found = np.array(spare)
    note = f"{len(motions)} motions with 10 kg, {refused} refused; least left beyond the margin {1e3 * found.min():.1f} mm"
    return [row(f"margins not kept in {count:,} places of the tube", int(np.sum(found < 0)), "", "0", note)]


def braking(arm: Arm, cell: Cell, repeats: int) -> list[dict[str, Any]]:
    """Over-temperature with 10 kg in plant, drive and cell: how far the plant really turned, over what was proved."""
    from benchmarks.faults import TROUBLES

    hot = next(t for t in TROUBLES if "temperature" in t.name)
    trouble: Trouble = replace(hot, payload=HEAVY)
    seen = inject(trouble, repeats, arm, loaded(cell, HEAVY))
    worst = np.degrees(max(seen.angles)) if seen.angles else float("nan")
    note = f"{len(seen.angles)} stops, {len(seen.missed)} missed; largest {worst:.2f} deg of {np.degrees(seen.bound):.2f} proved; at rest below {AT_REST:g} rad/s"
    return [row("stop angle over proved angle, 10 kg", f"{max(seen.angles) / seen.bound:.2f}", "", "<= 1.0", note)]


def run(count: int = 10_000, repeats: int = 40) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell("mock-ur10e")
    arm = load_arm(cell.table.arm)
    return [*looked_at(arm, cell, count), *braking(arm, cell, repeats)]
