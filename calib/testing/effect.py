"""The promises of an effect (sim.effects.Effect): it states what it is, its bounds are kept, and at zero strength it changes nothing."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calib.testing.promise import Promise, Promises
from sim.arm import Arm, ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.effects import Effect, Stage, checked, effect_named, with_effect
from sim.errors import ConfigError
from sim.prediction import by_stage, link_side, predict, torque_path
from sim.trajectory import Trajectory

RATE, SECONDS = 250.0, 8.0


def check_effect(effect: Effect | str, arm: Arm | str = "ur10e") -> tuple[Promise, ...]:
    """Check every promise of an effect of the catalogue (built in, or added by an entry point), on one motion of `arm`."""
    out = Promises()
    arm = load_arm(arm) if isinstance(arm, str) else arm
    effect = effect_named(effect) if isinstance(effect, str) else effect
    joint = arm.joint_names[min(1, arm.n - 1)] if effect.scope == "joint" else None
    item = ArmEffect(effect.name, joint, _typical(effect))
    motion = _motion(arm)
    out.keep(
        "the catalogue has it under its name", lambda: effect_named(effect.name) is effect or "another effect has this name"
    )
    out.keep("it states what it is, how it looks, and its source", lambda: _words(effect))
    out.keep("its law is the first paragraph of its docstring", lambda: bool(effect.law) or "no docstring")
    out.keep("every parameter has a unit, a meaning, and typical values within its bounds", lambda: _parameters(effect))
    out.keep("typical values are accepted", lambda: checked(arm, item) is item)
    for p in effect.parameters:
        for bound, beyond in ((p.lower, -np.inf), (p.upper, np.inf)):
            if math.isfinite(bound):
                outside = replace(item, parameters=item.parameters | {p.name: float(np.nextafter(bound, beyond))})
                out.refuse(f"{p.name} beyond {bound:g} is refused", partial(checked, arm, outside), ConfigError)
        spoilt = replace(item, parameters=item.parameters | {p.name: math.nan})
        out.refuse(f"{p.name} of NaN is refused", partial(checked, arm, spoilt), ConfigError)
    out.keep("at a typical strength it changes the torque, to finite numbers", lambda: _changes(arm, item, motion))
    out.keep("at zero strength it changes nothing", lambda: _nothing(arm, effect, item, motion))
    out.keep("it does not change the motion that it is given", lambda: _leaves(arm, item, motion))
    out.keep("two evaluations give the same result", lambda: _same_twice(arm, item, motion))
    out.keep("an arm folder carries it", lambda: _carried(arm, item, motion))
    out.keep("its imitators are finite torques along the motion", lambda: _imitators(arm, effect, motion))
    out.keep("if it states the lead of the motor, the motor has it", lambda: _motor_lead(arm, effect, item, motion))
    out.keep("its probes are values that the catalogue accepts", lambda: _probes(arm, effect, joint))
    return tuple(out.found)


def _typical(effect: Effect) -> dict[str, float]:
    middle = {p: p.grid[len(p.grid) // 2] for p in effect.parameters}
    return {p.name: x if x != p.zero else x + 0.1 for p, x in middle.items()}


def _motion(arm: Arm) -> Trajectory:
    """Three harmonics per joint from rest to rest around the middle of its range, over at most a third of the range."""
    rng, t = np.random.default_rng(4), np.arange(0, SECONDS, 1 / RATE)
    wave = 2 * np.pi / SECONDS * np.arange(1, 4)
    low, high = np.nan_to_num(arm.q_min, nan=-np.pi), np.nan_to_num(arm.q_max, nan=np.pi)
    home = np.clip((low + high) / 2 - 1.2 * (np.arange(arm.n) == 1), low, high)
    a, b = rng.uniform(-1, 1, (2, 3, arm.n)) * np.minimum((high - low) / 10, 0.4)
    q = home + (np.sin(np.pi * t / SECONDS) ** 2)[:, None] * (np.sin(np.outer(t, wave)) @ a + np.cos(np.outer(t, wave)) @ b)
    dq = np.gradient(q, t, axis=0)
    return Trajectory(t, q, dq, np.gradient(dq, t, axis=0))


def _words(effect: Effect) -> str:
    empty = [key for key in ("name", "summary", "looks", "reference") if not getattr(effect, key, "").strip()]
    return f"{', '.join(empty)}: empty" if empty else ""


def _parameters(effect: Effect) -> str:
    for p in effect.parameters:
        if not (p.unit and p.meaning):
            return f"{p.name}: no unit or no meaning"
        if not (p.lower < p.upper and p.grid and all(p.lower <= x <= p.upper and math.isfinite(x) for x in p.grid)):
            return f"{p.name}: grid {p.grid} within [{p.lower:g}, {p.upper:g}]"
        if p.zero is not None and not p.lower <= p.zero <= p.upper:
            return f"{p.name}: its zero {p.zero:g} is outside its bounds"
    return "" if effect.parameters else "no parameters"


def _bare(arm: Arm, item: ArmEffect) -> Arm:
    return replace(arm, effects=tuple(e for e in arm.effects if e.key != item.key))


def _changes(arm: Arm, item: ArmEffect, motion: Trajectory) -> str:
    bare = _bare(arm, item)
    change = predict(with_effect(bare, item), motion) - predict(bare, motion)
    if not np.isfinite(change).all():
        return "the torque with it is not finite"
    return "" if np.abs(change).max() > 1e-6 else "the torque does not change with it"


def _nothing(arm: Arm, effect: Effect, item: ArmEffect, motion: Trajectory) -> str:
    bare, values = _bare(arm, item), effect.none()
    if effect.stage is Stage.RIGID and effect.scope == "joint" and item.joint is not None and "mass" in values:
        j = arm.joint_index(item.joint)
        values = values | dict(zip(("mass", "com_x", "com_y", "com_z"), (arm.tree.mass[j], *arm.tree.com[j]), strict=True))
    without = predict(bare, motion)
    strength = np.abs(predict(with_effect(bare, item), motion) - without).max()
    left = np.abs(predict(with_effect(bare, replace(item, parameters=values)), motion) - without).max()
    # a gear is never quite rigid: the greatest stiffness leaves a trace
    return "" if left <= max(2e-3 * strength, 1e-9 * np.abs(without).max()) else f"{left:.3g} N m remain of {strength:.3g}"


def _leaves(arm: Arm, item: ArmEffect, motion: Trajectory) -> bool:
    before = [motion.q.copy(), motion.dq.copy(), motion.ddq.copy()]
    predict(with_effect(arm, item), motion)
    return all(np.array_equal(a, b) for a, b in zip(before, (motion.q, motion.dq, motion.ddq), strict=True))


def _same_twice(arm: Arm, item: ArmEffect, motion: Trajectory) -> bool:
    first, second = (predict(with_effect(arm, item), motion) for _ in range(2))
    return bool(np.array_equal(first, second))


def _carried(arm: Arm, item: ArmEffect, motion: Trajectory) -> str:
    expected = predict(with_effect(arm, item), motion)
    with tempfile.TemporaryDirectory() as folder:
        read = predict(write_arm(Path(folder) / "arm", arm, effects=[item]), motion)
    off = np.abs(read - expected).max()
    return "" if off <= 1e-9 * np.abs(expected).max() else f"read back, the torque differs by {off:.3g} N m"


def _imitators(arm: Arm, effect: Effect, motion: Trajectory) -> str:
    path = link_side(arm, motion, by_stage((), arm))
    for what, torque in effect.imitators(path, min(1, arm.n - 1)).items():
        if torque.ndim != 2 or len(torque) != len(motion.t) or not np.isfinite(torque).all():
            return f"{what!r}: shape {torque.shape}, expected ({len(motion.t)}, k) finite numbers"
    return ""


def _motor_lead(arm: Arm, effect: Effect, item: ArmEffect, motion: Trajectory) -> str:
    path = torque_path(_bare(arm, item), motion, effects=())
    if effect.scope != "joint" or item.joint is None:
        return ""
    j = arm.joint_index(item.joint)
    lead = effect.motor_lead(path.load[:, j])
    if lead is None:
        return ""
    if len(effect.parameters) != 1 or lead.shape != motion.t.shape:
        return f"shape {lead.shape} and {len(effect.parameters)} parameters, expected {motion.t.shape} and one"
    effect.apply(path, j, item.parameters)
    off = (path.q_motor - path.q)[:, j] - item.parameters[effect.parameters[0].name] * lead
    known = np.isfinite(lead)
    # it states the settled lead, which a shock delays by some samples
    share = float(np.mean(np.abs(off[known]) < 1e-9)) if known.any() else 0.0
    return "" if share > 0.9 else f"the lead is as stated in {share:.0%} of the samples"


def _probes(arm: Arm, effect: Effect, joint: str | None) -> None:
    for probe in effect.probes(None):
        for values in (probe.base, *probe.points):
            if not any(math.isinf(v) for v in values.values()):
                checked(arm, ArmEffect(effect.name, joint, dict(values)))
