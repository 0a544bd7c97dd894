"""Sums over rows do not depend on portions or order, and stored sums are not computed again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.identification.base_fit import survey
from calib.identification.identify import Identification, identify
from calib.identification.least_squares import estimate
from calib.identification.model import TorqueModel
from calib.identification.portions import context_of
from calib.identification.row_weights import reference
from calib.identification.rows import RegressorRows
from calib.identification.sums import Sums, summed
from calib.measurement.preprocessing import prepare
from calib.regression.information import InformationMatrix
from calib.regression.stored import Kept, digest_of
from logs import Pieces
from logs.log import Log
from sim.arm import Arm
from tests.calib.conftest import fourier_motion, recorded, varied


def joined(logs: list[Log]) -> Log:
    """Recordings joined into one, 0.1 s apart."""
    t, end = [], 0.0
    for log in logs:
        t.append(log.t + end)
        end = t[-1][-1] + 0.1
    names = ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    arrays = {name: np.concatenate([getattr(log, name) for log in logs]) for name in names}
    return replace(logs[0], t=np.concatenate(t), t_host=np.concatenate(t), **arrays)


@pytest.fixture(scope="module")
def logs(ur5e: Arm) -> list[Log]:
    truth = varied(ur5e, 1)
    return [recorded(truth, fourier_motion(ur5e, k, seconds=12.0, rate=125.0), k) for k in range(6)]


@pytest.mark.parametrize("rows", [3, 40, 1000])
def test_the_factor_carries_the_information_of_the_rows(rows: int) -> None:
    rng = np.random.default_rng(rows)
    x = rng.standard_normal((rows, 7)) * 10.0 ** np.arange(7)
    whole = InformationMatrix.of(x)
    assert np.allclose(whole.gram, x.T @ x, rtol=1e-12)
    z = rng.standard_normal(7)
    assert whole.squares(z) == pytest.approx(float(np.sum((x @ z) ** 2)), rel=1e-12)
    parts = [InformationMatrix.of(p) for p in np.array_split(x, 5)]
    for order in (parts, parts[::-1], [InformationMatrix.merged(parts[:2]), InformationMatrix.merged(parts[2:])]):
        merged = InformationMatrix.merged(order)
        assert merged.rows == rows
        assert np.abs(merged.r - whole.r).max() < 1e-12 * np.abs(whole.r).max()


def test_a_factor_sees_what_a_gram_matrix_has_lost() -> None:
    x = np.array([[1.0, 1.0], [1e-9, 0.0]])
    theta = np.array([2.0, -1.0])
    b = x @ theta
    r = InformationMatrix.of(np.column_stack([x, b])).r
    assert np.linalg.solve(r[:2, :2], r[:2, 2]) == pytest.approx(theta, rel=1e-5)
    assert np.linalg.matrix_rank(x.T @ x, tol=1e-16) == 1


def test_sums_do_not_depend_on_portions_or_order(ur5e: Arm, logs: list[Log]) -> None:
    measured = [prepare(log, ur5e, 10.0) for log in logs]
    model = TorqueModel.of_arm(ur5e)
    rows = RegressorRows(model, measured)
    weights = reference(RegressorRows(model, measured[:3]))
    whole = summed(rows, weights)
    each = [summed(RegressorRows(model, [m]), weights) for m in measured]
    expected = estimate(model, whole, weights)
    std = np.sqrt(np.diag(expected.covariance))
    ways = [each, each[::-1], [Sums.merged([each[4], each[1]]), each[0], Sums.merged([each[5], each[3], each[2]])]]
    for way in ways:
        found = estimate(model, Sums.merged(way), weights)
        assert np.abs(found.theta - expected.theta).max() < 1e-9 * np.abs(expected.theta).max()
        assert np.abs((found.theta - expected.theta) / std).max() < 1e-9
        assert np.sqrt(np.diag(found.covariance)) == pytest.approx(std, rel=1e-9)
        assert found.sigma == pytest.approx(expected.sigma, rel=1e-9)


def test_sums_survive_a_file(ur5e: Arm, logs: list[Log]) -> None:
    model = TorqueModel.of_arm(ur5e)
    rows = RegressorRows(model, [prepare(logs[0], ur5e, 10.0)])
    sums = summed(rows, reference(rows))
    again = Sums.of_arrays(sums.arrays())
    assert all(np.array_equal(a, b) for a, b in zip(sums.arrays().values(), again.arrays().values(), strict=True))


def test_rows_over_bridged_gaps_are_less_sure_than_measured_ones(ur5e: Arm, logs: list[Log]) -> None:
    """Two samples are lost at one place. Rows there get less weight, and earlier rows are unchanged."""
    lost = np.ones(len(logs[0]), dtype=bool)
    lost[700:702] = False
    names = ("t", "t_host", "q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    log = replace(logs[0], **{name: getattr(logs[0], name)[lost] for name in names})
    model = TorqueModel.of_arm(ur5e)
    rows = RegressorRows(model, [prepare(log, ur5e, 10.0)])
    weights = reference(RegressorRows(model, [prepare(logs[0], ur5e, 10.0)]))
    (block,) = rows
    own = block.of_joint(1)
    index = own.index
    sure, doubted = (weights.noise.taps(1, own.joined, doubt)[:, 0] for doubt in (None, own.doubt))
    wider = sure / doubted
    near = np.abs(block.t[index] - logs[0].t[701]) < 0.15
    assert wider.max() > 1.05
    assert wider[block.t[index] < logs[0].t[701] - 0.5] == pytest.approx(1.0, rel=1e-12)
    assert near[np.argmax(wider)]
    spoilt = replace(block, doubt=block.doubt * 1e12)
    rows._kept = [spoilt]
    without = replace(block, usable=block.usable & (block.doubt == 0))
    other = RegressorRows(model, rows.measurements)
    other._kept = [without]
    np.testing.assert_allclose(
        summed(rows, weights).white[1].gram, summed(other, weights).white[1].gram, rtol=1e-4, atol=1e-4
    )  # a row of unlimited doubt has no weight


def test_what_is_kept_depends_on_the_speed_that_was_read(ur5e: Arm, logs: list[Log]) -> None:
    log = logs[0]
    assert digest_of(log) != digest_of(replace(log, dq=log.dq + 1e-3))
    weights = reference(RegressorRows(TorqueModel.of_arm(ur5e), [prepare(log, ur5e, 10.0)]))
    contexts = {
        context_of(replace(ur5e, speed_from=speed), 10.0, np.ones(6), np.zeros(6), weights)
        for speed in ("position", "measured")
    }
    assert len(contexts) == 2


def identified(arm: Arm, logs: list[Log], kept: Kept | None = None) -> Identification:
    return identify(arm, logs, kept=kept)


def test_work_that_was_done_is_not_done_again(
    ur5e: Arm, logs: list[Log], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("calib.identification.base_fit.SURVEY_SECONDS", 30.0)
    assert len(survey(logs)) == 2
    kept = Kept(tmp_path)
    first = identified(ur5e, logs, kept)
    files = {f: f.stat().st_mtime_ns for f in tmp_path.iterdir()}
    assert len(files) == 4
    next(iter(files)).unlink()
    again = identified(ur5e, logs, kept)
    redone = [f for f in tmp_path.iterdir() if f.stat().st_mtime_ns != files[f]]
    assert len(redone) == 1
    assert np.array_equal(first.solution.theta, again.solution.theta)
    assert np.array_equal(first.solution.theta, identified(ur5e, logs).solution.theta)


@pytest.mark.slow
def test_pieces_cover_a_log_once(ur5e: Arm, logs: list[Log], monkeypatch: pytest.MonkeyPatch) -> None:
    log = joined(logs)
    assert len(Pieces(log)) == 1
    monkeypatch.setattr("logs.pieces.PIECE_SECONDS", 20.0)
    pieces = Pieces(log)
    assert len(pieces) == 4
    assert np.array_equal(np.concatenate([p.t for p in pieces]), log.t)
    assert sum(pieces.seconds) == pytest.approx(log.t[-1] - log.t[0])
    short, whole = identified(ur5e, list(pieces)), identified(ur5e, [log])
    off = (short.solution.theta - whole.solution.theta) / np.sqrt(np.diag(whole.solution.covariance))
    assert np.abs(off).max() < 1
