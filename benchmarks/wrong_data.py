"""Recordings that are wrong in a known way: every corruption at every joint, and combinations; all from seeds."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.known_truth import fourier_motion, recorded, varied
from calib.gate import Gate
from logs import read_log
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory

SAMPLES = Path(__file__).resolve().parents[1] / "logs" / "samples"
FAMILY = ("ur3e", "ur5e", "ur10e", "ur16e", "ur20")
COUNT = 500
GEAR = 101.0


@dataclass(frozen=True)
class Case:
    """A wrong recording: the stated arm, its logs, names of the corruptions (`done`), and words that identify a right cause."""

    name: str
    arm: Arm
    logs: tuple[Log, ...]
    done: tuple[str, ...]
    right: frozenset[str]


@cache
def arm(name: str) -> Arm:
    return load_arm(name)


@cache
def base(name: str) -> tuple[Arm, Log]:
    """A good recording: a sample, or by formula an arm that differs from its model, with friction, offsets and AR(1) noise."""
    if name == "servo6 sample":
        return arm("servo6"), read_log(SAMPLES / "servo6_excitation.mcap")
    if name == "ur10e sample":
        return arm("ur10e"), read_log(SAMPLES / "ur10e_ur_rtde.csv")
    kind, seed = name.split()
    truth = varied(arm(kind), int(seed), 0.08)
    return arm(kind), recorded(truth, within(truth, fourier_motion(truth, 100 + int(seed), 24.0, 100.0)), int(seed))


def within(of: Arm, motion: Trajectory) -> Trajectory:
    """The motion about its own middle (at most 1.6 rad from zero), scaled down where it leaves a joint's range."""
    middle = np.clip(0.5 * (motion.q.min(axis=0) + motion.q.max(axis=0)), -1.6, 1.6)
    most = np.maximum(np.abs(motion.q - motion.q.mean(axis=0)).max(axis=0), 1e-6)
    by = np.minimum(1.0, 0.9 * (np.minimum(of.q_max, -of.q_min) - np.abs(middle)) / most)
    return Trajectory(motion.t, middle + by * (motion.q - motion.q.mean(axis=0)), by * motion.dq, by * motion.ddq)


BASES = ("servo6 sample", "ur10e sample", "ur5e 1", "servo6 2", "ur10e 3")


def scaled(log: Log, names: Sequence[str], factor: float, joint: int | None = None) -> Log:
    """A recording with these arrays multiplied by a factor, at one joint or at all."""
    by = np.ones(log.n)
    by[slice(None) if joint is None else joint] = factor
    return replace(log, **{name: getattr(log, name) * by for name in names})


def _swapped(log: Log, names: Sequence[str], i: int, j: int) -> Log:
    order = np.arange(log.n)
    order[[i, j]] = [j, i]
    return replace(log, **{name: getattr(log, name)[:, order] for name in names})


LOAD, MOTION = ("tau", "current"), ("q", "dq")
DEG = 180 / np.pi
Change = Callable[[Log, Arm, np.random.Generator], tuple[Log, frozenset[str]]]


def _as_current(log: Log, of: Arm, rng: np.random.Generator) -> tuple[Log, frozenset[str]]:
    """The effort that the drive reports is the current."""
    constant = of.torque_constant if of.torque_constant is not None else rng.uniform(6, 14) * np.ones(of.n)
    current = log.current if np.isfinite(log.current).any() else log.tau / constant
    words = {"tau=current"} if of.torque_constant is not None else {"scale:tau"}
    return replace(log, tau=current, current=np.full(current.shape, np.nan)), frozenset(words)


def _thousand(log: Log, of: Arm, rng: np.random.Generator) -> tuple[Log, frozenset[str]]:
    current = not np.isfinite(log.tau).any()
    return scaled(log, LOAD, 1000.0), frozenset({"current=mA" if current else "tau=mNm"})


def _shifted(log: Log, of: Arm, rng: np.random.Generator) -> tuple[Log, frozenset[str]]:
    by = float(rng.choice([-1, 1]) * rng.uniform(0.2, 1.5))
    late = {
        name: np.stack([np.interp(log.t - by, log.t, x) for x in getattr(log, name).T], axis=1)
        for name in LOAD
        if np.isfinite(getattr(log, name)).any()
    }
    return replace(log, **late), frozenset({"shift"})


