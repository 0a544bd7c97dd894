"""x = [m, m c, dF_c, dF_v, e]: a Kalman filter over the rows of the momentum balance.

    d = Y (m, m c, I(m, c)) + dF_c slip + dF_v dq + e + white noise

m (kg) and m c (kg m) are those of the body at the flange beyond what the model has. dF_c and dF_v, the changes of dry and viscous
friction of every joint, are random walks. e, the torque that no model explains, is a Gauss-Markov process with a correlation time of
`MEMORY` seconds: without it, the filter would take a model error that lasts a second for hundreds of independent observations. The
sizes of e and of the white noise are estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.watch.kernels import left, predicted, sizes, updated
from calib.watch.momentum import Row
from sim.arm import Arm
from sim.prior import unstated
from sim.tree import GRAVITY

MEMORY = 0.4  # s; residuals of an identified UR10e have lost half their correlation after 0.3 s
SLOWEST = 0.02  # rad/s: below it, dry friction is not known
PAYLOAD_WALK = 0.004  # of the mass scale per sqrt(s): about ten seconds are remembered
SMALL = 0.1  # least share of a joint's friction that is taken as the size of its dry or viscous part
FRICTION_WALK = 0.006  # of the friction per sqrt(s)
REVERSAL_DOUBT, REVERSAL_SPEED = (
    0.15,
    0.05,
)  # share of dry friction that is uncertain as a joint reverses, and the speed, rad/s, over which this decays
OUTLIER = 4.0  # standard deviations beyond which a row loses weight
LEARNT = 3.0  # s of motion that the first guesses of the noise sizes count as; with less, real recordings gave false claims
CLIP = 3.0  # standard deviations at which one row is clipped when the noise sizes are estimated
NOISE_MEMORY = 20.0  # s of motion over which the noise sizes are estimated


@dataclass(frozen=True, slots=True)
class Innovation:
    """Innovation of a row before the update: used (n,) joints, y (k,), inverse (k, k) of S, h (k, x), gain (x, k), decay (x,) and NIS."""

    used: np.ndarray
    y: np.ndarray
    inverse: np.ndarray
    h: np.ndarray
    gain: np.ndarray
    decay: np.ndarray
    nis: float

    @property
    def degrees(self) -> int:
        """Number of joints for which the row was informative."""
        return len(self.y)


@dataclass(frozen=True, slots=True)
class Jump:
    """A change of the load.

    rows since it, and the range `between` that is about as likely; payload_ratio and torque_ratio, twice its log likelihood ratio as a
    payload and as any torque on the joints; size (4,) of [m, m c] with its covariance; response (x, 4), the change still due in the
    filter's state per unit of size; torque (n,) N m.
    """

    rows: int
    between: tuple[int, int]
    payload_ratio: float
    torque_ratio: float
    size: np.ndarray
    covariance: np.ndarray
    response: np.ndarray
    torque: np.ndarray


@dataclass(frozen=True, slots=True)
class FilterState:
    """The filter's state x and covariance P at one row."""

    x: np.ndarray
    covariance: np.ndarray


