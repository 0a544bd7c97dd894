"""Multi-start search: every start descends a little, the better half further, the best two to the end and RESTARTS times again.

At the end all limits are kept. The descent is BFGS (J. Nocedal, S. Wright, Numerical Optimization, 2006, section 6.1) with its
full inverse Hessian, which is passed from stage to stage. The first stages use few samples and allow limits to be exceeded
slightly. The weight on the limits then grows until the end needs no shrinking. The duality gap of D-optimal design
(`calib.excitation.gap`) estimates how much more another motion could determine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy.optimize

from calib.excitation.design import Information, Worth, coarse, fitted_to_room, noise_of, random_start
from calib.excitation.fourier import Fourier
from calib.excitation.gap import Mixture
from calib.excitation.objective import Objective
from calib.excitation.room import Room
from calib.excitation.workers import Workers, workers
from calib.identification.model import TorqueModel
from drivers.driver import DeviceStop
from sim.arm import Arm
from sim.cell import Cell

CONDITION_CAP = 40.0
TRIES = 10
# stages (weight of the limits, iterations, samples) of a descent from every start, from the better half, and from the best two
Stage = tuple[float, int, int]
SCOUT: tuple[Stage, ...] = ((30.0, 80, 60), (300.0, 120, 60))
FURTHER: tuple[Stage, ...] = ((300.0, 120, 60), (300.0, 120, 60))
TO_THE_END: tuple[Stage, ...] = (*((300.0, 150, 60),) * 3, (3e3, 100, 80), (3e4, 100, 100))
# again from the best two ends, with limits that may be exceeded, to cross a low barrier; on a UR10e the second restart adds
# 1.4 nats, a third 0.3
RESTART: tuple[Stage, ...] = ((30.0, 60, 60), *TO_THE_END[1:])
RESTARTS = 2
# repeated if the end does not fit, as it came near limits that the stage did not evaluate
AGAIN: Stage = (3e4, 60, 100)
REPAIRS, WHOLE = 3, 0.99
LEFT = 2
# below this weight a descent exceeds limits slightly anyway, so they are evaluated only at its samples
COARSE = 100.0
# ascents towards the motion that adds most to those found
ASCENT: tuple[Stage, ...] = ((30.0, 150, 60), (300.0, 80, 60))
ASCENTS, ROUNDS = 2, 2
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Site:
    """Arm and cell of a search, how the device brakes there, and whether the condition number is capped."""

    arm: Arm
    cell: Cell
    stop: DeviceStop = field(default_factory=DeviceStop)
    capped: bool = True


@dataclass(frozen=True)
class Start:
    """Result of one descent: its motion, fitted to the room, and the worth of that motion.

    information: nats, log det of all that the search maximises: besides the parameters, candidates of a diagnosis and what is
    already known. seconds: processor time. x (n, f) rad/s and value: the end itself and its objective at the last weight. gain:
    nats by which the last tenth of the iterations lowered value. inverse (n f, n f): inverse Hessian at x.
    """

    motion: Fourier
    worth: Worth
    information: float
    seconds: float
    x: np.ndarray
    value: float
    gain: float
    inverse: np.ndarray | None

    @property
    def rank(self) -> tuple[bool, float]:
        """Sort key of ends: those below the condition cap rank higher, then by information."""
        return self.worth.condition <= CONDITION_CAP, self.information


@dataclass(frozen=True)
class Search:
    """Ends of all starts: first those that descended to the end, preferred ones first.

    gap: estimated information, nats, that the best motion within the limits has beyond the first end; columns: of the
    information.
    """

    ends: tuple[Start, ...]
    gap: float
    columns: int

    @property
    def smaller(self) -> float:
        """Share by which that motion would reduce the standard deviations, as geometric mean: 1 - exp(-gap / (2 columns))."""
        return float(-np.expm1(-self.gap / (2 * self.columns)))


def optimised(site: Site, best: Fourier, starts: int, seed: int, progress: Progress, processes: int = 2) -> Search:
    """Search from `best` and starts - 1 random motions; prefer ends below the condition cap, then informative ones.

    Starts that were dropped remain in the list as far as they descended.
    """
    half = max(LEFT, starts // 2)
    work = [
        starts * _work(SCOUT),
        half * _work(FURTHER),
        LEFT * _work(TO_THE_END),
        *[LEFT * _work(RESTART)] * RESTARTS,
        ROUNDS * ASCENTS * _work(ASCENT),
    ]

    def part(index: int) -> Callable[[float], None]:
        return lambda done: progress("optimising", (sum(work[:index]) + done * work[index]) / sum(work))

    with workers(min(processes, starts)) as pool:
        found = pool.run(scouted, [(site, best, seed + k if k else None) for k in range(starts)], part(0))
        found.sort(key=lambda s: s.value)
        found[:half] = pool.run(descended, [(site, s.motion, s.x, s.inverse, FURTHER) for s in found[:half]], part(1))
        found[:half] = sorted(found[:half], key=lambda s: s.value)
        found[:LEFT] = pool.run(descended, [(site, s.motion, s.x, s.inverse, TO_THE_END) for s in found[:LEFT]], part(2))
        for k in range(RESTARTS):
            again = pool.run(descended, [(site, s.motion, s.x, None, RESTART) for s in found[:LEFT]], part(3 + k))
            found[:LEFT] = sorted(map(_better, found[:LEFT], again), key=lambda s: s.rank, reverse=True)
        gap, columns = _gap(pool, site, found, part(3 + RESTARTS))
    progress("optimising", 1.0)
    return Search(tuple(found), gap, columns)


def preference(worth: Worth) -> tuple[bool, float]:
    """Sort key of motions: those below the condition cap rank higher, then by log det."""
    return worth.condition <= CONDITION_CAP, worth.log_det


def scouted(task: tuple[Site, Fourier, int | None]) -> Start:
    """Short descent from a motion or, with a seed, from a random one about the same posture."""
    site, start, seed = task
    if seed is not None:
        information = Information(TorqueModel.of_arm(site.arm), noise_of(site.arm))
        rng = np.random.default_rng(seed)
        start, _ = random_start(Room(site.arm, site.cell), information, start.basis, start.home, rng, TRIES)
    return descended((site, start, start.x, None, SCOUT))


def descended(task: tuple[Site, Fourier, np.ndarray, np.ndarray | None, tuple[Stage, ...]]) -> Start:
    """Descend from coefficients x (n, f) through the stages; the motion is the start's if the end does not fit its room."""
    site, start, x, inverse, stages = task
    began = time.process_time()
    room, model = Room(site.arm, site.cell), TorqueModel.of_arm(site.arm)
    information = Information(model, noise_of(model.arm))
    value = gain = np.inf
    ended, repairs, left = None, 0, list(stages)
    while left:
        weight, iterations, samples = left.pop(0)
        fine = weight > COARSE
        about = x if fine else None
        objective = Objective(
            room, model, noise_of(model.arm), start, samples, weight, site.capped, site.stop, fine=fine, about=about
        )
        x, value, gain, inverse = lowest(objective, x, iterations, inverse)
        if not left:
            ended = fitted_to_room(room, Fourier(start.basis, start.home, x), grow=False)
            whole = ended is not None and np.linalg.norm(ended.x) >= WHOLE * np.linalg.norm(x)
            if weight == AGAIN[0] and not whole and repairs < REPAIRS:
                left, repairs = [AGAIN], repairs + 1
    # a start that exceeds limits, or that safety.clear would refuse, may well be worth more, so it does not compete
    motion = start if ended is None else ended
    spent = time.process_time() - began
    return Start(motion, information.worth(coarse(motion)), objective.log_det(motion.x), spent, x, value, gain, inverse)


