"""-log det M of the information of a Fourier motion, plus a penalty for exceeded limits, with the exact gradient.

M = P + sum_kj y_kj y_kj^T / sigma_j^2 over samples k and joints j. P is what earlier recordings determined of an identified arm
(`Known`), so that the next one determines what is still unknown. It is zero for a nominal arm, whose values are only assumed.

d(-log det M)/dy_kj = -2 M^-1 y_kj / sigma_j^2; with a slope A, the value is -tr(A M) and its derivative -2 A y_kj / sigma_j^2.
The chain rule leads through the derivatives of the regressor with respect to q, dq and ddq, and through the Fourier basis, to
the coefficients; all of it is exact. Torque is linear in the same regressor, so its limits cost nothing more.
`calib.excitation.geometry` holds the limits in space.
"""

from __future__ import annotations

import numpy as np

from calib.excitation.design import SAMPLES
from calib.excitation.fourier import Fourier
from calib.excitation.geometry import Geometry
from calib.excitation.room import MARGIN, Room
from calib.identification.known import FILE, Known
from calib.identification.model import FRICTION, TorqueModel
from calib.regression.normal_equations import inverse
from drivers.driver import DeviceStop
from safety.parameters import friction_of, parameter_box
from safety.torque import POWER_MAX
from sim.tree import GRAVITY

CONDITION_AIM = 34.0
SMOOTH = 8
CONDITION_WEIGHT = 400.0
RIDGE = 1e-8
# A descent aims slightly inside the limits of `Room`, so that its end needs no shrinking. It uses less of the power, so that
# the hardest stop remains possible: a softer one ends farther away
TIGHTER = {"q": 0.99, "dq": 0.99, "ddq": 0.99, "jerk": 0.99, "torque": 0.8, "power": 0.4}
# Hz: rate at which samples of a filtered log count as independent
INDEPENDENT = 25.0


