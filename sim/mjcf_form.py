"""How an exported MuJoCo model has an effect: in elements of MJCF, by the callback of `calib.mujoco`, or in a reading alone."""

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

    tendon: (ratio, attributes) of a fixed tendon as long as the joint's angle and `ratio` times that of the joint right before it.
    """

    joint: dict[str, str] = field(default_factory=dict)
    elements: tuple[tuple[str, str, dict[str, str]], ...] = ()
    tendon: tuple[float, dict[str, str]] | None = None


def passive(
    name: str, amplitude: float = 0.0, cycles: float = 0.0, phase: float = 0.5 * math.pi, **attributes: str
) -> dict[str, str]:
    """Attributes of a dcmotor without input, so that it takes no place in ctrl: force amplitude sin(cycles length + phase).

    By default the force is constant. `attributes` say on what it acts: a joint, or a site.
    """
    motor = {"name": name, "input": "none", "resistance": "1", "motorconst": "0"}
    return motor | ({"cogging": f"{amplitude!r} {cycles!r} {phase!r}"} if amplitude else {}) | attributes


Form = Literal["native", "callback", "sensor", "none"]


@dataclass(frozen=True)
class Exported:
    """How an exported MuJoCo model has an effect: its form, the element or function that has it, and the error of that in words.

    form     native: plain MuJoCo simulates it. callback: `calib.mujoco` adds its torque each step. sensor: it leaves the motion as
             it is and changes a reading, which `calib.mujoco.read` returns. none: left out
    error    "" where the form is exact
    mjcf     elements and joint attributes that stand by themselves
    damping  (a, b, c): torque a v + b v |v| + c v^3 beside the joint's own damping
    dry      share of the joint's dry friction, together one element: level N m, excess N m, velocity rad/s, stiffness N m/rad
    twist    attributes of a second hinge between motor and link
    limit    N m that the joint's motors deliver at most
    force    (x, y, z) N in the world on the origin of the last link
    delay    s by which the reading of the motors' torque is late
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
    """What an exported form may depend on: speed rad/s that the joint reaches, inertia kg m^2 of its rotor at the joint."""

    speed: float = 1.0
    rotor: float = 0.0
