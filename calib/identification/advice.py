"""C_then = (C^-1 + G)^-1 with G = sum y y^T / sigma^2: which of a menu of motions best determines the poorly known parameters.

C is the covariance of the estimate, and y are the regressor columns along the motion, which need no torque. The menu moves one
joint slowly or fast, or two joints fast, about the centre of the logs' motion, also with one joint turned by 90 degrees. A few
motions are chosen that together serve most parameters.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.identification.estimates import CONTRACTION, RELATIVE
from calib.identification.least_squares import Solution
from calib.identification.model import TorqueModel
from calib.regression.normal_equations import Prior, inverse
from sim.trajectory import Trajectory

SECONDS, RATE = 20.0, 20.0
ROWS_A_SECOND = 20.0  # of a filter at 8 Hz, with about as many independent readings
REACH, LEAST_REACH = 1.2, 0.05  # rad to either side
SLOW, FAST = 0.06, 0.5  # of dq_max
# a motion that leaves more than WORTH of the standard deviation, or does much worse than the best (NEAR), is not worth the time
WORTH, NEAR = 0.6, 0.7
MOST = 5  # motions that an operator is asked to run


@dataclass(frozen=True)
class Advice:
    """A motion, in words and as a path, and the parameters that it would determine; std: of each, now and after it.

    Where no motion of the menu helps, path is None and `motion` says so.
    """

    motion: str
    parameters: tuple[str, ...]
    std: tuple[tuple[float, float], ...]
    path: Trajectory | None


def advice(
    model: TorqueModel, solution: Solution, nominal: Prior, unknown: Sequence[int], home: np.ndarray
) -> tuple[Advice, ...]:
    """What to record for the columns `unknown`, most helpful motion first; home (n,) rad: centre of the logs' motion.

    The last entry holds the columns that no motion of the menu helps. Empty if nothing is unknown or no joint has room to move.
    """
    if not len(unknown):
        return ()
    now = inverse(solution.covariance)
    std = np.sqrt(np.diag(solution.covariance))
    before = np.sqrt(np.diag(inverse(nominal.precision)))
    enough = np.maximum(CONTRACTION * before, RELATIVE * np.abs(solution.theta))
    menu = _menu(model, home)
    if not menu:
        return ()
    then = np.array([np.sqrt(np.diag(inverse(now + _information(model, solution.sigma, path)))) for _, _, path in menu])
    effort = np.array([moving for _, moving, _ in menu])
    # a motion serves the parameters that it determines or, failing that, improves much
    helped = {k: (then[:, k] < enough[k]) | (then[:, k] < min(WORTH * std[k], then[:, k].min() / NEAR)) for k in unknown}
    names, left = [name.split(" ")[0] for name in model.names], list(unknown)
    entries: list[Advice] = []
    while left and len(entries) < MOST:
        count = np.sum([helped[k] for k in left], axis=0)
        best = int(np.lexsort((effort, -count))[0])
        served = [k for k in left if helped[k][best]]
        if not served:
            break
        doubt = tuple((float(std[k]), float(then[best, k])) for k in served)
        entries.append(Advice(menu[best][0], tuple(names[k] for k in served), doubt, menu[best][2]))
        left = [k for k in left if k not in served]
    if left:
        doubt = tuple((float(std[k]), float(then[:, k].min())) for k in left)
        entries.append(
            Advice(
                "record a longer `calib plan` excitation; motions of one or two joints do not excite them",
                tuple(names[k] for k in left),
                doubt,
                None,
            )
        )
    return tuple(entries)


def sentence(item: Advice, most: int = 4) -> str:
    """The advice as a sentence."""
    left = len(item.parameters) - most
    more = f" and {left} other{'s' if left > 1 else ''}" if left > 0 else ""
    return f"for {', '.join(item.parameters[:most])}{more}: {item.motion}"


def _menu(model: TorqueModel, home: np.ndarray) -> list[tuple[str, int, Trajectory]]:
    """Words, number of moving joints and path of every candidate."""
    arm, n = model.arm, model.arm.n
    t = np.arange(int(SECONDS * RATE)) / RATE
    out = []
    postures = [("", home), *_turned(model, home)]
    for where, posture in postures:
        free = [j for j in range(n) if _room(model, posture, j) >= LEAST_REACH]
        for j in free:
            for word, share in (("slowly", SLOW), ("fast", FAST)):
                motion = _motion(model, posture, t, {j: (share, 1.0)})
                rate = f"up to {np.abs(motion.dq[:, j]).max():.2g} rad/s"
                out.append((f"move {arm.joint_names[j]} {word} back and forth ({rate}){where}", 1, motion))
        for i, j in itertools.combinations(free, 2):
            motion = _motion(model, posture, t, {i: (FAST, 1.0), j: (FAST, 1.37)})
            out.append(
                (f"move {arm.joint_names[i]} and {arm.joint_names[j]} fast together, at different rates{where}", 2, motion)
            )
    return out


def _turned(model: TorqueModel, home: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Postures with one joint of the last half turned by 90 degrees, within its limits, so that gravity acts differently."""
    arm, out = model.arm, []
    lo, hi = _limits(model)
    for j in range(arm.n // 2, arm.n):
        ways = [way for way in (np.pi / 2, -np.pi / 2) if lo[j] < home[j] + way < hi[j]]
        if ways and not arm.tree.prismatic[j]:
            q = home.copy()
            q[j] += ways[0]
            out.append((f", with {arm.joint_names[j]} a quarter of a turn away", q))
    return out


def _limits(model: TorqueModel) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper limits, (n,) rad each; infinite where a joint has none."""
    arm = model.arm
    return np.where(np.isnan(arm.q_min), -np.inf, arm.q_min), np.where(np.isnan(arm.q_max), np.inf, arm.q_max)


def _room(model: TorqueModel, posture: np.ndarray, j: int) -> float:
    """rad, at most REACH, by which joint j can move to either side."""
    lo, hi = _limits(model)
    return float(min(REACH, 0.9 * (hi[j] - posture[j]), 0.9 * (posture[j] - lo[j])))


def _motion(model: TorqueModel, posture: np.ndarray, t: np.ndarray, moving: dict[int, tuple[float, float]]) -> Trajectory:
    arm = model.arm
    q = np.tile(posture, (len(t), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j, (share, pace) in moving.items():
        speed = share * (arm.dq_max[j] if np.isfinite(arm.dq_max[j]) else 2.0)
        most = 0.8 * (arm.ddq_max[j] if np.isfinite(arm.ddq_max[j]) else 5.0)
        reach = _room(model, posture, j)
        rate = pace * min(speed / reach, np.sqrt(most / reach))
        q[:, j] += reach * np.sin(rate * t)
        dq[:, j], ddq[:, j] = reach * rate * np.cos(rate * t), -reach * rate**2 * np.sin(rate * t)
    return Trajectory(t, q, dq, ddq)


def _information(model: TorqueModel, sigma: np.ndarray, path: Trajectory) -> np.ndarray:
    """(p, p) information of a motion's rows, with the fit's residual sigma (n,); rows of standing joints carry none."""
    a = model.columns(path.q, path.dq, path.ddq)
    still = ~np.any(path.dq, axis=0)
    for j in range(model.arm.n):
        column = model.friction_column("coulomb", j)
        a[:, j, column] = np.sign(path.dq[:, j])
        if still[j]:
            a[:, j] = 0.0
    weight = ROWS_A_SECOND / RATE / sigma**2
    return np.asarray(np.einsum("kjp,j,kjr->pr", a, weight, a, optimize=True))