def _better(end: Start, again: Start) -> Start:
    """The end that ranks higher, with the seconds of both."""
    return replace(max(end, again, key=lambda s: s.rank), seconds=end.seconds + again.seconds)


def lowest(
    objective: Callable[[np.ndarray], tuple[float, np.ndarray]],
    x: np.ndarray,
    iterations: int,
    inverse: np.ndarray | None = None,
) -> tuple[np.ndarray, float, float, np.ndarray | None]:
    """Run BFGS for at most `iterations` and return (x, value, gain, inverse).

    gain: by how much the last tenth of the iterations lowered the value. inverse: inverse Hessian from which another descent
    may begin, None if it is not positive definite.
    """
    values: list[float] = []

    def call(flat: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = objective(flat.reshape(x.shape))
        return value, gradient.ravel()

    def note(intermediate_result: Any) -> None:
        values.append(float(intermediate_result.fun))

    options = {"maxiter": iterations, "hess_inv0": inverse}
    found = scipy.optimize.minimize(call, x.ravel(), jac=True, method="BFGS", callback=note, options=options)
    before = values[-1 - len(values) // 10] if values else float(found.fun)
    bend = (found.hess_inv + found.hess_inv.T) / 2
    positive = np.all(np.isfinite(bend)) and np.linalg.eigvalsh(bend)[0] > 0
    return found.x.reshape(x.shape), float(found.fun), before - float(found.fun), bend if positive else None


def ascended(task: tuple[Site, Fourier, np.ndarray]) -> np.ndarray:
    """Coefficients of a motion with a large tr(A M), by ascents from `start`; A (p, p)."""
    site, start, slope = task
    room, model, x = Room(site.arm, site.cell), TorqueModel.of_arm(site.arm), start.x
    for weight, iterations, samples in ASCENT:
        objective = Objective(room, model, noise_of(model.arm), start, samples, weight, False, site.stop, slope)
        x, *_ = lowest(objective, x, iterations)
    return x


def _gap(pool: Workers, site: Site, found: list[Start], done: Callable[[float], None]) -> tuple[float, int]:
    """Duality gap, nats, and the number of columns, by rounds of the conditional gradient.

    Each round forms the mixture of all known motions and adds the motions that ascend most along its tangent.
    """
    best = found[0].motion
    model = TorqueModel.of_arm(site.arm)
    objective = Objective(Room(site.arm, site.cell), model, noise_of(model.arm), best, stop=site.stop)
    motions = [s.motion for s in found]
    mixture = Mixture([objective.information(m.x) for m in motions], objective.prior)
    for k in range(ROUNDS):
        slope = mixture.slope
        first = sorted(range(len(motions)), key=lambda i: -mixture.along(i))[:ASCENTS]
        more = [replace(best, x=x) for x in pool.run(ascended, [(site, motions[i], slope) for i in first], lambda _: None)]
        done((k + 1) / ROUNDS)
        motions += more
        mixture.add([objective.information(m.x) for m in more])
    return mixture.bound() - objective.log_det(best.x), objective.p


def _work(stages: tuple[Stage, ...]) -> float:
    return float(sum(iterations * samples for _, iterations, samples in stages))
