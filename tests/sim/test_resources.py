"""An unknown name is answered with the nearest known one and the list of all."""

import pytest

from sim.resources import nearest

KNOWN = ["ur5e", "ur10e", "servo6", "stribeck_friction", "viscous_friction", "payload"]


@pytest.mark.parametrize(
    ("word", "meant"),
    [("UR10E", "ur10e"), ("ur10", "ur10e"), ("stribek", "stribeck_friction"), ("payloda", "payload"), ("servo_6", "servo6")],
)
def test_the_nearest_is_named(word: str, meant: str) -> None:
    assert nearest(word, KNOWN).startswith(f"did you mean {meant!r}? known: ur5e, ")


def test_nothing_near_is_not_guessed() -> None:
    assert nearest("quaternion", KNOWN) == "known: " + ", ".join(KNOWN)
    assert nearest("x", []) == "known: none"
