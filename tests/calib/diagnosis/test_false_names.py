"""The null distribution of the likelihood ratio matches recordings without an effect."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.known_truth import varied
from calib.diagnosis.diagnose import diagnose
from calib.diagnosis.false_names import MOST_FALSE, NullDistribution
from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.prices import THRESHOLD
from calib.diagnosis.scoring import scored
from calib.diagnosis.selection import started
from sim.arm import Arm
from tests.calib.diagnosis.conftest import recording

OTHERS = range(11, 19)


def begun(arm: Arm, seed: int) -> Fit:
    """Fit to a recording of an arm whose masses, friction and reflected inertias are drawn around the nominal ones."""
    logs = warmed([measured(recording(arm, seed, truth=varied(arm, seed, 0.04)), arm)])
    return started(logs, Hypothesis.nominal(arm))


@pytest.fixture(scope="module")
def null(ur10e: Arm) -> NullDistribution:
    return NullDistribution.of(begun(ur10e, 1))


def test_one_linear_parameter_brings_a_chi_square_of_one(null: NullDistribution, ur10e: Arm) -> None:
    """The mean over draws is 1, although the fit has absorbed nearly all of the gain."""
    for joint in ur10e.joint_names:
        assert null.gains["viscous_friction", joint].mean() == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
def test_other_recordings_without_an_effect_fall_where_it_says(null: NullDistribution, ur10e: Arm) -> None:
    """Of eight other motions with other noise, none is beyond 1 in 100, and not all are on one side of the median."""
    chances = []
    for seed in OTHERS:
        # these drives have no lead of half a control period, which is ordinary elsewhere
        ranked = scored(begun(ur10e, seed), {("time_delay", None)}, ask_contact=False)
        chances.append(min(null.rate(s.key, s.gain) for s in ranked))
    assert min(chances) > MOST_FALSE
    assert min(chances) < 0.5 < max(chances)


def test_the_rate_counts_the_draw_at_hand() -> None:
    one, other = ("coulomb_friction", "elbow_joint"), ("viscous_friction", "elbow_joint")
    null = NullDistribution({one: np.linspace(0.0, THRESHOLD, 99)})
    assert null.rate(one, -1.0) == 1.0
    assert null.rate(one, 0.95 * THRESHOLD) == pytest.approx(0.06, abs=0.005)
    assert null.rate(one, 1e9) == pytest.approx(0.01)
    assert null.rate(other, 1e9) == pytest.approx(0.01)


def test_a_candidate_that_chance_feeds_hides_no_other() -> None:
    """A delay gains up to 100 without an effect. Viscous friction with a gain of 25 is named, a delay with 60 is not."""
    fed, other = ("time_delay", None), ("viscous_friction", "elbow_joint")
    rng = np.random.default_rng(5)
    null = NullDistribution({fed: rng.uniform(0.0, 100.0, 999), other: rng.chisquare(1, 999)})
    assert null.rate(other, 25.0) <= MOST_FALSE < null.rate(fed, 60.0)


def test_a_name_states_the_rate_of_false_names(ur10e: Arm) -> None:
    def springy(motion, tau):  # type: ignore[no-untyped-def]
        out = np.zeros_like(tau)
        out[:, 2] = 40.0 * (motion.q[:, 2] - motion.q[0, 2])
        return out

    answer = diagnose(ur10e, [recording(ur10e, 1, springy)], [recording(ur10e, 2, springy)]).answer
    assert [e["effect"] for e in answer["effects"]] == ["joint_spring"]
    assert answer["effects"][0]["false_name_rate"] <= MOST_FALSE
    assert answer["false_names"]["simulated"] > 100
    assert answer["false_names"]["chance"] > MOST_FALSE
