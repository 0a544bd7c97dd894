"""Units of a joint's numbers: for a slide N instead of N m, m instead of rad, and kg instead of kg m^2."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np


def of_slide(unit: str) -> str:
    """The unit for a slide, given that for a hinge: force for torque, length for angle, mass for inertia."""
    for turning, sliding in (("kg*m^2", "kg"), ("kg m^2", "kg"), ("N*m", "N"), ("N m", "N"), ("rad", "m")):
        unit = unit.replace(turning, sliding)
    return unit


def of_joints(unit: str, slides: np.ndarray) -> str:
    """The unit at the head of a column with a number for each joint; slides (n,) bool."""
    if not slides.any() or of_slide(unit) == unit:
        return unit
    return of_slide(unit) if slides.all() else f"{unit}, slides {of_slide(unit)}"


def headed(titles: Iterable[str], slides: np.ndarray) -> list[str]:
    """Titles of columns, with the units in square brackets adapted to the joints."""
    return [re.sub(r"\[([^\]]+)\]", lambda found: f"[{of_joints(found[1], slides)}]", title) for title in titles]