def _without_gravity(log: Log, of: Arm, rng: np.random.Generator) -> tuple[Log, frozenset[str]]:
    """As reported by a controller that subtracts its own model of gravity."""
    off = RigidBody(of).gravity_torque(log.q)
    constant = np.ones(of.n) if of.torque_constant is None else of.torque_constant
    return replace(log, tau=log.tau - off, current=log.current - off / constant), frozenset({"leaves out gravity"})


def _other_zero(log: Log, of: Arm, rng: np.random.Generator, j: int, degrees: float) -> tuple[Log, frozenset[str]]:
    by = np.radians(degrees) * np.eye(log.n)[j]
    return replace(log, q=log.q + by, q_cmd=log.q_cmd + by), frozenset(
        {f"zero:q:{of.joint_names[j]}={np.radians(degrees):.7g}"}
    )


def changes(of: Arm) -> dict[str, Change]:
    """Every corruption of a recording of an arm, at every joint."""
    names = of.joint_names
    out: dict[str, Change] = {
        "degrees": lambda log, *_: (scaled(log, MOTION, DEG), frozenset({"q=deg"})),
        "positions in degrees": lambda log, *_: (scaled(log, ("q",), DEG), frozenset({"q=deg"})),
        "speeds in deg/s": lambda log, *_: (scaled(log, ("dq",), DEG), frozenset({"dq=deg/s"})),
        "speeds in rpm": lambda log, *_: (scaled(log, ("dq",), 30 / np.pi), frozenset({"dq=rpm"})),
        "ms": lambda log, *_: (replace(log, t=log.t * 1e3), frozenset({"t=ms"})),
        "us": lambda log, *_: (replace(log, t=log.t * 1e6), frozenset({"t=us"})),
        "thousandths": _thousand,
        "current as torque": _as_current,
        "another clock": _shifted,
        "gravity taken off": _without_gravity,
    }
    for j, degrees in itertools.product((1, 2, 3), (-90, 90, 180)):  # gravity loads these joints
        out[f"zero at {degrees} deg, {names[j]}"] = partial(_other_zero, j=j, degrees=degrees)
    for j, joint in enumerate(names):
        one: dict[str, tuple[Sequence[str], float, set[str]]] = {
            "load reversed": (LOAD, -1.0, {f"sign:tau:{joint}"}),
            "motion reversed": (MOTION, -1.0, {f"sign:motion:{joint}"}),
            "position reversed": (("q",), -1.0, {f"sign:q:{joint}"}),
            "speed reversed": (("dq",), -1.0, {f"sign:dq:{joint}"}),
            "load at the motor": (LOAD, 1 / GEAR, {f"scale:tau:{joint}"}),
            "position at the motor": (("q",), GEAR, {f"scale:q:{joint}"}),
        }
        for what, (arrays, factor, words) in one.items():
            if j == of.n - 1:  # nothing hangs on the last joint: reversed as a whole it is the same joint
                words = (
                    words | {w.replace(":motion:", ":tau:") for w in words} | {w.replace(":tau:", ":motion:") for w in words}
                )
                words |= {w.replace(":q:", ":dq:") for w in words} | {w.replace(":dq:", ":q:") for w in words}
            out[f"{what}, {joint}"] = lambda log, *_, a=arrays, f=factor, w=words, j=j: (scaled(log, a, f, j), frozenset(w))  # type: ignore[misc]
    for i, j in itertools.combinations(range(of.n), 2):
        both = f"{names[i]},{names[j]}"
        for what, arrays, words in (
            ("loads exchanged", LOAD, {f"swap:tau:{both}"}),
            ("motions exchanged", MOTION, {f"swap:motion:{both}"}),
            ("joints exchanged", (*LOAD, *MOTION), {f"swap:all:{both}"}),
        ):
            out[f"{what}, {both}"] = lambda log, *_, a=arrays, w=words, i=i, j=j: (_swapped(log, a, i, j), frozenset(w))  # type: ignore[misc]
    return out


