"""Random feasible Fourier motions, and what a motion would determine: log det and condition number of its information."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.room import MARGIN, Room, Use
from calib.identification.model import TorqueModel
from safety.parameters import missing_facts
from sim.arm import Arm
from sim.errors import AnswerIsNo
from sim.postures import postures
from sim.trajectory import Trajectory

SAMPLES = 120
# rad, and share of a joint's range: dry friction and gears hide smaller motions
LEAST_REACH, LEAST_SHARE = (0.1, 0.02)
# share of the amplitude at which each joint meets its own limits; a motion that only fits with less is rejected
LEAST_SCALE = 0.15
# power of the period with which a motion at that limit grows
GROWTH = {"dq": 1, "ddq": 2, "jerk": 3}
# share of a torque limit above which few other starts are possible
STRAINED = 0.6
# share of random postures that the torque limits cannot hold, above which few starts are possible
MOSTLY = 0.5
# multiples of the period that are tried for a path that does not fit
SLOWER = (1.1, 1.25, 1.5, 2.0, 3.0)


@dataclass(frozen=True)
class Worth:
    """log det (nats) of the noise-weighted information; condition numbers of base regressor (SI units) and scaled columns."""

    log_det: float
    condition: float
    condition_scaled: float


class Information:
    """Information of a motion on the columns of a model, with each joint's rows weighted by its torque noise."""

    def __init__(self, model: TorqueModel, sigma: np.ndarray) -> None:
        self.model, self.sigma = model, sigma

    def worth(self, motion: Trajectory) -> Worth:
        """The worth of a motion's samples."""
        a = self.model.columns(motion.q, motion.dq, motion.ddq)
        b = len(self.model.base)
        base = a[:, :, :b].reshape(-1, b)
        whitened = (a / self.sigma[:, None]).reshape(-1, self.model.p)
        gram = whitened.T @ whitened
        norm = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = np.linalg.eigvalsh(gram / np.outer(norm, norm))
        sign, log_det = np.linalg.slogdet(gram)
        raw = np.linalg.svd(base, compute_uv=False)
        return Worth(
            float(log_det) if sign > 0 else -np.inf,
            float(raw[0] / raw[-1]) if raw[-1] > 0 else np.inf,
            float(np.sqrt(scaled[-1] / scaled[0])) if scaled[0] > 0 else np.inf,
        )


def noise_of(arm: Arm) -> np.ndarray:
    """(n,) N m: the arm's torque noise, or a hundredth of its torque scale where the arm states none."""
    from sim.prior import torque_scale

    sigma = np.array(arm.sensors.torque_noise, dtype=float)
    return np.where(sigma > 0, sigma, 0.01 * torque_scale(arm))


def fitted_to_room(room: Room, motion: Fourier, grow: bool = True) -> Fourier | None:
    """Return the motion at the largest amplitude that fits, or None if LEAST_SCALE of it does not fit either.

    Each joint is scaled to its own limits first, then all together to torque, speed and clearance. Without `grow` no joint's
    amplitude increases.
    """
    own = own_scale(room, motion)
    motion = motion.scaled(own if grow else np.minimum(own, 1.0))
    for slightly in (1.0, 0.99, 0.97, 0.94):
        if room.use(coarse(motion.scaled(slightly))).fits:
            return motion.scaled(slightly)
    low, high = 0.0, 0.94
    for _ in range(7):
        middle = (low + high) / 2
        low, high = (middle, high) if room.use(coarse(motion.scaled(middle))).fits else (low, middle)
        if high <= LEAST_SCALE:
            return None
    return motion.scaled(low) if low > LEAST_SCALE else None


def random_start(
    room: Room, information: Information, basis: Basis, home: np.ndarray, rng: np.random.Generator, tries: int
) -> tuple[Fourier, Worth]:
    """Return the most informative of `tries` random motions that fit; AnswerIsNo names the binding limit if none fits."""
    best: tuple[Fourier, Worth] | None = None
    for _ in range(tries):
        found = fitted_to_room(room, random_fourier(basis, home, rng))
        if found is None:
            continue
        worth = information.worth(coarse(found))
        if best is None or worth.log_det > best[1].log_det:
            best = (found, worth)
    if best is None:
        raise AnswerIsNo(f"{room.arm.name}: {binding(room, basis, home)}")
    return best


def binding(room: Room, basis: Basis, home: np.ndarray) -> str:
    """Sentence: why no motion fits about `home`, and the remedy."""
    still = Trajectory(np.array([0.0, 0.1]), np.stack([home, home]), np.zeros((2, len(home))), np.zeros((2, len(home))))
    use = room.use(still)
    if use.clearance < CLEARANCE_MARGIN:
        return f"the start {np.round(home, 3).tolist()} rad brings {_too_near(room, use)}"
    name, share = use.worst
    if share > 1:
        j = int(np.argmax(use.shares[name])) if len(use.shares[name]) == room.arm.n else 0
        return (
            f"{room.arm.joint_names[j]}: standing still at the start uses {share:.0%} of its {name} limit (less margin); give another "
            "start with --home, or correct the limit"
        )
    trial = random_fourier(basis, home, np.random.default_rng(0))
    trial = trial.scaled(0.2 * own_scale(room, trial))
    use = room.use(coarse(trial))
    name, share = use.worst
    if share <= 1:
        return (
            f"no motion of useful size fits: a fifth of the full amplitude brings {_too_near(room, use)}{_strained(room, use)}"
        )
    own = use.shares[name]
    worst = int(np.argmax(own)) if len(own) == room.arm.n else None
    where = "the " if worst is None else f"{room.arm.joint_names[worst]}'s "
    remedy = "another --home"
    if name != "q" and (slower := _slow_enough(room, trial, name)):
        remedy = f"a longer --period (about {slower:.3g} s instead of {basis.period:g}) or {remedy}"
    missing = missing_facts(room.arm, worst) if name == "torque" and worst is not None else ""
    return f"no motion of useful size fits: a fifth of the full amplitude takes {share:.0%} of {where}{name} limit; give {remedy}, or a wider limit{missing}"


