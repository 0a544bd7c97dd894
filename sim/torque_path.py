"""The path of a torque from the motion to its reading, along which every effect acts at one stage.

The torque that a drive reports follows from a motion stage by stage; each effect is one function at one stage:

    ENCODER       reading of the joint angle -> angle
    RIGID         masses, centres of mass, gravity                 tau_link = Y(q, dq, ddq) pi
    FORCE         a force on the last link                         load = tau_link - J^T f
    JOINT         torque on the joint beside the gear              load -= torque on the joint
    TRANSMISSION  the gear between motor and link                  q_motor = q + twist(load)
    FRICTION      level of dry friction, its width, its warmth     dry = warmth level slip
    MOTOR         torque at the motor: speed, acceleration         tau = load + dry + ...
    DRIVE         what the drive can deliver                       clip
    SENSOR        gain and offset of the torque reading            gain tau + offset
    CHANNEL       when the reading arrives                         tau(t - delay)
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

import numpy as np


class Stage(enum.IntEnum):
    """Where on the torque path an effect acts; effects apply in this order."""

    ENCODER = 0
    RIGID = 1
    FORCE = 2
    JOINT = 3
    TRANSMISSION = 4
    FRICTION = 5
    MOTOR = 6
    DRIVE = 7
    SENSOR = 8
    CHANNEL = 9


@dataclass
class PathState:
    """The torque path along N instants, filled stage by stage; arrays (N, n) on the joint side of the gear.

    t (N,) s from the start of the recording; q dq ddq of the link; load N m through the gear; q_motor dq_motor ddq_motor; level
    N m of dry friction, width rad over which it builds up, warmth factor on all friction, slip in [-1, 1] its direction; tau
    N m; force (N, 3) N on the last link's origin in the base frame; warming (N, n) measured share of the way from cold to warm,
    if a recording has temperatures. memory: what a law keeps of earlier samples, and its parameters, for a path of one arm that
    is evaluated in parts; None for a whole path. slips: joint -> law of its slip, if it is not Dahl's: a function of the path,
    the joint and the lead s of `sim.slip.slip_along`.
    """

    t: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    load: np.ndarray
    q_motor: np.ndarray
    dq_motor: np.ndarray
    ddq_motor: np.ndarray
    level: np.ndarray
    width: np.ndarray
    warmth: np.ndarray
    slip: np.ndarray
    tau: np.ndarray
    force: np.ndarray
    warming: np.ndarray | None = None
    memory: dict[Hashable, np.ndarray] | None = None
    slips: dict[int, Slip] = field(default_factory=dict)


Slip = Callable[[PathState, int, float], np.ndarray]
