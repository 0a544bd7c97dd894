"""Contacts: a push on the last link that comes and goes, searched over time windows in every log.

Among hundreds of windows, a fit of three free forces always finds a large one that no joint feels. So the forces have a prior.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.rows import Solved
from sim.arm import Arm, ArmEffect
from sim.motion_view import force_rows
from sim.tree import GRAVITY

DURATIONS = (0.5, 1.0, 2.0)  # s
STEP = 0.3  # of a duration
# Unlike other effects, a push is felt at several joints at once; a joint that stands still shows nothing of it.
LEAST_JOINTS = 2
# Prior standard deviation of a force component: at full reach it loads the strongest joint with this share of its torque limit.
FORCE_SHARE = 0.25
ONE_JOINT = 0.85  # of a push's evidence; if a single joint holds more, it is no push on the last link


def force_spread(arm: Arm) -> float:
    """Prior standard deviation of a contact's force component, N: FORCE_SHARE of the largest force within torque limits.

    That force acts at full reach if the joint turns. If no limit is stated, it is the arm's weight. The weight is the one on
    Earth whatever gravity the model has, because drives are made for the masses that they move.
    """
    known = np.isfinite(arm.tau_max)
    if not known.any():
        return FORCE_SHARE * float(np.sum(arm.tree.mass)) * GRAVITY
    reach = max(arm.tree.reach, 1e-3)
    return FORCE_SHARE * float(np.max((arm.tau_max / np.where(arm.tree.prismatic, 1.0, reach))[known]))


def contacts(solved: Solved, arm: Arm) -> Iterator[tuple[int, float, ArmEffect, np.ndarray]]:
    """(log, fall of chi2, effect, covariance (3, 3) N^2 of its force) of every window tried."""
    spread, left, noise = force_spread(arm), solved.left(), solved.noise
    first = np.zeros(solved.rows.n, dtype=int)
    for which, model in enumerate(solved.rows.models):
        mine = [index[which] for index in solved.rows.index]
        parts = [slice(lo, lo + len(index)) for lo, index in zip(first, mine, strict=True)]
        first = first + [len(index) for index in mine]
        if len(model.residual) < 8:
            continue
        at = model.link.t[model.measurement.row_samples]
        # all joints on the rows of the recording; rows that a joint cannot use are zero and have no neighbour
        after = noise.ar.shape[1]  # rows after its end that a push still affects through whitening
        unit, force = force_rows(model), np.zeros((len(at) + after, solved.rows.n, 3))
        whitened, taps = np.zeros((*force.shape[:2], solved.rows.p + 1)), np.zeros((1 + after, *force.shape[:2]))
        for j, (index, part) in enumerate(zip(mine, parts, strict=True)):
            of_joint = noise.taps(j, solved.rows.joined[j][part], solved.rows.doubt[j][part])
            force[index, j] = unit[index, j]
            whitened[index, j, 0] = left[j][part]
            whitened[index[:, None], j, 1 + solved.rows.used(j)] = solved.xw[j][part]
            taps[: of_joint.shape[1], index, j] = of_joint.T
        counted = np.concatenate([np.zeros((1, solved.rows.n)), np.cumsum(taps[0, :-after] > 0, axis=0)])
        for duration in DURATIONS:
            for start in np.arange(at[0], at[-1] - duration, STEP * duration):
                lo, hi = np.searchsorted(at, (start, start + duration))
                felt = counted[hi] - counted[lo]
                if np.sum(felt > 0.5 * felt.max()) < LEAST_JOINTS:
                    continue
                here = slice(lo, hi + after)
                phase = (at[lo:hi] - start) / duration
                push = force[here].copy()
                push[:-after] *= np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase) ** 2, 0.0)[:, None, None]
                push[-after:] = 0.0
                push[:, felt < 2] = 0.0
                s = taps[0, here, :, None] * push
                for lag in range(1, 1 + after):
                    s[lag:] += taps[lag, here, :, None][lag:] * push[:-lag]
                s = s.reshape(-1, 3)
                products = s.T @ whitened[here].reshape(len(s), -1)
                g, xs = products[:, 0], products[:, 1:].T
                own = s.T @ s + np.eye(3) / spread**2 - xs.T @ solved.inverse @ xs
                c = np.linalg.solve(own, g)
                parameters = {"start": float(start), "duration": float(duration)}
                parameters |= {f"force_{a}": float(x) for a, x in zip("xyz", c, strict=True)}
                yield which, float(g @ c), ArmEffect(CONTACT, None, parameters), np.linalg.inv(own)


def spread_of(item: ArmEffect, force: np.ndarray) -> dict[str, float]:
    """Standard deviation of a contact's parameters, from the covariance of its force and the steps in which windows are tried.

    Its middle lies within half a step of the best window's, its duration within a factor of sqrt(2); both count as uniform.
    """
    tried = item.parameters["duration"]
    duration = (np.sqrt(2.0) - np.sqrt(0.5)) * tried / np.sqrt(12.0)
    out = {"start": float(np.hypot(STEP * tried / np.sqrt(12.0), 0.5 * duration)), "duration": float(duration)}
    return out | {f"force_{a}": float(s) for a, s in zip("xyz", np.sqrt(np.diag(force)), strict=True)}


def felt(solved: Solved, left: list[np.ndarray], columns: dict[int, np.ndarray]) -> bool:
    """Whether more than one joint contributes to the evidence for a push."""
    brings = np.zeros(solved.rows.n)
    for j, x in columns.items():
        s = solved.rows.whiten(solved.noise, j, x[:, 0])
        brings[j] = max(float(2 * s @ left[j] - s @ s), 0.0)
    return bool(brings.max() < ONE_JOINT * brings.sum())


def push_columns(solved: Solved, item: ArmEffect, log: int) -> dict[int, np.ndarray]:
    """(R, 1) per joint: torque of a push as one column."""
    p, out = item.parameters, {}
    force = np.array([p[f"force_{a}"] for a in "xyz"])
    for j in range(solved.rows.n):
        parts = []
        for k, (model, index) in enumerate(zip(solved.rows.models, solved.rows.index[j], strict=True)):
            at = model.link.t[model.measurement.row_samples]
            phase = (at - p["start"]) / p["duration"]
            window = np.where((phase > 0) & (phase < 1) & (k == log), np.sin(np.pi * phase) ** 2, 0.0)
            parts.append((window * (force_rows(model)[:, j] @ force))[index])
        out[j] = np.concatenate(parts)[:, None]
    return out