class Objective:
    """Value, and gradient with respect to the free coefficients x (n, f), of motions about one home posture.

    Columns: base parameters, friction, and the linear candidates of a diagnosis, so that the motion distinguishes them from the
    rest. These are a spring and a quadratic speed law at every joint, and the tilts of the base that change a torque.
    """

    def __init__(
        self,
        room: Room,
        model: TorqueModel,
        sigma: np.ndarray,
        start: Fourier,
        samples: int = SAMPLES,
        weight: float = 300.0,
        capped: bool = True,
        stop: DeviceStop | None = None,
        slope: np.ndarray | float | None = None,
        fine: bool = False,
        about: np.ndarray | None = None,
    ) -> None:
        self.room, self.model, self.capped = room, model, capped
        self.start, n = start, model.arm.n
        # scaled to SAMPLES samples, so that a search may begin with fewer and end with more
        share = SAMPLES / samples
        self.inverse_variance, self.weight = share / sigma**2, weight * share
        self.geometry = Geometry(room, stop or DeviceStop(), start, samples, self.weight, fine, about)
        t = np.arange(samples) * (start.basis.period / samples)
        self._basis = [start.basis.matrix(t, order) for order in range(4)]
        self._stacked = np.concatenate(self._basis)
        arm = model.arm
        self._sign_width = 0.02 * arm.dq_max
        pi, delta = parameter_box(arm, room.cell)
        known = friction_of(arm)
        self._pi = np.concatenate([pi, known.inertia])
        self._viscous, self._coulomb = known.viscous, known.coulomb
        self._delta, self._friction = delta, known
        self._middle = (arm.q_max + arm.q_min) / 2
        most = {"q": (arm.q_max - arm.q_min) / 2, "dq": arm.dq_max, "ddq": arm.ddq_max, "jerk": arm.jerk_max}
        self._limits = np.array([TIGHTER[order] * MARGIN[order] * limit for order, limit in most.items()])
        self._links = model.body.parameters()
        tilts = GRAVITY * np.eye(3)[:2]
        self._tilt = [gravity for gravity in tilts if _felt(model, gravity)]  # parallel axes feel only one
        self._slope = slope
        self.p = len(model.base) + len(FRICTION) * n + 2 * n + len(self._tilt)
        self.prior = np.zeros((self.p, self.p))
        if (model.arm.model_path.parent / FILE).is_file():
            share = SAMPLES / (INDEPENDENT * start.basis.period)
            self.prior[: model.p, : model.p] = share * inverse(Known.of_arm(model.arm).covariance)

    def information(self, x: np.ndarray) -> np.ndarray:
        """(p, p): information of the motion with coefficients x (n, f), without the prior."""
        q, dq, ddq = (b @ x.T for b in self._basis[:3])
        q = q + self.start.home
        columns = self._columns(self._full(q, dq, ddq), q, dq)
        weighted = (columns * self.inverse_variance[:, None]).reshape(-1, self.p)
        return np.asarray(weighted.T @ columns.reshape(-1, self.p))

    def log_det(self, x: np.ndarray) -> float:
        """log det, nats, of the information of the motion with coefficients x (n, f) and the prior."""
        return float(np.linalg.slogdet(self.information(x) + self.prior)[1])

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient (n, f)."""
        rows = (self._stacked @ x.T).reshape(len(self._basis), -1, len(x))
        rows[0] += self.start.home
        q, dq, ddq, _ = rows
        full = self._full(q, dq, ddq)
        columns = self._columns(full, q, dq)
        value, z = self._information(columns)
        more, cond_z = self._condition(columns)
        value += more
        if more:
            z[:, :, : len(self.model.base)] += cond_z
        torque_value, w, by_speed = self._torque(full, dq, ddq)
        value += torque_value
        slopes = np.zeros_like(rows)
        slopes[:3] = self._through_regressor(z, w, q, dq, ddq)
        slopes[1] += by_speed
        rows[0] -= self._middle
        over = np.abs(rows) / self._limits[:, None]
        if over.max() > 1:
            over = np.maximum(over - 1, 0.0)
            value += self.weight * float(np.sum(over**2))
            slopes += 2 * self.weight * over * np.sign(rows) / self._limits[:, None]
        more, gradient = self.geometry(x)
        return value + more, gradient + slopes.reshape(-1, len(x)).T @ self._stacked

    def _full(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return self.model.body.full_regressor(q, dq, ddq)

    def _columns(self, full: np.ndarray, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
        n, b = self.model.arm.n, len(self.model.base)
        out = np.zeros((len(q), n, self.p))
        out[:, :, :b] = full[:, :, self.model.base.columns]
        j = np.arange(n)
        at = b + len(FRICTION) * j
        out[:, j, at] = dq
        out[:, j, at + 1] = np.tanh(dq / self._sign_width)
        out[:, j, at + 2] = 1.0
        candidates = b + len(FRICTION) * n
        out[:, j, candidates + j] = q - self.start.home
        out[:, j, candidates + n + j] = dq * np.abs(dq)
        zero = np.zeros_like(q)
        for k, gravity in enumerate(self._tilt):
            out[:, :, candidates + 2 * n + k] = self.model.body.inverse_dynamics(q, zero, zero, gravity)
        return out

    def _information(self, columns: np.ndarray) -> tuple[float, np.ndarray]:
        """-log det M, or -tr(A M) with a slope A, and its gradient (K, n, p) with respect to the columns."""
        rows = columns.reshape(-1, self.p)
        weighted = (columns * self.inverse_variance[:, None]).reshape(-1, self.p)
        if self._slope is not None:
            z = weighted @ (self._slope * np.ones((self.p, self.p)))
            return -float(np.sum(z * rows)), -2 * z.reshape(columns.shape)
        m = weighted.T @ rows + self.prior
        scale = 1 / np.sqrt(np.diag(m) + 1e-300)
        scaled = m * np.outer(scale, scale) + RIDGE * np.eye(len(m))
        _, log_det = np.linalg.slogdet(scaled)
        value = -(log_det - 2 * np.sum(np.log(scale)))
        inverse = np.linalg.inv(scaled) * np.outer(-2 * scale, scale)
        return float(value), (weighted @ inverse).reshape(columns.shape)

    def _condition(self, columns: np.ndarray) -> tuple[float, np.ndarray]:
        """(log cond - log aim)^2 above the aim, of the base regressor in SI units, times a weight; and its gradient (K, n, b).

        cond^2 = (sum l^P)^(1/P) (sum l^-P)^(1/P) over the eigenvalues l, with P = SMOOTH: never below the true one, and smooth
        where two of them meet. The gradient is with respect to the base columns; it is empty (0,) where the value is zero.
        """
        base = columns[:, :, : len(self.model.base)].reshape(-1, len(self.model.base))
        eigen, vectors = np.linalg.eigh(base.T @ base)
        high, low = eigen[-1], max(float(eigen[0]), 1e-12 * float(eigen[-1]))
        large, small = (eigen / high) ** SMOOTH, (low / np.maximum(eigen, low)) ** SMOOTH
        over = 0.5 * (np.log(high / low) + np.log(large.sum() * small.sum()) / SMOOTH) - np.log(CONDITION_AIM)
        if over <= 0 or not self.capped:
            return 0.0, np.zeros(0)
        by_log = large / large.sum() - small / small.sum()
        slope = base @ ((vectors * (by_log / np.maximum(eigen, low))) @ vectors.T)
        return CONDITION_WEIGHT * over**2, 2 * CONDITION_WEIGHT * over * slope.reshape(*columns.shape[:2], -1)

    def _torque(self, full: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Penalty for torque and power beyond their limits, uncertainty included.

        Its gradients (K, n) are with respect to torque and to speed.
        """
        n = self.model.arm.n
        smooth = np.tanh(dq / self._sign_width)
        tau = full @ self._pi + self._viscous * dq + self._coulomb * smooth
        f = self._friction
        doubt = np.abs(full[:, :, : 10 * n]) @ self._delta + f.coulomb_doubt
        doubt += f.inertia_doubt * np.abs(ddq) + f.viscous_doubt * np.abs(dq)
        limit = TIGHTER["torque"] * MARGIN["torque"] * self.room.arm.tau_max
        worst = np.abs(tau) + doubt
        over = np.maximum(worst / limit - 1, 0.0)
        slope = 2 * self.weight * over * np.sign(tau) / limit
        most = TIGHTER["power"] * POWER_MAX
        beyond = np.maximum(np.sum(worst * np.abs(dq), axis=1) / most - 1, 0.0)
        share = (2 * self.weight * beyond / most)[:, None]
        value = self.weight * float(np.sum(over**2) + np.sum(beyond**2))
        return value, slope + share * np.abs(dq) * np.sign(tau), share * worst * np.sign(dq)

    def _through_regressor(
        self, z: np.ndarray, w: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray
    ) -> list[np.ndarray]:
        """Gradients (K, n) of sum z . columns + w . torque with respect to q, dq and ddq."""
        n, body = self.model.arm.n, self.model.body
        weights = np.einsum("kj,p->kjp", w, self._pi)
        weights[:, :, self.model.base.columns] += z[:, :, : len(self.model.base)]
        j, zero = np.arange(n), np.zeros_like(q)
        slopes = [*body.slopes(q, dq, ddq, weights[:, :, : 10 * n])]
        slopes[2] += weights[:, j, 10 * n + j]
        for tilt, gravity in enumerate(self._tilt):
            slopes[0] += body.slopes(q, zero, zero, z[:, :, tilt - len(self._tilt), None] * self._links, gravity)[0]
        b = len(self.model.base)
        at, candidates = b + len(FRICTION) * j, b + len(FRICTION) * n
        bend = (1 - np.tanh(dq / self._sign_width) ** 2) / self._sign_width
        slopes[1] += z[:, j, at] + z[:, j, at + 1] * bend + z[:, j, candidates + n + j] * 2 * np.abs(dq)
        slopes[1] += w * (self._viscous + self._coulomb * bend) + np.abs(w) * self._friction.viscous_doubt * np.sign(dq)
        slopes[2] += np.abs(w) * self._friction.inertia_doubt * np.sign(ddq)
        slopes[0] += z[:, j, candidates + j]
        return slopes


def _felt(model: TorqueModel, gravity: np.ndarray) -> bool:
    """Whether gravity (3,) m/s^2 causes a torque in any of some postures."""
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (20, model.arm.n))
    torque = model.body.inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q), gravity)
    return bool(np.abs(torque).max() > 1e-9 * max(float(model.arm.tree.mass.sum()), 1.0))
