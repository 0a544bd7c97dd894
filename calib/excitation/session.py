"""Session plan: the motions that an operator records, in order, each verified by safety.clear.

friction    each joint in turn at constant speeds both ways, then a small chirp of all joints (0.5 to 7 Hz)
excitation  the informative Fourier motion, whole periods
validation  another Fourier motion, which no fit uses
probes      reversal ladder, the excitation's path at half speed, static holds
discriminate  the motion that best separates two explanations left by a diagnosis
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.excitation.cleared_motions import bring_up, cleared_fourier, probes, thinned
from calib.excitation.design import Information, Worth, binding, coarse, fitted_to_room, noise_of, random_start, too_small
from calib.excitation.discriminate import Pair, discriminating
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.home import home_of
from calib.excitation.optimise import Site, optimised, preference
from calib.excitation.reaches import sweep_range
from calib.excitation.room import Room
from calib.excitation.sweeps import GENTLE, friction_sweeps, overlay
from calib.identification.model import TorqueModel
from drivers import open_driver
from safety.latency import stop_to_plan_for
from safety.plan import Motion
from sim.arm import Arm
from sim.cell import Cell
from sim.errors import AnswerIsNo, SafetyStop
from sim.trajectory import Trajectory

Progress = Callable[[str, float], None]
SHRINK = 0.85
ATTEMPTS = 24
# shares of the range, speed and acceleration of the sweeps and the chirp
GENTLER = (1.0, 0.7, 0.5, 0.35, 0.25)


@dataclass(frozen=True)
class Session:
    """Settings of a session plan.

    period, harmonics  s and order of the Fourier motions
    periods            whole periods of the excitation
    tries, starts      random motions tried; starts of the optimiser, 0 for the best random motion
    probes             whether probes are added
    speeds, cruise     speeds of the sweeps as shares of dq_max, each held for about `cruise` s
    chirp              s, its duration
    home               (n,) rad; None to search for one
    progressive        whether motions for a first bring-up come first
    seed               of the random motions
    apart              effects that one more motion is to distinguish from their rivals
    """

    period: float = 20.0
    harmonics: int = 6
    periods: int = 2
    tries: int = 100
    starts: int = 8
    probes: bool = True
    speeds: tuple[float, ...] = (0.03, 0.1, 0.25)
    cruise: float = 3.0
    chirp: float = 20.0
    home: np.ndarray | None = None
    progressive: bool = False
    apart: tuple[Pair, ...] = ()
    seed: int = 0


QUICK = Session(periods=1, tries=40, starts=0, probes=False, speeds=(0.06, 0.2), cruise=1.2, chirp=10.0)


@dataclass(frozen=True)
class Designed:
    """Motions that safety.clear accepts, the worth of the excitation, and the summary that the plan stores."""

    motions: tuple[Motion, ...]
    worth: Worth
    home: np.ndarray
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def duration(self) -> float:
        """Duration of all motions at full speed, s."""
        return sum(m.trajectory.duration for m in self.motions)


def design(arm: Arm, cell: Cell, session: Session, progress: Progress = lambda stage, share: None) -> Designed:
    """Plan the session for this arm in this cell.

    AnswerIsNo names the binding limit if no motion fits. SafetyStop carries the refusal of safety.clear if shrinking does not
    help.
    """
    stop = stop_to_plan_for(open_driver(cell, arm), cell)
    room = Room(arm, cell, stop)
    rng = np.random.default_rng(session.seed)
    home = home_of(room, cell, session.home, rng)
    model = TorqueModel.of_arm(arm)
    information = Information(model, noise_of(model.arm))
    basis = Basis(session.harmonics, session.period)
    rate = min(arm.sensors.rate, 500.0)
    progress("excitation", 0.0)
    best, _ = random_start(room, information, basis, home, rng, session.tries)
    small = too_small(room, best)
    if small:
        raise AnswerIsNo(f"{arm.name}: {small}")
    search = None
    if session.starts:
        search = optimised(Site(arm, cell, stop), best, session.starts, session.seed, progress)
        best = max((best, search.ends[0].motion), key=lambda m: preference(information.worth(coarse(m))))
    progress("checking the excitation", 0.0)
    excitation, kept = cleared_fourier(best, room, rate, session.periods)
    motions = bring_up(room, basis, home, rate, rng) if session.progressive else []
    progress("friction", 0.0)
    motions.append(Motion("friction", "friction", cleared_friction(room, home, session, rate)))
    motions.append(Motion("excitation", "excitation", excitation))
    progress("validation", 0.0)
    other = None
    for _ in range(20):
        other = other or fitted_to_room(room, random_fourier(basis, home, rng))
    if other is None:
        raise AnswerIsNo(f"{arm.name}: {binding(room, basis, home)}")
    motions.append(Motion("validation", "validation", cleared_fourier(other, room, rate)[0]))
    if session.probes:
        motions += [Motion(name, "probe", motion) for name, motion in probes(room, home, kept, rate)]
    separated = None
    if session.apart:
        progress("distinguishing effects", 0.0)
        parting, separated = discriminating(room, session.apart, basis, home, rng, max(8, session.tries // 5), stop)
        motions.append(Motion("discriminate", "probe", cleared_fourier(parting, room, rate)[0]))
    for motion in motions:
        progress(f"checking {motion.name}", 0.0)
        if motion.kind not in ("excitation", "validation", "friction"):
            room.clear(motion.trajectory)
    worth = information.worth(kept.sampled(1000 / basis.period))
    weak = [e for e, known in identifiable(model, information, kept).items() if not known]
    summary = {
        "condition_number": float(worth.condition),
        "condition_scaled": float(worth.condition_scaled),
        "log_det": float(worth.log_det),
        "identifiable": [e for e in model.names if e not in weak],
        "not_identifiable": weak,
        "home": [float(x) for x in home],
        "never_part": [f"{a} and {b}: {why}" for (a, b), why in room.clearance.excluded.items()],
        "harmonics": session.harmonics,
        "period_s": float(session.period),
        "periods": session.periods,
        "starts": session.starts,
        **({} if search is None else {"gap_estimate_nats": float(search.gap), "gap_estimate_std_share": search.smaller}),
        **({} if separated is None else {"separation_sigma": separated}),
        "seed": session.seed,
    }
    return Designed(tuple(motions), worth, home, summary)


def identifiable(model: TorqueModel, information: Information, motion: Fourier) -> dict[str, bool]:
    """Whether one period determines each parameter to CONTRACTION of its prior or RELATIVE of its value, at the arm's noise.

    Samples at 25 Hz count as independent, which is what a filter of about 8 Hz leaves.
    """
    from calib.identification.estimates import CONTRACTION, RELATIVE
    from calib.identification.prior import nominal_prior
    from calib.regression.normal_equations import inverse

    path = motion.sampled(25.0)
    a = model.columns(path.q, path.dq, path.ddq)
    gram = np.einsum("kjp,j,kjr->pr", a, 1 / information.sigma**2, a)
    std = np.sqrt(np.diag(inverse(gram)))
    prior = nominal_prior(model.arm, model)
    before = np.sqrt(np.diag(inverse(prior.precision)))
    known = (std < CONTRACTION * before) | (std < RELATIVE * np.abs(prior.mean))
    return dict(zip(model.names, known.tolist(), strict=True))


def cleared_friction(room: Room, home: np.ndarray, session: Session, rate: float) -> Trajectory:
    """Sweeps joint by joint, with ranges and speeds that fit, then the chirp; gentler while safety.clear refuses.

    SafetyStop if it refuses the gentlest as well.
    """
    arm = room.arm
    low, high = home.copy(), home.copy()
    speeds = np.outer(arm.dq_max, session.speeds)
    for j in range(arm.n):
        low[j], high[j], speeds[j] = sweep_range(room, home, j, speeds[j])
    size = 0.12 * arm.dq_max
    for k, share in enumerate(GENTLER):
        gentle = share * GENTLE
        sweeps = friction_sweeps(
            arm, home, home + share * (low - home), home + share * (high - home), share * speeds, session.cruise, rate, gentle
        )
        motion = joined(sweeps, _chirp(room, home, share * size, session.chirp, rate, gentle))
        try:
            room.clear(motion)
            return motion
        except SafetyStop:
            if k == len(GENTLER) - 1:
                raise
    raise AssertionError("GENTLER is not empty")


def _chirp(room: Room, home: np.ndarray, size: np.ndarray, seconds: float, rate: float, gentle: float) -> Trajectory:
    """Chirp with as much of its size as fits."""
    chirp = overlay(room.arm, home, size, seconds, rate, gentle)
    for _ in range(ATTEMPTS):
        if room.use(thinned(chirp, 60.0)).fits:
            break
        size = size * SHRINK
        chirp = overlay(room.arm, home, size, seconds, rate, gentle)
    return chirp


def joined(first: Trajectory, second: Trajectory) -> Trajectory:
    """Two motions in sequence; the second begins where the first ends, at rest."""
    step = first.t[1] - first.t[0]
    t = np.concatenate([first.t, first.t[-1] + step + second.t - second.t[0]])
    parts = [np.concatenate([getattr(first, k), getattr(second, k)]) for k in ("q", "dq", "ddq")]
    return Trajectory(t, *parts)
