"""What the drives report beyond the rigid bodies: friction with memory, springs, ripple, gain and offset of the reading.

The torque path is that of the catalogue (`sim.effects.effect`). It is followed backwards, from the reported torque to the torque that
the gear passes on to the links, a few samples at a time; its memory is kept between calls.
"""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np

from calib.watch.kernels import slip_on
from sim.arm import Arm
from sim.own_values import values_of
from sim.prediction import by_stage
from sim.rigid_body import RigidBody
from sim.slip import SLIP_WIDTH
from sim.torque_path import PathState, Stage

# effects that need the torque of the next instant or the motor's own angle: they remain in the unmodelled torque
NOT_FOLLOWED = (Stage.TRANSMISSION, Stage.DRIVE)


class DriveTorque:
    """tau_link = (tau_reported - offset)/gain - friction - ..., for each sample.

    `rotor` (n,) kg m^2, the reflected inertia, is accounted for in the momentum. `delay` s is how much later than the motion the torque
    arrives. `coulomb` (n,) N m and `viscous` (n,) N m s/rad are the friction in the arm's file.
    """

    def __init__(self, arm: Arm) -> None:
        n = arm.n
        self._stages = by_stage(arm.effects, arm)
        self.rotor = values_of(arm, "rotor_inertia", "inertia")
        self.coulomb = values_of(arm, "coulomb_friction", "coulomb")
        self.viscous = values_of(arm, "viscous_friction", "viscous")
        delays = [e for e in arm.effects if e.effect == "time_delay"]
        self.delay = float(delays[0].parameters["delay"]) if delays else 0.0
        self.not_followed = tuple(
            sorted({item.effect for stage in NOT_FOLLOWED for _, _, item in self._stages[stage]})
            + sorted({item.effect for effect, _, item in self._stages[Stage.ENCODER]})
            + sorted({item.effect for effect, _, item in self._stages[Stage.FORCE] if effect.driven})
        )
        self._joint = self._stages[Stage.JOINT]
        self._forces = [x for x in self._stages[Stage.FORCE] if not x[0].driven]
        self._bodies = RigidBody(arm) if self._forces else None
        # dry and viscous friction, which every arm has, are computed without the path; an arm with nothing else skips it
        self._friction = [x for x in self._stages[Stage.FRICTION] if x[0].name != "coulomb_friction"]
        self._motor = [x for x in self._stages[Stage.MOTOR] if x[0].name not in ("rotor_inertia", "viscous_friction")]
        self._walked = bool(self._joint or self._friction or self._motor or self._forces)
        self._offset, self._gain = np.zeros(n), np.ones(n)
        state = _path(np.zeros(2), np.zeros((2, n)), np.zeros((2, n)))
        state.tau[1] = 1.0
        for effect, joint, item in self._stages[Stage.SENSOR]:
            effect.apply(state, joint, item.parameters)
        self._offset, self._gain = state.tau[0].copy(), state.tau[1] - state.tau[0]
        self.forget()

    def forget(self) -> None:
        """Forget the direction of dry friction and the memory of the effects, as after a gap."""
        self._slip: np.ndarray | None = None
        self._angle: np.ndarray | None = None
        self._memory: dict[Hashable, np.ndarray] = {}

    def link_torque(
        self, t: np.ndarray, q: np.ndarray, dq: np.ndarray, tau: np.ndarray, gravity: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Torque on the links (N, n) N m and direction of dry friction (N, n) in [-1, 1].

        t (N,) s since the start; gravity (N, n) N m is used as the load where friction depends on the load.
        """
        if not self._walked:
            slip = self._slipping(q, np.broadcast_to(SLIP_WIDTH, q.shape))
            return (tau - self._offset) / self._gain - self.coulomb * slip - self.viscous * dq, slip
        state = _path(t, q, dq)
        state.memory = self._memory
        state.level += self.coulomb
        state.load[:] = gravity
        if self._bodies is not None:
            for effect, joint, item in self._forces:
                effect.apply(state, joint, item.parameters)
            linear, _ = self._bodies.jacobian(q)
            state.load -= np.einsum("kcj,kc->kj", linear, state.force)
        for effect, joint, item in self._joint:
            effect.apply(state, joint, item.parameters)
        for effect, joint, item in self._friction:
            effect.apply(state, joint, item.parameters)
        state.slip[:] = self._slipping(q, state.width)
        state.tau[:] = state.warmth * (state.level * state.slip + self.viscous * dq)
        if self._joint or self._forces:
            state.tau += state.load - gravity
        for effect, joint, item in self._motor:
            effect.apply(state, joint, item.parameters)
        return (tau - self._offset) / self._gain - state.tau, state.slip

    def _slipping(self, q: np.ndarray, width: np.ndarray) -> np.ndarray:
        if self._slip is None or self._angle is None:
            self._slip, self._angle = np.zeros(q.shape[1]), q[0].copy()
        out = np.empty_like(q)
        slip_on(q, self._angle, self._slip, width, out)
        self._slip, self._angle = out[-1].copy(), q[-1].copy()
        return out


def _path(t: np.ndarray, q: np.ndarray, dq: np.ndarray) -> PathState:
    zero = np.zeros_like(q)
    return PathState(
        t=t, q=q, dq=dq, ddq=zero, load=zero.copy(), q_motor=q, dq_motor=dq, ddq_motor=zero, level=zero.copy(),
        width=np.full_like(q, SLIP_WIDTH), warmth=np.ones_like(q), slip=zero.copy(), tau=zero.copy(), force=np.zeros((len(t), 3)),
    )  # fmt: skip
