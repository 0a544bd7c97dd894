"""Which arm of the family stands there: by what the controller calls itself, and by the torque that holds the arm up."""

from __future__ import annotations

import re

import numpy as np

from drivers.driver import Check
from drivers.preflight import RestMisfit, held_by, stated_friction, with_payload
from sim.arm import Arm, load_arm
from sim.cell import PayloadTable

# shipped arm -> robot type of its controller and whether that is a CB3. Types: RobotType in the client library of Universal Robots; it has none
# of its own for the UR7e and UR12e, which are a UR5e and a UR10e of a larger rating. Their own names are taken as well
FAMILY: dict[str, tuple[tuple[str, ...], bool]] = {
    "ur3": (("UR3",), True), "ur5": (("UR5",), True), "ur10": (("UR10",), True), "ur3e": (("UR3",), False), "ur5e": (("UR5",), False),
    "ur7e": (("UR5", "UR7"), False), "ur10e": (("UR10",), False), "ur12e": (("UR10", "UR12"), False), "ur16e": (("UR16",), False),
    "ur8l": (("UR8L",), False), "ur15": (("UR15",), False), "ur18": (("UR18",), False), "ur20": (("UR20",), False),
    "ur30": (("UR30",), False),
}  # fmt: skip
CB3 = 3  # major version of its software


def member(arm: Arm) -> str | None:
    """The shipped arm that an arm folder is of, by its name (`ur10e`, `ur10e-20235501234`); None for any other."""
    return next((name for name in sorted(FAMILY, key=len, reverse=True) if re.match(rf"{name}(?![0-9A-Za-z])", arm.name)), None)


def called(model: str, major: int) -> list[str]:
    """The shipped arms that a controller of this software calls by this name."""
    short = re.sub(r"[\s_-]|ONG", "", model.upper())
    names = {short, short.removesuffix("E")}
    return [name for name, (models, cb3) in FAMILY.items() if names & set(models) and cb3 == (major == CB3)]


def model(reported: str, major: int, arm: Arm) -> Check:
    """Whether the controller's own word for the robot is the arm of the cell file."""
    own = member(arm)
    if not reported or own is None:
        why = (
            "this version does not report its model" if not reported else f"{arm.name} is not named after an arm of the family"
        )
        return Check("model", None, why)
    found = called(reported, major)
    series = "CB3" if major == CB3 else "e-Series or newer"
    return Check(
        "model", own in found, f"the controller says {reported} ({series}), the cell file {arm.name}",
        f"this looks like {_either(found)}: set arm in the cell file" if found else "no arm folder is known for it: make one with `calib arm new`",
        "arm-as-stated",
    )  # fmt: skip


def torque(arm: Arm, payload: PayloadTable | None, q: np.ndarray, tau: np.ndarray, friction: np.ndarray | None = None) -> Check:
    """Whether the torque that holds the arm up, q rad and tau N m (n,) or (K, n) in K poses, is that of the cell's arm, or whose it could be.

    friction N m is what may be in it of friction, as measured; without it each arm's own stated one, as a joint at rest may hold.
    """
    title = "arm of the family" if friction is None else "arm of the family, gravity torque"
    own = member(arm)
    if own is None or not (np.all(np.isfinite(tau)) and np.all(np.isfinite(q))):
        return Check(title, None, "there is no torque at rest to compare with the arms of the family")

    def of(stated: Arm) -> RestMisfit:
        return held_by(with_payload(stated, payload), q, tau, stated_friction(stated) if friction is None else friction)

    mine, others = of(arm), {name: of(load_arm(name)).miss for name in FAMILY if name != own}
    order = sorted(others, key=lambda name: others[name])
    fitting = [name for name in order if others[name] <= 1.0]
    if mine.miss <= 1.0:
        text = f"the torque at rest is that of a {own}" + (
            f"; {', '.join(fitting)} would show the same here" if fitting else ""
        )
        return Check(title, True, text)
    looks = _either(fitting) if fitting else f"{_either(order[:1])} most of all, which does not fit either"
    return Check(
        title, False,
        f"{arm.joint_names[mine.joint]} has {np.atleast_2d(tau)[mine.pose, mine.joint]:.1f} N m, {mine.miss:.1f} times what a {own} can "
        f"differ by; this looks like {looks}",
        "set arm in the cell file to the arm that stands there; look for a tool that is not declared, or another mounting", "arm-as-stated",
    )  # fmt: skip


def _either(names: list[str]) -> str:
    return "a " + " or ".join(names)
