"""The score of real recordings: a known error is reported at its true size, and a recording is cut at the requested times."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.real import EDGE, errors, moved, part
from benchmarks.real_sets import ALL

RATE, SECONDS, CUTOFF = 200.0, 12.0, 8.0
T = np.arange(0.0, SECONDS, 1 / RATE)
# at rest for a second, in motion for ten, then at rest again
SPEED = np.where((T > 1) & (T < 11), 1.0, 0.0)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    file = tmp_path / "recording.csv"
    rows = np.column_stack([357.0 + T, SPEED, -SPEED])
    np.savetxt(file, rows, "%.6f", ",", header="timestamp,actual_qd_0,actual_qd_1", comments="")
    return file


def prediction(folder: Path, error: np.ndarray, skip: int = 0) -> Path:
    """Write prediction.csv of two joints with prediction errors `error` (N, 2). With `skip`, one row in `skip` is missing."""
    file = folder / "prediction.csv"
    tau = np.column_stack([10 * np.sin(2 * T), 4 * np.cos(3 * T)])
    rows = np.column_stack([T, tau, tau - error])
    rows = rows if not skip else rows[np.arange(len(T)) % skip != 3]
    np.savetxt(file, rows, "%.9f", ",", header="t,tau_a,tau_b,tau_hat_a,tau_hat_b", comments="")
    return file


@pytest.mark.parametrize("skip", [0, 7])
def test_an_error_below_the_cutoff_counts_in_full_and_one_above_it_does_not(tmp_path: Path, recording: Path, skip: int) -> None:
    slow, fast = 0.5 * np.sin(2 * np.pi * 1.0 * T), 0.5 * np.sin(2 * np.pi * 60.0 * T)
    e, measured = errors(prediction(tmp_path, np.column_stack([slow, fast]), skip), recording, CUTOFF)
    rms = np.sqrt(np.mean(e**2, axis=0))
    assert rms[0] == pytest.approx(0.5 / np.sqrt(2), rel=0.01)
    assert rms[1] < (0.25 if skip else 0.01) * rms[0]
    assert measured.std(axis=0) == pytest.approx(np.array([10, 4]) / np.sqrt(2), rel=0.05)


def test_only_samples_in_motion_count(tmp_path: Path, recording: Path) -> None:
    """The error is 100 N m before the motion and 1 N m during it."""
    error = np.where(T < 0.6, 100.0, 1.0)[:, None] * np.ones(2)
    e, _ = errors(prediction(tmp_path, error), recording, CUTOFF)
    np.testing.assert_allclose(np.sqrt(np.mean(e**2, axis=0)), 1.0, rtol=0.01)
    assert len(e) == pytest.approx((10 - 2 * EDGE) * RATE, abs=3)


def times(file: Path) -> np.ndarray:
    return np.genfromtxt(file, delimiter=",", skip_header=1)[:, 0] - 357.0


def test_a_recording_is_cut_between_two_times(tmp_path: Path, recording: Path) -> None:
    data = recording.parent
    assert part(data, recording.name, *ALL, tmp_path) == recording
    first, rest = (times(part(data, recording.name, *span, tmp_path)) for span in ((0.0, 4.0), (4.0, 1e9)))
    np.testing.assert_allclose(np.concatenate([first, rest]), T, atol=1e-6)
    assert first[-1] < 4.0 - 1e-9 <= rest[0]
    shares = [times(part(data, recording.name, *span, tmp_path)) for span in ((0.0, 0.6), (0.6, 1.0))]
    np.testing.assert_allclose(np.concatenate(shares), T, atol=1e-6)
    assert shares[1][0] == pytest.approx(0.6 * T[-1], abs=1 / RATE)


def test_the_motion_of_several_recordings_is_their_rms_by_horizon() -> None:
    def validation(*errors: tuple[float, list[float | None], float | None]) -> dict[str, Any]:
        return {"logs": [{"motion": [{"horizon_s": s, "loop": "open", "angle_rad": q, "flange_m": f} for s, q, f in errors]}]}

    found = [validation((0.25, [0.003, 0.004], 0.01), (1.0, [0.03, 0.04], 0.1)), validation((1.0, [0.0, 0.0], 0.0))]
    assert moved(found) == "0.25 s open 3.5 mrad, 10.0 mm; 1 s open 25.0 mrad, 70.7 mm"
    assert moved([*found, validation((1.0, [None, 0.1], None))]).endswith("1 s unstable")
    assert moved([validation()]) == "no window in which every joint moves"