def _strained(room: Room, use: Use) -> str:
    """Sentence: which torque leaves few roomier postures, if values that determine it are unstated; otherwise empty."""
    j = int(np.argmax(use.shares["torque"]))
    share, missing = float(use.shares["torque"][j]) / MARGIN["torque"], missing_facts(room.arm, j)
    if share >= STRAINED and missing:
        return f". {room.arm.joint_names[j]} takes {share:.0%} of its torque limit there, so few other starts are possible{missing}"
    over = room.holding(postures(room.arm)) > 1
    often, j = float(over.any(axis=1).mean()), int(np.argmax(over.mean(axis=0)))
    missing = missing_facts(room.arm, j)
    if often < MOSTLY or not missing:
        return ""
    return (
        f". In {often:.0%} of random postures the torque limits do not hold the arm, most often that of {room.arm.joint_names[j]}, so few other "
        f"starts are possible{missing}"
    )


def _slow_enough(room: Room, motion: Fourier, name: str) -> float | None:
    """Period s at which the same path keeps limit `name`; None if it does at none of SLOWER times its own period."""
    for times in SLOWER:
        basis = Basis(motion.basis.harmonics, times * motion.basis.period)
        shares = room.use(coarse(Fourier(basis, motion.home, motion.x / times))).shares
        if float(np.max(shares[name])) <= MARGIN[name]:
            return basis.period
    return None


def _too_near(room: Room, use: Use) -> str:
    """Clause: which bodies are too near each other, by how much, and the remedy."""
    obstacle = next((o.name for o in room.cell.table.obstacles if o.name in use.pair), None)
    short = (CLEARANCE_MARGIN - use.clearance) * 1e3
    return (
        f"{use.pair[0]} and {use.pair[1]} {short:.0f} mm nearer to each other than the cell's margin and its following error allow; give "
        f"another start with --home{f', or move {obstacle}' if obstacle else ''}"
    )


def too_small(room: Room, motion: Fourier) -> str | None:
    """Sentence: which joint moves too little, what limits it, and the remedy; None if every joint moves enough."""
    arm, q = room.arm, coarse(motion).q
    needed = np.minimum(LEAST_REACH, LEAST_SHARE * (arm.q_max - arm.q_min))
    share = np.ptp(q, axis=0) / needed
    j = int(np.argmin(share))
    if share[j] >= 1:
        return None
    factors = _own_factors(room, motion)
    name = min(factors, key=lambda k: float(factors[k][j]))
    reach = f"{arm.joint_names[j]} moves through {np.ptp(q[:, j]):.2g} rad, but at least {needed[j]:.2g} rad are needed to determine its parameters"
    if share[j] * factors[name][j] >= 1:  # alone it would move enough
        use = room.use(coarse(motion))
        held = (
            f"{use.pair[0]} near {use.pair[1]}"
            if use.clearance < 2 * CLEARANCE_MARGIN
            else f"the {use.worst[0]} limit of all joints together"
        )
        return f"{reach}; {held} restricts it: give another start with --home, or more room"
    if name == "q":
        return f"{reach}; the start is too near q_min or q_max: give another with --home, farther from both"
    period = motion.basis.period / (share[j] * factors[name][j]) ** (1 / GROWTH[name])
    limit = float(getattr(arm, f"{name}_max")[j])
    return (
        f"{reach}; {name}_max of {limit:g} restricts it at a period of {motion.basis.period:g} s: give a --period of {period:.2g} s or more, or "
        f"a larger {name}_max in arm.toml if the arm allows it"
    )


def own_scale(room: Room, motion: Fourier) -> np.ndarray:
    """(n,) factor that brings each joint to the first of its limits of position, speed, acceleration and jerk."""
    return np.maximum(np.min(list(_own_factors(room, motion).values()), axis=0), 0.0)


def _own_factors(room: Room, motion: Fourier) -> dict[str, np.ndarray]:
    """Limit -> factor (n,) that brings each joint to it."""
    arm, t = room.arm, np.linspace(0, motion.basis.period, 400)
    rows = [motion.basis.matrix(t, k) @ motion.x.T for k in range(4)]
    middle, half = (arm.q_max + arm.q_min) / 2, MARGIN["q"] * (arm.q_max - arm.q_min) / 2
    up, down = rows[0].max(axis=0), -rows[0].min(axis=0)
    factors = {
        "q": np.minimum(
            (middle + half - motion.home) / np.maximum(up, 1e-9), (motion.home - middle + half) / np.maximum(down, 1e-9)
        )
    }
    for row, name in zip(rows[1:], ("dq", "ddq", "jerk"), strict=True):
        limit = getattr(arm, f"{name}_max")
        factors[name] = 0.999 * MARGIN[name] * limit / np.maximum(np.abs(row).max(axis=0), 1e-9)
    return factors


def coarse(motion: Fourier) -> Trajectory:
    """One period at SAMPLES samples, which resolves the highest harmonics; information is compared on these."""
    return motion.sampled(SAMPLES / motion.basis.period)
