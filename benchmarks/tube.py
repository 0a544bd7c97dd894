"""Independent check of the tube that safety.clear verifies: random postures off the path, late, in either stop.

Clearance is measured by Clearance.distances at postures computed here from the samples sent, at any instant. Stops with a heavy
load are driven in MuJoCo by arms at corners of the parameter box.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from benchmarks.faults import TROUBLES
from benchmarks.injection import Injection
from benchmarks.sines import sines
from drivers.driver import DeviceStop
from safety.braking import stop_profile
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.limits import sampled
from safety.parameters import PAYLOAD_DOUBT, SIGMAS, friction_of
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import Cell, PayloadTable, load_arm_of, load_cell
from sim.effects import with_effect
from sim.errors import SafetyStop
from sim.plant import Plant
from sim.trajectory import Trajectory

RATE = 500.0
HEAVY = PayloadTable(mass=10.0, com=[0.0, 0.0, 0.0])


# forearm upright: stretched out, the elbow cannot hold 10 kg for every mass in the parameter box
RAISED = [0.0, -1.8, 0.6, -1.2, -1.3, 0.3]


def loaded(cell: Cell, load: PayloadTable) -> Cell:
    return replace(cell, table=cell.table.model_copy(update={"payload": load, "home": list(RAISED)}))


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def posture(motion: ClearedTrajectory, arm: Arm, stop: DeviceStop, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """A posture where an arm may be, and the room verified there: on the path, or some time into a stop from any instant."""
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
    """Margins at `count` random places in the tubes of random motions, every joint off the path by up to the verified room."""
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


# arms that hold 10 kg for every mass in the parameter box
CARRIERS = ("ur10e", "ur12e", "ur15", "ur16e", "ur18", "ur20", "ur30", "ur10")
# rad, amplitudes tried from the largest down until enough motions are cleared
SIZES = (0.6, 0.45, 0.3, 0.2, 0.12)


def braking(repeats: int) -> list[dict[str, Any]]:
    """Stops with 10 kg in drive, cell and plant.

    The plant's masses, centres of mass, inertias, reflected inertias and friction are at corners of the parameter box.
    """
    kinds = {"our stop": "over-temperature", "the device's stop": "cable out"}
    rows, every = [], []
    for name, (kind, fault) in product(CARRIERS, kinds.items()):
        trouble = replace(next(t for t in TROUBLES if t.name == fault), payload=HEAVY, plant=at_corner)
        keys = {"share": "angle / verified", "alone": "/ commanded"} | (
            {"beside": "beside the path / room"} if kind == "our stop" else {}
        )
        what = f"10 kg, corners of the box, {name}, {kind}: {', '.join(keys.values())}"
        try:
            injection = Injection(trouble, load_arm(name), loaded(load_cell("mock-ur10e"), HEAVY), SIZES)
        except SafetyStop as refused:
            rows.append(row(what, "refused", "", "<= 1", str(refused)[:200]))
            continue
        runs = [injection.run(number) for number in range(repeats)]
        stops, missed = [r for r in runs if r.reaction is not None], [r.missed for r in runs if r.missed]
        every += runs
        value = ", ".join(f"{max((getattr(r, key) for r in stops), default=np.inf):.2f}" for key in keys)
        note = f"{len(stops)} stops of {len(runs)}, motions of {injection.size:g} rad, stops up to {np.degrees(max((r.angle for r in stops), default=0.0)):.1f} deg"
        rows.append(row(what, value, "", "<= 1", "; ".join([note, *(m[:200] for m in missed[:1])])))
    stops = [r for r in every if r.reaction is not None]
    worst = max((r.share for r in stops), default=np.inf)
    note = f"{len(stops)} stops of {len(every)} runs with {len(CARRIERS)} arms; verified is the stop's angle and the room beside it"
    alone = max((r.alone for r in stops), default=np.inf)
    beyond = np.degrees(max((r.beyond for r in stops), default=np.inf))
    return [
        row("stop angle / verified angle, 10 kg at corners of the parameter box", f"{worst:.2f}", "", "<= 1.0", note),
        row(
            "stop angle / commanded stop angle alone, 10 kg at corners",
            f"{alone:.2f}",
            "",
            "",
            f"at most {beyond:.2f} deg beyond it",
        ),
        *rows,
    ]


def at_corner(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant:
    """A plant at a random corner of the verified box; its drive has the nominal links with the declared payload.

    The drive knows the true reflected inertia: a loop tuned for another one would be unstable.
    """
    rng, load = np.random.default_rng(at), cell.table.payload
    assert load is not None
    share = 1 + PAYLOAD_DOUBT * float(rng.choice((-1, 1)))
    truth = carrying(corner(arm, rng), load.mass * share, load.com)
    drive = carrying(arm, load.mass, load.com)
    for rotor in (e for e in truth.effects if e.effect == "rotor_inertia"):
        drive = with_effect(drive, rotor)
    return Plant(truth, drive=drive, seed=at, obstacles=cell.table.obstacles)


def carrying(arm: Arm, mass: float, com: list[float]) -> Arm:
    at = dict(zip(("com_x", "com_y", "com_z"), com, strict=True))
    return with_effect(arm, ArmEffect("payload", None, {"mass": mass, **at}))


def corner(arm: Arm, rng: np.random.Generator) -> Arm:
    """Every link's mass, centre of mass and inertia, and every friction, at one end of the interval that safety.clear assumes.

    Reflected inertia is as known or at its upper end. At zero it would leave the mock's drive, whose gains scale with inertia,
    no stiffness against friction.
    """
    tree, prior = arm.tree, arm.prior
    mass, com, inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    for j in np.flatnonzero(tree.mass > 0):
        reach = float(np.linalg.norm(com[j])) + float(np.sqrt(np.trace(inertia[j]) / (2 * mass[j])))
        share = 1 + SIGMAS * prior.mass * rng.choice((-1, 1))
        com[j] = com[j] + rng.choice((-1, 1), 3) / np.sqrt(3) * SIGMAS * prior.com * reach / share
        mass[j], inertia[j] = mass[j] * share, inertia[j] * (1 + SIGMAS * prior.inertia * rng.choice((-1, 1)))
    truth, known = replace(arm, tree=replace(tree, mass=mass, com=com, inertia=inertia)), friction_of(arm)
    rows = (
        ("rotor_inertia", "inertia", known.inertia, known.inertia_doubt),
        ("coulomb_friction", "coulomb", known.coulomb, known.coulomb_doubt),
        ("viscous_friction", "viscous", known.viscous, known.viscous_doubt),
    )
    for effect, parameter, value, doubt in rows:
        for j, joint in enumerate(arm.joint_names):
            low = 0.0 if effect == "rotor_inertia" else -1.0
            at_end = max(0.0, float(value[j] + doubt[j] * rng.choice((low, 1.0))))
            truth = with_effect(truth, ArmEffect(effect, joint, {parameter: at_end}))
    return truth


def run(count: int = 10_000, repeats: int = 12) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell("mock-ur10e")
    return [*looked_at(load_arm_of(cell), cell, count), *braking(repeats)]
