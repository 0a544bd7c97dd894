"""Torque interval of boxes of motion, for every parameter set of the arm's box and every effect of its file, stage by stage.

For states within half-widths (w_q, w_v, w_a) of a box's centre, with the slopes of `safety.slopes` and M at the centre, the
links take
  Y pi_0 +- (|Y| delta + |M| w_a + |dtau/dq| w_q + |dtau/ddq| w_v)
and each effect bounds how it changes that (`sim.effects.effect.Effect.bound`), with the uncertainty of its own parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from safety.parameters import SIGMAS, friction_of, parameter_box
from safety.slopes import Slopes, distances
from sim.arm import Arm
from sim.cell import Cell
from sim.effects import Stage, effect_named
from sim.effects.effect import Effect, Unbounded
from sim.errors import SafetyStop
from sim.interval import Interval
from sim.rigid_body import RigidBody, link_inertia
from sim.slip import SLIP_WIDTH
from sim.torque_box import TorqueBox
from sim.tree import KinematicTree

UNBOUNDED = "effects-without-a-bound"
# every arm has these three; unstated values are as large as in an ordinary drive (safety.parameters)
EVERY_ARM = ("coulomb_friction", "viscous_friction", "rotor_inertia")
PORTION = 2048  # states whose regressors, 10 n numbers per joint, are in memory at once


@dataclass(frozen=True)
class Torques:
    """For C boxes: reading (C, n) N m of the drives; most (C, n) N m, largest torque of motor or reading; limit (n,) N m.

    steep (C, n) N m/rad: growth of `most` per rad by which every joint is off the box, zero if not requested; speed (C, n)
    rad/s: the largest; gain (n,): reading per torque.
    """

    reading: Interval
    most: np.ndarray
    limit: np.ndarray
    steep: np.ndarray
    speed: np.ndarray
    gain: np.ndarray


@dataclass(frozen=True)
class _Group:
    """One effect at all joints that have it."""

    effect: Effect
    joints: np.ndarray
    known: dict[str, Interval]
    unsure: np.ndarray


class TorqueBounds:
    """The bounds of one arm in one cell; SafetyStop if it has an effect without a bound.

    Without `doubt`, masses, reflected inertia, dry and viscous friction are as stated.
    """

    def __init__(self, arm: Arm, cell: Cell, doubt: bool = True) -> None:
        self.arm, self._farthest = arm, cell.table.motion.following_error_max
        self._body, self._slopes = RigidBody(arm), Slopes(arm, cell)
        self._pi, self._delta = parameter_box(arm, cell)
        if not doubt:
            self._delta = np.zeros_like(self._delta)
        self._weightless = RigidBody(_loaded(arm, self._pi), np.zeros(3))
        self._tip, _ = distances(arm, arm.n - 1, 0.0)
        self._groups = _groups(arm, doubt)
        self._refuse_unbounded(cell)

    def of(
        self, q: Interval, dq: Interval, ddq: Interval, t: np.ndarray | None = None, steep: bool = False, y: np.ndarray | None = None
    ) -> Torques:  # fmt: skip
        """Bounds over boxes (C, n). t (C,) s: if they are the instants of a path; y: the regressor at the middles, if known."""
        arm = self.arm
        box = TorqueBox.of(q, dq, ddq, arm.ddq_max, arm.tau_max, self._farthest, t)
        if self._groups[Stage.ENCODER]:
            box.q, box.dq, box.ddq = q.copy(), dq.copy(), ddq.copy()
            self._run(box, Stage.ENCODER)
            y = None
        fast = box.dq.magnitude
        self._links(box, fast, steep, any(np.any(x.hi > x.lo) for x in (box.q, box.dq, box.ddq)), y)
        for stage in (Stage.JOINT, Stage.TRANSMISSION, Stage.FRICTION):
            self._run(box, stage)
        box.dry[box.loose] = 0.0
        one = Interval(box.dry, box.dry)
        every = np.arange(arm.n)
        friction = (box.warmth * box.level - one) * box.slip(every, SLIP_WIDTH)
        self._run(box, Stage.MOTOR)
        box.tau = box.tau + box.load + friction + box.remembered(SLIP_WIDTH)
        self._run(box, Stage.DRIVE)
        box.reading = box.tau.copy()
        self._run(box, Stage.SENSOR)
        most = np.maximum(box.tau.magnitude, box.reading.magnitude)
        self._run(box, Stage.CHANNEL)
        changes = np.maximum(box.gain, 1.0) * (box.steep + np.maximum(box.warmth.magnitude, 1.0) * box.by_friction)
        return Torques(box.reading, most, box.limit, changes, fast, box.gain)

    def _run(self, box: TorqueBox, stage: Stage) -> None:
        for group in self._groups[stage]:
            group.effect.bound(box, group.joints, group.known, group.unsure)

    def _links(self, box: TorqueBox, fast: np.ndarray, steep: bool, wide: bool, y: np.ndarray | None) -> None:
        """Stages RIGID and FORCE: torque of links and external forces on the gears; for boxes or on request also `steep`."""
        q, dq, ddq = box.q.middle, box.dq.middle, box.ddq.middle
        centre, half = self._of_links(q, dq, ddq, y)
        w_q, w_v, w_a = box.q.half, box.dq.half, box.ddq.half
        if wide or steep:
            by_angle = self._slopes.by_angle(fast, np.abs(ddq) + w_a)
            box.steep += by_angle @ box.stretch
        if wide:
            half += np.einsum("cij,cj->ci", self._mass(q), w_a) + np.einsum("cik,ck->ci", by_angle, w_q)
            half += self._slopes.by_speed(fast, w_v)
        box.load = Interval.around(centre, half)
        if self._groups[Stage.FORCE]:
            self._run(box, Stage.FORCE)
            linear, _ = self._body.jacobian(q)
            strong = np.linalg.norm(box.force.magnitude, axis=1)[:, None]
            turned = self._tip[np.maximum.outer(np.arange(len(self._tip)), np.arange(len(self._tip)))]
            middle = np.einsum("kcj,kc->kj", linear, box.force.middle)
            side = np.einsum("kcj,kc->kj", np.abs(linear), box.force.half) + strong * (w_q @ turned)
            box.load = box.load - Interval.around(middle, side)
            box.steep += strong * (turned @ box.stretch)

    def _of_links(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, y: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Link torque (C, n) N m at states (C, n), and its half-width over the parameter box; y: the regressor, if known."""
        centre, half = np.empty_like(q), np.empty_like(q)
        for first in range(0, len(q), PORTION):
            rows = slice(first, first + PORTION)
            part = self._body.regressor(q[rows], dq[rows], ddq[rows]) if y is None else y[rows]
            centre[rows], half[rows] = part @ self._pi, np.abs(part) @ self._delta
        return centre, half

    def _mass(self, q: np.ndarray) -> np.ndarray:
        """Bound (C, n, n) of |M(q)| of the links over the parameter box."""
        n = self.arm.n
        tall = np.repeat(q, n, axis=0)
        unit = np.tile(np.eye(n), (len(q), 1))
        links = self._weightless.inverse_dynamics(tall, np.zeros_like(tall), unit).reshape(len(q), n, n)
        return np.abs(links).transpose(0, 2, 1) + self._slopes.doubt

    def _refuse_unbounded(self, cell: Cell) -> None:
        """SafetyStop for an effect without a bound, unless the cell file assumes that it adds nothing."""
        none = Interval.zeros((1, self.arm.n))
        for stage, groups in self._groups.items():
            bounded = []
            for g in groups:
                box = TorqueBox.of(
                    none.copy(), none.copy(), none.copy(), self.arm.ddq_max, self.arm.tau_max, self._farthest, None
                )
                try:
                    g.effect.bound(box, g.joints, g.known, g.unsure)
                    bounded.append(g)
                except Unbounded:
                    if UNBOUNDED not in cell.assumed:
                        where = ", ".join(self.arm.joint_names[j] for j in g.joints) or "the arm"
                        raise SafetyStop(
                            f"{self.arm.name}: effect {g.effect.name} of {where} in its file has no bound of the torque that it adds, so "
                            f"no motion's torque is bounded; remove it from the arm that motions are planned with, or, if the drives have "
                            f'enough reserve, write assume = ["{UNBOUNDED}"] at the top of {cell.path.name}'
                        ) from None
            self._groups[stage] = bounded


