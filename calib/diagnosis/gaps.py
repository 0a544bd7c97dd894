"""Residual RMS of arms on recordings: over rows in motion, and over those in which a joint slides, comparable with noise.

Around a change of direction a position-controlled joint sticks for some hundredths of a second while its drive builds up
torque. Dry friction holds whatever that is, so even the true arm is off there by up to twice the dry friction. No noise is
measured in these rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib.diagnosis.written_arm import moving_rows, rms_where, sliding_rows, torque_errors
from calib.measurement.preprocessing import Measurement
from sim.arm import Arm


def gaps(arms: Mapping[str, Arm], shown: Sequence[Measurement]) -> dict[str, Any]:
    """Per arm the RMS N m of each joint, and the same under `sliding`, with None for a joint that never slides.

    The rows are filtered as in the fit (10 Hz), from the first motion to the last, without those in which the joint stands for
    longer than a pause; all of them for a joint that never moves.
    """
    errors = {key: torque_errors(arm, shown) for key, arm in arms.items()}
    moves, slides = moving_rows(shown), sliding_rows(next(iter(arms.values())), shown)
    whole = {key: [float(x) for x in rms_where(e, moves)] for key, e in errors.items()}
    return whole | {"sliding": {key: _where(e, slides) for key, e in errors.items()}}


def _where(errors: np.ndarray, slides: np.ndarray) -> list[float | None]:
    return [float(np.sqrt(np.mean(e[s] ** 2))) if s.any() else None for e, s in zip(errors.T, slides.T, strict=True)]
