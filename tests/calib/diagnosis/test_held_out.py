"""Held-out recordings: warmth and delay count within their prior only, and structure must show on both sides."""

from __future__ import annotations

import numpy as np
import pytest

from calib.diagnosis.acceptance import APART, APART_FRICTION, least_apart
from calib.diagnosis.candidates import Key
from calib.diagnosis.nuisance import BEYOND, nuisance_names, within_prior
from calib.diagnosis.structure import LEAST, LEAST_APART, Structure
from sim.arm import ArmEffect


def test_warmth_and_delay_count_only_as_far_as_is_ordinary() -> None:
    """A joint that loses a third of its friction (11 std) is an effect. The fit's own warming must not compete with it."""
    names = nuisance_names(2)
    theta = np.full(len(names), -11.0)
    theta[names.index("warmth_1")] = 11.0
    theta[names.index("delay")] = 1.0
    kept = dict(zip(names, within_prior(names, theta), strict=True))
    assert (kept["warmth_1"], kept["warmth_2"], kept["delay"]) == (BEYOND, -BEYOND, 1.0)
    assert {value for name, value in kept.items() if not name.startswith("warmth") and name != "delay"} == {-11.0}


@pytest.mark.parametrize(
    ("fitted", "held_out", "real"),
    [
        (1.1 * LEAST, 1.1 * LEAST_APART, True),
        (1.1 * LEAST, 0.75 * LEAST_APART, False),
        (1.3 * LEAST, 0.9 * LEAST_APART, False),
        (2.4 * LEAST, 0.75 * LEAST_APART, True),
        (2.4 * LEAST, 0.4 * LEAST_APART, False),
        (9.0 * LEAST, 0.12 * LEAST_APART, True),
        (9.0 * LEAST, 0.1 * LEAST_APART, False),
        (0.9 * LEAST, 9.0 * LEAST_APART, False),
        (1.1 * LEAST, np.nan, True),
    ],
)
def test_structure_needs_less_on_one_side_where_the_other_shows_it_clearly(fitted: float, held_out: float, real: bool) -> None:
    assert Structure("elbow_joint", "time", fitted, held_out, 0.1, 1.0).real is real


@pytest.mark.parametrize(
    ("effect", "joint", "rival", "strong", "weak"),
    [
        ("torque_offset", "elbow_joint", ("asymmetric_friction", "elbow_joint"), 20.0, APART_FRICTION),
        ("asymmetric_friction", "elbow_joint", ("torque_offset", "elbow_joint"), 20.0, APART_FRICTION),
        ("asymmetric_friction", "elbow_joint", ("torque_offset", "wrist_1_joint"), APART, APART),
        ("payload", None, ("link_inertia", "wrist_2_joint"), APART, APART),
    ],
)
def test_strong_evidence_tells_masses_apart_and_friction_only_by_a_share(
    effect: str, joint: str | None, rival: Key, strong: float, weak: float
) -> None:
    assert least_apart(ArmEffect(effect, joint, {}), rival, 1000.0) == pytest.approx(strong)
    assert least_apart(ArmEffect(effect, joint, {}), rival, 100.0) == weak