class TorqueFilter:
    """Kalman filter of payload and friction.

    `mass_scale` kg is what an arm of this strength carries; `dry` (n,) N m and `wet` (n,) N m s/rad are the size of its joints' friction.
    """

    def __init__(self, arm: Arm, coulomb: np.ndarray, viscous: np.ndarray, first: np.ndarray) -> None:
        """`first` (4,) is the prior mean of [m, m c] of what is mounted."""
        n = self.n = arm.n
        self.mass_scale, self.reach = carrying_scale(arm)
        cruise = 0.25 * np.where(np.isfinite(arm.dq_max), arm.dq_max, 2.0)
        torque = np.array(arm.sensors.torque_noise) if any(arm.sensors.torque_noise) else 0.005 * np.where(np.isfinite(arm.tau_max), arm.tau_max, 1.0)  # fmt: skip
        nobody = unstated(arm)
        # (n,); for the other joints `dry` is only a guess at its size
        self.states_dry, states_wet = (coulomb > 0) & ~nobody["coulomb"], (viscous > 0) & ~nobody["viscous"]
        friction = np.where(self.states_dry & states_wet, coulomb + viscous * cruise, 10 * torque)
        # a part that the arm states as almost nothing may still grow: its size is not that of the statement
        self.dry = np.where(self.states_dry, np.maximum(coulomb, SMALL * friction), 0.3 * friction)
        self.wet = np.where(states_wet, np.maximum(viscous, SMALL * friction / cruise), 0.3 * friction / cruise)
        self.payload, self.coulomb, self.viscous, self.unknown = (
            slice(0, 4),
            slice(4, 4 + n),
            slice(4 + n, 4 + 2 * n),
            slice(4 + 2 * n, 4 + 3 * n),
        )
        size = 4 + 3 * n
        # replaced, never changed in place
        self.x = np.zeros(size)
        self.x[:4] = first
        self._white = self._spread = 0.5 * torque**2  # long-run variance of the white noise, and its variance in one row
        self._slow = (0.3 * torque + 0.05 * friction) ** 2
        self._floor = 1e-4 * self.dry**2
        self._moved = 0.0
        self._usable: tuple[Row, np.ndarray] | None = None
        # residuals of the last three rows, newest first; the joints used in each; the number of rows without a pause
        self._left, self._recent_used, self._rows = np.zeros((3, n)), np.zeros((3, n), dtype=bool), 0
        # mean products of a residual with itself, with that of the row before, and with that of the one before that
        self._products = np.stack([self._white + self._slow, 0.25 * self._white + 0.95 * self._slow, 0.9 * self._slow])
        self.covariance = np.diag(
            np.concatenate([self.payload_prior(), (0.3 * self.dry) ** 2, (0.3 * self.wet) ** 2, self._slow])
        )
        self._walk = np.concatenate(
            [PAYLOAD_WALK**2 * self.jump_prior(), (FRICTION_WALK * self.dry) ** 2, (FRICTION_WALK * self.wet) ** 2, np.zeros(n)]
        )

    def jump_prior(self) -> np.ndarray:
        """(4,) variances of a change of [m, m c]."""
        moment = self.mass_scale * 0.1 * self.reach
        return np.array([self.mass_scale, moment, moment, moment]) ** 2

    def payload_prior(self) -> np.ndarray:
        """(4,) variances of what may be mounted at the start."""
        return 4 * self.jump_prior()

    @property
    def noise(self) -> np.ndarray:
        """(n,) N m standard deviation of a row about the model."""
        return np.sqrt(self._white + self._slow)

    @property
    def imperfection(self) -> float:
        """Largest ratio, over the joints, of slow model error to white noise."""
        return float(np.sqrt(np.max(self._slow / self._white)))

    def snapshot(self) -> FilterState:
        """The present state; its arrays are never changed in place."""
        return FilterState(self.x, self.covariance)

    def restore(self, earlier: FilterState) -> None:
        """Return to an earlier state, with e reset to zero and its stationary variance."""
        self.x, self.covariance = earlier.x, earlier.covariance.copy()
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Set e to zero, with its stationary variance; the covariance is changed in place."""
        self.x = self.x.copy()
        self.x[self.unknown] = 0.0
        self.covariance[self.unknown, :] = self.covariance[:, self.unknown] = 0.0
        self.covariance[self.unknown, self.unknown] = np.diag(self._slow)

    def usable(self, row: Row) -> np.ndarray:
        """(n,) joints whose row is informative: they slide one way, fast enough, and every number is finite."""
        if self._usable is None or self._usable[0] is not row:
            finite = np.isfinite(row.residual) & np.isfinite(row.payload).all(axis=1)
            self._usable = (row, row.sliding & (row.slowest >= SLOWEST) & finite)
        return self._usable[1]

    def left(self, row: Row, x: np.ndarray) -> np.ndarray:
        """(n,) N m residual of a row after payload and friction of state x."""
        out = np.empty(self.n)
        left(row.residual, row.payload, row.slip, row.speed, x, 0.02 * self.mass_scale, 0.5 * self.reach, out)
        return out

    def add(self, row: Row, learn: bool = True, trust: bool = False) -> Innovation | None:
        """Update with one row; None where no joint is informative. `learn` updates the noise sizes; `trust` gives outliers full weight."""
        used = self.usable(row)
        self._predict(row.seconds)
        if not used.any():
            self._rows = 0
            return None
        k = int(np.count_nonzero(used))
        h, y, inverse, gain = np.empty((k, len(self.x))), np.empty(k), np.empty((k, k)), np.empty((len(self.x), k))
        doubt = REVERSAL_DOUBT * self.dry * np.exp(-row.slowest / REVERSAL_SPEED)
        self.x, self.covariance, nis = updated(
            used, row.payload, row.slip, row.speed, self.left(row, self.x), self.x, self.covariance, self._white, self._spread, doubt,
            np.inf if trust else OUTLIER, h, y, inverse, gain,
        )  # fmt: skip
        found = Innovation(used, y, inverse, h, gain, self._decay, nis)
        if learn:
            self._learn(row, used)
        return found

    def shift(self, jump: Jump) -> None:
        """x += response size, P += response covariance response^T: a change that is known to have happened."""
        self.x = self.x + jump.response @ jump.size
        self.covariance = self.covariance + jump.response @ jump.covariance @ jump.response.T

    def open(self) -> None:
        """Add the covariance of a change to that of the payload, which may have become anything; e, which holds part of it, begins anew."""
        self.covariance = self.covariance.copy()
        self.covariance[self.payload, self.payload] += np.diag(self.jump_prior())
        self._begin_anew()

    def _predict(self, seconds: float) -> None:
        self._decay = np.ones(len(self.x))
        self._decay[self.unknown] = np.exp(-seconds / MEMORY)
        first = self.unknown.start
        self.x, self.covariance = predicted(self.x, self.covariance, self._decay, self._walk, seconds, self._slow, first)

    def _learn(self, row: Row, used: np.ndarray) -> None:
        """Estimate the sizes of e and of the white noise from products of a row's residual with those of one and two rows before.

        Neighbouring rows share half of their window, so only rows two apart are correlated through e alone. What neighbours share
        beyond e counts as white noise with its long-run variance.
        """
        self._rows += 1
        self._moved += row.seconds * (self._rows >= 3)
        gain = row.seconds / min(max(self._moved, LEARNT), NOISE_MEMORY) if self._rows >= 3 else 0.0
        self._slow, self._spread, self._white = sizes(
            self._left, self._recent_used, self.left(row, self.x), used, gain, np.exp(-row.seconds / MEMORY), CLIP, self._floor, self._products,
            self._slow, self._white,
        )  # fmt: skip


def carrying_scale(arm: Arm) -> tuple[float, float]:
    """Mass kg that takes a fifth of the strongest joint's torque at full reach, and that reach m."""
    reach = arm.tree.reach or 1.0
    strongest = float(np.max(np.where(np.isfinite(arm.tau_max), arm.tau_max, 0.0)))
    strength = strongest or 10.0
    return 0.2 * strength / (GRAVITY * reach), reach
