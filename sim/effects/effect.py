"""What an effect of the catalogue is: its parameters, the stage of the torque path at which it acts, and its MJCF form.

The torque that a drive reports follows from a motion stage by stage; each effect is one function at one stage:

    ENCODER       reading of the joint angle -> angle
    RIGID         masses, centres of mass, gravity                 tau_link = Y(q, dq, ddq) pi
    FORCE         a force on the last link                         load = tau_link - J^T f
    JOINT         torque on the joint beside the gear              load -= torque on the joint
    TRANSMISSION  the gear between motor and link                  q_motor = q + twist(load)
    FRICTION      level of dry friction, its width, its warmth     dry = warmth level slip
    MOTOR         torque at the motor: speed, acceleration         tau = load + dry + ...
    DRIVE         what the drive can deliver                       clip
    SENSOR        what the reading makes of the torque             gain tau + offset
    CHANNEL       when the reading arrives                         tau(t - delay)
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from sim.model import KinematicTree

Values = Mapping[str, float]


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


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    zero is the value at which the effect vanishes (None where another parameter makes it vanish); lower and upper are physical
    bounds; start is a typical value from which a nonlinear fit begins.
    """

    name: str
    unit: str
    meaning: str
    zero: float | None = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    start: float = 0.0


@dataclass(frozen=True)
class Mjcf:
    """How MJCF expresses an effect: attributes added to the joint's element, and (section, tag, attributes) elements."""

    joint: dict[str, str] = field(default_factory=dict)
    elements: tuple[tuple[str, str, dict[str, str]], ...] = ()


@dataclass
class PathState:
    """The torque path along N instants, filled stage by stage; arrays (N, n) on the joint side of the gear.

    t (N,) s from the start of the recording; q dq ddq of the link; load N m through the gear; q_motor dq_motor ddq_motor;
    level N m of dry friction, width rad over which it builds up, warmth factor on all friction, slip in [-1, 1] its direction;
    tau N m; force (N, 3) N on the last link's origin in the base frame.
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


class Effect:
    """One physical effect. Subclasses set the class variables and implement the method of their stage.

    A joint effect gets the joint's index; an effect of the whole arm gets joint None.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    looks: ClassVar[str]
    reference: ClassVar[str]
    experiment: ClassVar[str] = ""
    stage: ClassVar[Stage]
    scope: ClassVar[Literal["joint", "arm"]] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]]

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Change `state` by this effect with parameter values `p`; every stage but RIGID."""
        raise TypeError(f"{self.name} acts on the rigid bodies, not on a motion")

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """What the encoder reads at a joint angle, rad; stage ENCODER only."""
        raise TypeError(f"{self.name} does not act on the encoder")

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The kinematic tree with this effect; stage RIGID only."""
        raise TypeError(f"{self.name} does not act on the rigid bodies")

    def mjcf(self, joint: str, p: Values) -> Mjcf | None:
        """The MJCF form, or None where plain MuJoCo has none and `sim.plant` applies the effect each step."""
        return None

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name."""
        return next(x for x in self.parameters if x.name == name)
