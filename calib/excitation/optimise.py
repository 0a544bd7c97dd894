"""Several starts, each descended by Adam on the smooth objective, fitted to its room, and the most informative kept.

Adam (D. Kingma, J. Ba 2015) with a falling step is robust where a line search stalls on the kinks of the limits. The best random start
takes part in the choice, so that the result is never worse than it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np

from calib.excitation.design import Information, Worth, coarse, fitted_to_room, noise_of, random_start
from calib.excitation.fourier import Fourier
from calib.excitation.objective import Objective
from calib.excitation.room import Room
from calib.identification.model import TorqueModel
from sim.arm import Arm
from sim.cell import Cell

CONDITION_CAP = 40.0
ITERATIONS = 350
TRIES = 10
WEIGHTS = (30.0, 3e4)
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Start:
    """Where one descent began and what came of it; worth is that of the motion after it was fitted to its room."""

    motion: Fourier
    worth: Worth
    seconds: float


def optimised(arm: Arm, cell: Cell, best: Fourier, starts: int, seed: int, progress: Progress, workers: int = 2) -> list[Start]:
    """What came of `best` and of starts - 1 random motions, the preferred first: below the condition cap, then by information."""
    tasks = [(arm, cell, best, seed + k if k else None) for k in range(starts)]
    done: list[Start] = []
    if starts == 1 or workers == 1:
        for k, task in enumerate(tasks):
            done.append(descended(*task))
            progress("optimising", (k + 1) / starts)
    else:
        threads = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        before = {k: os.environ.get(k) for k in threads}
        os.environ.update(threads)
        try:
            with ProcessPoolExecutor(min(workers, starts), mp_context=get_context("spawn")) as pool:
                waiting = [pool.submit(descended, *task) for task in tasks]
                for k, future in enumerate(as_completed(waiting)):
                    future.result()
                    progress("optimising", (k + 1) / starts)
                done = [future.result() for future in waiting]
        finally:
            for key, value in before.items():
                if value is None:
                    del os.environ[key]
                else:
                    os.environ[key] = value
    return sorted(done, key=lambda s: preference(s.worth), reverse=True)


def preference(worth: Worth) -> tuple[bool, float]:
    """Order of motions: those below the condition cap first, then by log det."""
    return worth.condition <= CONDITION_CAP, worth.log_det


def descended(arm: Arm, cell: Cell, best: Fourier, seed: int | None, capped: bool = True) -> Start:
    """One descent from `best`, or from a random motion of that seed; where the end does not fit better than its start, the start.

    Without `capped` the condition number plays no part: the D-optimum, to compare with.
    """
    began = time.process_time()
    room, model = Room(arm, cell), TorqueModel.of_arm(arm)
    information = Information(model, noise_of(model))
    start = best
    if seed is not None:
        start, _ = random_start(room, information, best.basis, best.home, np.random.default_rng(seed), TRIES)
    objective = Objective(room, model, noise_of(model), start, capped=capped)
    ended = fitted_to_room(room, Fourier(start.basis, start.home, adam(objective, start.x)), grow=False)
    options = [start] if ended is None else [start, ended]
    worths = [information.worth(coarse(m)) for m in options]
    chosen = max(range(len(options)), key=lambda k: preference(worths[k]) if capped else (True, worths[k].log_det))
    return Start(options[chosen], worths[chosen], time.process_time() - began)


def adam(objective: Objective, x: np.ndarray, iterations: int = ITERATIONS, rate: float = 0.03) -> np.ndarray:
    """The last iterate of Adam with a cosine-falling step, rad/s, while the weight of the limits grows from WEIGHTS[0] to WEIGHTS[1]."""
    x, mean, square = x.copy(), np.zeros_like(x), np.zeros_like(x)
    for k in range(1, iterations + 1):
        objective.weight = WEIGHTS[0] * (WEIGHTS[1] / WEIGHTS[0]) ** (k / iterations)
        _, g = objective(x)
        mean, square = 0.9 * mean + 0.1 * g, 0.99 * square + 0.01 * g**2
        step = rate * 0.5 * (1 + np.cos(np.pi * k / iterations))
        x = x - step * (mean / (1 - 0.9**k)) / (np.sqrt(square / (1 - 0.99**k)) + 1e-12)
    return x
