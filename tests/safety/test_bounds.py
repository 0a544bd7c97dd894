"""No effect in an arm's file takes the torque outside its verified bounds.

Effects and parameters are random; the bounds are checked along paths, in boxes and in stops.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import DeviceStop
from safety.bounds import TorqueBounds
from safety.device_stops import DeviceStops
from safety.sheets import OwnStops, PathSheet, Sheet
from safety.torque import torque_interval
from sim import torque_box
from sim.arm import Arm, ArmEffect
from sim.arm_table import PriorTable
from sim.cell import Cell
from sim.effects import EFFECTS, LAWS, Stage, effect_named, with_effect
from sim.effects.effect import Effect
from sim.effects.presliding_friction import PreslidingFriction
from sim.interval import Interval
from sim.prediction import predict
from sim.trajectory import Trajectory

UNBOUNDED = ("joint_elasticity", "backlash")
RATE = 500.0
ALL = tuple(e.name for e in (*EFFECTS, *LAWS) if e.stage is not Stage.RIGID)
BOUNDED = tuple(name for name in ALL if name not in UNBOUNDED)
SURE = PriorTable(mass=1e-3, com=1e-3, inertia=1e-3, coulomb=1e-3, viscous=1e-3, rotor=1e-3)


def random_values(effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Random values around the typical values of the effect's grids, of either sign where allowed."""
    out = {}
    for p in effect.parameters:
        typical = (
            float(rng.choice(p.grid)) * rng.uniform(0.3, 2.0) * (1.0 if p.zero is None or p.lower >= 0 else rng.choice((-1, 1)))
        )
        if effect.name == "friction_law":
            typical = 0.0 if rng.random() < 0.5 else 5.0 * typical * (0.01 if p.name.startswith("load") else 1.0)
        if effect.name in ("tool_force", "external_contact") and p.name.startswith("force"):
            typical *= 20.0
        if p.name == "start":
            typical = 0.5
        out[p.name] = float(np.clip(typical, p.lower, p.upper))
    return out


def arm_with(arm: Arm, name: str, rng: np.random.Generator) -> Arm:
    """The arm with effect `name` at three joints or on the whole arm, and known Coulomb and viscous friction at every joint."""
    effect, out = effect_named(name), replace(arm, prior=SURE)
    for joint in arm.joint_names:
        out = with_effect(out, ArmEffect("coulomb_friction", joint, {"coulomb": float(rng.uniform(1, 8))}))
        out = with_effect(out, ArmEffect("viscous_friction", joint, {"viscous": float(rng.uniform(1, 8))}))
    if name in ("coulomb_friction", "viscous_friction"):
        return out
    joints = rng.choice(arm.joint_names[effect.driven :], 3, replace=False) if effect.scope == "joint" else [None]
    for joint in joints:
        out = with_effect(out, ArmEffect(name, None if joint is None else str(joint), random_values(effect, rng)))
    return out


def wild(rng: np.random.Generator, n: int = 6, seconds: float = 4.0) -> Trajectory:
    """A smooth motion from rest with many reversals, short and long."""
    t = np.arange(0, seconds, 1 / RATE)
    w = 2 * np.pi / seconds * np.array([1, 2, 5, 9])
    a, b = rng.uniform(-1, 1, (2, 4, n)) * 0.35 / np.array([1, 2, 5, 9])[:, None] ** 1.3
    fade, by = np.sin(np.pi * t / seconds) ** 2, np.pi / seconds
    dfade, ddfade = by * np.sin(2 * by * t), 2 * by**2 * np.cos(2 * by * t)
    s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    x, dx, ddx = s @ a + c @ b, (c * w) @ a - (s * w) @ b, -((s * w**2) @ a) - (c * w**2) @ b
    f, df, ddf = (y[:, None] for y in (fade, dfade, ddfade))
    home = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
    return Trajectory(t, home + f * x, df * x + f * dx, ddf * x + 2 * df * dx + f * ddx)


def motor_torque(arm: Arm, motion: Trajectory) -> np.ndarray:
    """Motor torque by `sim.prediction`, without the effects that change only the reading."""
    sensors = (Stage.SENSOR, Stage.CHANNEL, Stage.DRIVE)
    return predict(replace(arm, effects=tuple(e for e in arm.effects if effect_named(e.effect).stage not in sensors)), motion)


