"""l(k, theta) = d^T C^-1 d: did the load jump at row theta, and by how much?

A. S. Willsky and H. L. Jones (1976), doi:10.1109/TAC.1976.1101146: a jump at theta leaves a known trace G(k; theta) in the filter's
innovations. For each theta of the last rows C = sum G^T S^-1 G and d = sum G^T S^-1 y are kept; twice the log likelihood ratio is
d^T C^-1 d, and the most likely jump is C^-1 d. Two kinds are compared: a body at the flange (4 numbers), and any torque on the joints (n).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from calib.watch.filter import Innovation, Jump, TorqueFilter
from calib.watch.jump_kernels import advanced

CANDIDATES = 16
ROWS_LEAST = 3  # a single wrong reading affects two rows
# Real arms jump by themselves: gears that change tooth flank reach ratios of 90, where a perfect simulation stays below 30. The threshold
# therefore rises with slow model error (`imperfection`, its size over that of the white noise: 1 or more on a real UR10e, about 0.5 on a
# mock), and with the highest ratio of the recent past. Its least value is what noise alone reaches once in a thousand hours.
THRESHOLD, THRESHOLD_SLOPE, THRESHOLD_LEAST, THRESHOLD_MOST = -20.0, 110.0, 45.0, 150.0
OVER_RECENT, RECENT = 1.6, 20.0
AS_LIKELY = 9.0  # difference in ratio up to which another instant is possible: three standard deviations
CLIP = 8.0  # standard deviations at which one joint of one row is clipped


class JumpDetector:
    """`add` takes every innovation and returns the likeliest jump of the last rows once it is beyond doubt."""

    def __init__(self, filter_: TorqueFilter) -> None:
        self._n, self._size = filter_.n, len(filter_.x)
        prior = filter_.jump_prior()
        torque = (10 * filter_.dry) ** 2
        self._prior = (np.diag(1 / prior), np.diag(1 / torque))
        self._scale, self._reach = filter_.mass_scale, filter_.reach
        self._highest = 0.0
        self.forget()

    def forget(self) -> None:
        """Discard the rows so far: no jump is looked for in them."""
        self._count = 0
        self._lately: deque[float] = deque(maxlen=3 * CANDIDATES)
        kinds = (4, self._n)
        self._lag = tuple(np.zeros((CANDIDATES, self._size, k)) for k in kinds)
        self._c = tuple(np.zeros((CANDIDATES, k, k)) for k in kinds)
        self._d = tuple(np.zeros((CANDIDATES, k)) for k in kinds)
        self._sizes = tuple(np.zeros((CANDIDATES, k)) for k in kinds)
        self._ratio = np.zeros((2, CANDIDATES))

    def add(self, innovation: Innovation, seconds: float, imperfection: float) -> Jump | None:
        """Take one more row; return the jump, if one is found."""
        self._count = min(self._count + 1, CANDIDATES)
        # candidates move one place back, a new one begins at this row
        theta = advanced(
            self._lag, self._c, self._d, innovation.h, innovation.used, innovation.gain, innovation.decay, innovation.inverse, innovation.y,
            CLIP, self._prior, self._count, ROWS_LEAST, self._sizes, self._ratio,
        )  # fmt: skip
        likeliest = float(self._ratio[:, theta].max())
        self._highest *= float(np.exp(-seconds / RECENT))
        least = max(THRESHOLD + THRESHOLD_SLOPE * imperfection, THRESHOLD_LEAST, OVER_RECENT * self._highest)
        if not likeliest > min(least, THRESHOLD_MOST):
            # a jump that is just beginning must not raise the bar for itself
            if len(self._lately) == self._lately.maxlen:
                self._highest = max(self._highest, self._lately[0])
            self._lately.append(likeliest)
            return None
        response = -self._lag[0][theta]
        response[:4] += np.eye(4)
        covariance = self._likely(theta, float(self._sizes[0][theta][0]))
        size = covariance @ self._d[0][theta]
        near = np.flatnonzero(self._ratio.max(axis=0) > likeliest - AS_LIKELY) + 1
        # instants later than that of the youngest candidate were not tried
        latest = 1 if near[0] == ROWS_LEAST else int(near[0])
        return Jump(
            theta + 1, (int(near[-1]), latest), float(self._ratio[0][theta]), float(self._ratio[1][theta]), size, covariance, response,
            self._sizes[1][theta].copy(),
        )  # fmt: skip

    def _likely(self, theta: int, mass: float) -> np.ndarray:
        """Covariance (4, 4) of a jump of about that mass, whose centre lies about a tenth of the reach from the last joint."""
        moment = 0.1 * self._reach * max(abs(mass), 0.05 * self._scale)
        return np.linalg.inv(self._c[0][theta] + np.diag(1 / np.array([self._scale, moment, moment, moment]) ** 2))