def _groups(arm: Arm, doubt: bool) -> dict[Stage, list[_Group]]:
    """Stage -> the effects of an arm, each with what is known of its parameters at all its joints."""
    f, every = friction_of(arm), np.arange(arm.n)
    wide = 1.0 if doubt else 0.0
    none = np.zeros(arm.n)
    rows = {
        "coulomb_friction": ("coulomb", f.coulomb, wide * f.coulomb_doubt),
        "viscous_friction": ("viscous", f.viscous, wide * f.viscous_doubt),
        "rotor_inertia": ("inertia", f.inertia, wide * f.inertia_doubt),
    }
    out: dict[Stage, list[_Group]] = {stage: [] for stage in Stage}
    for name, (parameter, value, half) in rows.items():
        effect = effect_named(name)
        out[effect.stage].append(_Group(effect, every, {parameter: Interval.around(value, half)}, none))
    for name in dict.fromkeys(e.effect for e in arm.effects if e.effect not in EVERY_ARM):
        effect, items = effect_named(name), [e for e in arm.effects if e.effect == name]
        known = {}
        for p in effect.parameters:
            value = np.array([e.parameters[p.name] for e in items])
            half = SIGMAS * np.array([e.std.get(p.name, 0.0) for e in items])
            known[p.name] = Interval.around(value, half).within(p.lower, p.upper)
        joints = np.array([arm.joint_index(e.joint) for e in items if e.joint is not None], dtype=int)
        unsure = np.array([0.0 if e.std else SIGMAS * arm.prior.coulomb for e in items])
        out[effect.stage].append(_Group(effect, joints, known, unsure))
    # as in sim.prediction: a reading is gain * torque + offset
    for groups in out.values():
        groups.sort(key=lambda g: g.effect.name == "torque_offset")
    return out


def _loaded(arm: Arm, pi: np.ndarray) -> KinematicTree:
    """The links with the inertial parameters pi (10 n,), which include the declared payload on the last one."""
    links = [link_inertia(row) if row[0] > 0 else (0.0, np.zeros(3), np.zeros((3, 3))) for row in pi.reshape(-1, 10)]
    mass, com, inertia = (np.array(x) for x in zip(*links, strict=True))
    return replace(arm.tree, mass=mass, com=com, inertia=inertia)
