"""Form of an effect in an exported MuJoCo model: MJCF elements, the callback of `calib.mujoco`, or a reading alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

# dry friction of MuJoCo as stiff as its soft constraint allows: slip below about 1 mrad/s is viscous
SOFT_FRICTION = {"solreffriction": "0.002 1", "solimpfriction": "0.9999 0.9999 0.001"}


@dataclass(frozen=True)
class Mjcf:
    """How MJCF expresses an effect: attributes added to the joint's element, and (section, tag, attributes) elements.

    tendon: (ratio, attributes) of a fixed tendon whose length is the joint's angle plus `ratio` times that of the joint right
    before it.
    """

    joint: dict[str, str] = field(default_factory=dict)
    elements: tuple[tuple[str, str, dict[str, str]], ...] = ()
    tendon: tuple[float, dict[str, str]] | None = None


def passive(
    name: str, amplitude: float = 0.0, cycles: float = 0.0, phase: float = 0.5 * math.pi, **attributes: str
) -> dict[str, str]:
    """Attributes of a dcmotor without input, which takes no place in ctrl: force amplitude sin(cycles length + phase).

    The default is a constant force. `attributes` name what it acts on: a joint, or a site.
    """
    motor = {"name": name, "input": "none", "resistance": "1", "motorconst": "0"}
    return motor | ({"cogging": f"{amplitude!r} {cycles!r} {phase!r}"} if amplitude else {}) | attributes


Form = Literal["native", "callback", "sensor", "none"]


@dataclass(frozen=True)
class Exported:
    """Form of an effect in an exported MuJoCo model, the element or function that implements it, and its error in words.

    form     native: plain MuJoCo simulates it. callback: `calib.mujoco` adds its torque each step. sensor: the motion is
             unchanged, and `calib.mujoco.read` returns the changed reading. none: left out
    error    "" if the form is exact
    mjcf     independent elements and joint attributes
    damping  (a, b, c): torque a v + b v |v| + c v^3 in addition to the joint's own damping
    dry      share of the joint's dry friction, together one element: level N m, excess N m, velocity rad/s, stiffness N m/rad
    twist    attributes of a second hinge between motor and link
    limit    N m that the joint's motors deliver at most
    force    (x, y, z) N in the world on the origin of the last link
    delay    s of delay of the motors' torque reading
    """

    form: Form
    how: str
    error: str = ""
    mjcf: Mjcf | None = None
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)
    dry: Mapping[str, float] = field(default_factory=dict)
    twist: Mapping[str, str] = field(default_factory=dict)
    limit: float | None = None
    force: tuple[float, float, float] | None = None
    delay: float = 0.0


@dataclass(frozen=True)
class JointSize:
    """Quantities that an exported form may depend on: speed rad/s that the joint reaches, and its reflected inertia kg m^2."""

    speed: float = 1.0
    rotor: float = 0.0