def cases(count: int = COUNT, seed: int = 0) -> list[Case]:
    """`count` wrong recordings: other arms and mountings, repeated logs, grippers, one corruption, two or three."""
    rng = np.random.default_rng(seed)
    singles = [(name, (what,)) for name in BASES for what in _of(name)]
    order = rng.permutation(len(singles))
    others = [(a, b) for a in FAMILY for b in FAMILY if a != b]
    out: list[Case] = [_foreign(a, b, k) for k, (a, b) in enumerate(others)]
    out += [_twice(name) for name in BASES] + [_gripper(name) for name in BASES]
    out += [
        _hanging(name, degrees, k)
        for k, (name, degrees) in enumerate(itertools.product(("ur5e", "servo6", "ur10e"), (90.0, 150.0, 180.0)))
    ]
    out += [_case(*singles[k], rng) for k in order[: int(0.6 * count) - len(out)]]
    while len(out) < count:
        name = str(rng.choice(BASES))
        known = _of(name)
        chosen = tuple(known[k] for k in rng.choice(len(known), int(rng.integers(2, 4)), replace=False))
        # the order of two exchanges that share a joint cannot be determined, and two reversals of one joint cancel
        touched = [joint for what in chosen for joint in what.partition(", ")[2].split(",") if joint]
        if len(set(touched)) < len(touched) or len({what.partition(",")[0] for what in chosen}) < len(chosen):
            continue
        out.append(_case(name, chosen, rng))
    return [out[k] for k in rng.permutation(len(out))][:count]


def _of(name: str) -> list[str]:
    """Corruptions of a recording, without zeros and gravity for the samples: 6 to 8 s fit a load, a tilt and a pull as well."""
    return [what for what in changes(base(name)[0]) if "sample" not in name or not what.startswith(("zero", "gravity"))]


def _case(name: str, chosen: tuple[str, ...], rng: np.random.Generator) -> Case:
    of, log = base(name)
    right: frozenset[str] = frozenset()
    for what in chosen:
        log, words = changes(of)[what](log, of, rng)
        right |= words
    return Case(f"{name}: {'; '.join(chosen)}", of, (log,), chosen, right)


def _foreign(named: str, real: str, seed: int) -> Case:
    truth = varied(arm(real), seed, 0.05)
    log = recorded(truth, within(truth, fourier_motion(truth, 300 + seed, 24.0, 100.0)), seed)
    return Case(f"{named}: a recording of {real}", arm(named), (log,), ("another arm",), frozenset({real}))


def _hanging(name: str, degrees: float, seed: int) -> Case:
    """An arm on a wall, an overhang or a ceiling, read as if it stood on the floor."""
    rng, of = np.random.default_rng(seed), arm(name)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.append(_unit(rng.standard_normal(2)), 0.0))
    truth = varied(of, seed, 0.05)
    truth = replace(truth, tree=replace(truth.tree, gravity=turn.apply(of.gravity)))
    log = recorded(truth, within(truth, fourier_motion(truth, 400 + seed, 24.0, 100.0)), seed)
    return Case(f"{name}: mounted at {degrees:g} deg", of, (log,), ("another mounting",), frozenset({"mounted differently"}))


def _unit(x: np.ndarray) -> np.ndarray:
    return np.asarray(x / np.linalg.norm(x))


def _twice(name: str) -> Case:
    of, log = base(name)
    again = replace(log, t=log.t + 100, q=np.round(log.q, 6))
    return Case(f"{name}: twice", of, (log, again), ("the same recording twice",), frozenset({"the same recording"}))


def _gripper(name: str) -> Case:
    of, log = base(name)
    arrays = ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    wide = {key: np.column_stack([getattr(log, key), np.full(len(log), 0.02)]) for key in arrays}
    more = replace(log, joint_names=(*log.joint_names, "finger_joint"), **wide)
    return Case(f"{name}: with a gripper", of, (more,), ("a gripper's joint",), frozenset({"gripper"}))


def family() -> list[Arm]:
    return [arm(name) for name in FAMILY]


def named_first(case: Case, found: Gate) -> bool:
    """Whether the first cause is one of those put in."""
    if not found.causes:
        return False
    first = found.causes[0]
    texts = {first.sentence, *(c.word(case.arm.joint_names) for c in first.corrections[:1])}
    return any(word in text for text in texts for word in case.right)