@pytest.mark.parametrize("name", BOUNDED)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_torque_of_a_path_stays_in_its_interval(arm: Arm, cell: Cell, name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    made, motion = arm_with(arm, name, rng), wild(rng)
    torque = torque_interval(motion, made, cell)
    assert np.all(np.abs(motor_torque(made, motion)) <= torque.most + 1e-9)
    if name != "torque_saturation":  # a motion that saturates a drive is refused
        assert np.all(np.abs(predict(made, motion) - torque.tau_hat) <= torque.doubt + 1e-9 * made.tau_max)


CHANGES = tuple(n for n in BOUNDED if n not in ("torque_saturation",))


@pytest.mark.parametrize("name", CHANGES)
def test_without_its_bound_the_torque_leaves_the_interval(
    arm: Arm, cell: Cell, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Verifies that the test above can fail: it holds only because of each effect's own bound."""
    left_out: Callable[..., None] = lambda *_: None  # noqa: E731
    outside = False
    for seed in range(4):
        rng = np.random.default_rng(seed)
        made, motion = arm_with(arm, name, rng), wild(rng)
        with monkeypatch.context() as patched:
            patched.setattr(type(effect_named(name)), "bound", left_out)
            torque = torque_interval(motion, made, cell)
        outside |= bool(np.any(np.abs(predict(made, motion) - torque.tau_hat) > torque.doubt + 1e-9))
    assert outside


@pytest.mark.parametrize("name", ["coulomb_friction", "presliding_friction", "friction_law"])
def test_without_memory_the_torque_leaves_the_interval(
    arm: Arm, cell: Cell, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bound that takes friction to have the sign of the speed at once does not cover a joint that has just reversed."""
    monkeypatch.setattr(torque_box, "way_in_one_direction", lambda dq, *_: (np.full_like(dq.lo, 9.0), np.sign(dq.lo)))
    rng = np.random.default_rng(0)
    made, motion = arm_with(arm, name, rng), wild(rng)
    monkeypatch.setattr(PreslidingFriction, "bound", lambda *_: None)
    torque = torque_interval(motion, made, cell)
    assert np.any(np.abs(predict(made, motion) - torque.tau_hat) > torque.doubt + 1e-9)


@pytest.mark.parametrize("name", BOUNDED)
@pytest.mark.parametrize("kind", ["path", "own", "device"])
def test_the_torque_of_whatever_passes_through_a_box_stays_in_it(arm: Arm, cell: Cell, name: str, kind: str) -> None:
    """The path itself, and stops from it simulated with their full history, in boxes merged from many smaller ones."""
    rng = np.random.default_rng(7)
    made, motion = arm_with(arm, name, rng), wild(rng)
    sheet, walks = walked(made, motion, kind, rng)
    bounds = TorqueBounds(made, cell)
    begun = np.concatenate([np.full(len(tau), k) for k, _, tau in walks])
    stages, torque = (np.concatenate([walk[part] for walk in walks]) for part in (1, 2))
    assert len(torque) * len(sheet.levels[:6]) > 1000
    for rows, columns, boxes in sheet.levels[:6]:
        # bounding fewer boxes at once is never looser, so boxes that no walk passes through are left out
        cells = begun // rows * boxes.lo.shape[1] + stages // columns
        passed, place = np.unique(cells, return_inverse=True)
        lo, hi = (x.reshape(-1, *x.shape[2:])[passed] for x in (boxes.lo, boxes.hi))
        most = bounds.of(*(Interval(lo[:, k], hi[:, k]) for k in range(3)), steep=True).most[place]
        outside = np.argwhere(np.abs(torque) > most + 1e-6)
        assert not len(outside), [
            (kind, rows, columns, begun[i], stages[i], j, torque[i, j], motion.dq[begun[i], j]) for i, j in outside
        ]


def walked(
    arm: Arm, motion: Trajectory, kind: str, rng: np.random.Generator
) -> tuple[Sheet, list[tuple[int, np.ndarray, np.ndarray]]]:
    """A sheet, and walks through it: row, stage of each state (M,), motor torque (M, n) given all the motion before."""
    if kind == "path":
        path = PathSheet(motion, arm)
        tau = motor_torque(arm, motion)
        return path, [(k, np.zeros(1, dtype=int), tau[k : k + 1]) for k in range(len(motion) - 1)]
    begins = rng.choice(np.arange(50, len(motion) - 1), 40, replace=False)
    walks = []
    stops = OwnStops(motion, arm, arm.ddq_max) if kind == "own" else None
    device = DeviceStops(motion, arm, DeviceStop(0.02, 4.0), 0.0)
    for k in begins:
        if stops is not None:
            duration, step = float(stops.duration[k]), 1 / RATE
            t = np.arange(1, int(duration / step)) * step
            travel, v, a = (x[0] for x in stops.profile.rows(slice(k, k + 1)).state(t[None, :, None]))
            q, stage = motion.q[k] + travel, np.minimum((t / duration * 16).astype(int), 15)
        else:
            speed, decel = motion.dq[k], 4.0
            t = np.arange(1, int((0.02 + np.abs(speed).max() / decel) * RATE)) / RATE
            u = np.maximum(t - 0.02, 0.0)[:, None]
            left = np.maximum(1 - u * decel / np.abs(speed), 0.0)
            v, a = speed * left, np.where((u > 0) & (left > 0), -np.sign(speed) * decel, 0.0)
            held = np.minimum(u, np.abs(speed) / decel)
            q = motion.q[k] + speed * np.minimum(t, 0.02)[:, None] + speed * held - np.sign(speed) * decel * held**2 / 2
            coast, brake = float(device._coast), float(device._braking[k])
            share = np.where(t <= coast + 1e-9, np.minimum(t / coast * 2, 1.9), 2 + (t - coast) / brake * 14)
            stage = np.minimum(share.astype(int), 15)
        before = slice(0, k + 1)
        whole = Trajectory(
            np.concatenate((motion.t[before], motion.t[k] + t)), np.vstack((motion.q[before], q)),
            np.vstack((motion.dq[before], v)), np.vstack((motion.ddq[before], a)),
        )  # fmt: skip
        walks.append((int(k), stage, motor_torque(arm, whole)[k + 1 :]))
    return stops or device, walks


@pytest.mark.parametrize("name", BOUNDED)
def test_a_joint_beside_its_box_takes_no_more_than_its_slope_says(arm: Arm, cell: Cell, name: str) -> None:
    rng = np.random.default_rng(3)
    made, motion = arm_with(arm, name, rng), wild(rng)
    q, dq, ddq = (Interval(x[::10], x[::10]) for x in (motion.q, motion.dq, motion.ddq))
    bounds = TorqueBounds(made, cell)
    here = bounds.of(q, dq, ddq, steep=True)
    for e in (1e-3, 0.02, cell.table.motion.following_error_max):
        side = Interval.around(q.lo + e * rng.choice((-1, 1), q.lo.shape), 0.0)
        assert np.all(bounds.of(side, dq, ddq).most <= here.most + e * here.steep + 1e-9)
