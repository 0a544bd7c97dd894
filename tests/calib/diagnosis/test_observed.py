"""A gap that the following error shows, in whichever recording, is weighed beside the torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.diagnosis import diagnose as module
from calib.diagnosis.hypothesis import Hypothesis
from calib.diagnosis.motion import measured, warmed
from calib.diagnosis.scoring import scored
from calib.diagnosis.selection import add, started
from calib.measurement.observed import Observed
from sim.arm import Arm
from tests.calib.diagnosis.conftest import recording
from tests.calib.measurement.test_following import GAP, PAN, commanded


@pytest.fixture(scope="module")
def arm(ur10e: Arm) -> Arm:
    return ur10e


def test_an_observed_gap_is_fitted_at_its_value_and_its_absence_costs_what_it_shows(arm: Arm) -> None:
    fitted = warmed([measured(recording(arm, seed), arm) for seed in (1, 2)])
    bare = started(fitted, Hypothesis.nominal(arm))
    seen = Observed(GAP, GAP / 100)
    f = started(fitted, Hypothesis.nominal(arm, {PAN: seen}))
    assert f.objective - bare.objective == pytest.approx(1e4, rel=1e-6)
    best = scored(f)[0]
    assert best.key == PAN
    with_gap = add(fitted, f, best)
    assert with_gap.accepted[0].parameters["half_gap"] == pytest.approx(GAP, rel=0.2)
    assert f.objective - with_gap.objective > 7e3


def test_the_following_error_of_a_held_out_recording_counts(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    class Searched(Exception):
        """What a search was given."""

    def given(measurements: object, hypothesis: Hypothesis, progress: object) -> None:
        raise Searched(hypothesis)

    monkeypatch.setattr(module, "search", given)
    held_out = commanded(arm, recording(arm, 3, seconds=40.0), GAP)
    fitted = recording(arm, 1)
    assert not np.isfinite(fitted.q_cmd).any()
    for holdout, seen in ((held_out, {PAN}), (replace(held_out, q_cmd=np.full_like(held_out.q, np.nan)), set())):
        with pytest.raises(Searched) as asked:
            module.diagnose(arm, [fitted], [holdout])
        assert set(asked.value.args[0].observed) == seen
