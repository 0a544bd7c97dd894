"""Contacts: a push on the last link that comes and goes, looked for in time, log by log.

Among hundreds of windows a fit of three free forces finds a large one somewhere that no joint feels. So the forces have a prior.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib.diagnosis.model import CONTACT
from calib.diagnosis.rows import Solved
from sim.arm import Arm, ArmEffect
from sim.motion_view import force_rows

DURATIONS = (0.5, 1.0, 2.0)  # s
STEP = 0.3  # of a duration
# A push differs from anything else in that it is felt at several joints at once; a joint that stands still feels nothing that shows.
LEAST_JOINTS = 2
# Prior standard deviation of a force's component: it would load the strongest joint at full reach with a quarter of its torque.
FORCE_SHARE = 0.25
ONE_JOINT = 0.85  # of a push's evidence: more than that at a single joint is no push on the last link


def force_spread(arm: Arm) -> float:
    """Prior standard deviation of a contact's force component, N."""
    reach = float(sum(np.linalg.norm(x) for x in arm.tree.position[1:]))
    return FORCE_SHARE * float(np.max(arm.tau_max)) / max(reach, 1e-3)


def contacts(solved: Solved, arm: Arm) -> Iterator[tuple[int, float, ArmEffect]]:
    """(log, fall of chi2, effect) of every window tried."""
    spread = force_spread(arm)
    left = solved.left()
    for which, model in enumerate(solved.rows.models):
        if len(model.residual) < 8:
            continue
        at = model.link.t[model.measurement.row_samples]
        force = force_rows(model)
        parts = []
        for j in range(solved.rows.n):
            index = solved.rows.index[j][which]
            first = sum(len(k) for k in solved.rows.index[j][:which])
            here = slice(first, first + len(index))
            parts.append((at[index], force[index, j], solved.rows.joined[j][here], solved.xw[j][here], left[j][here]))
        for duration in DURATIONS:
            for start in np.arange(at[0], at[-1] - duration, STEP * duration):
                g, ss, xs = np.zeros(3), np.eye(3) / spread**2, np.zeros((solved.rows.p, 3))
                edges = [np.searchsorted(t, (start, start + duration)) for t, *_ in parts]
                felt = [int(hi - lo) for lo, hi in edges]
                if sum(count > 0.5 * max(felt) for count in felt) < LEAST_JOINTS:
                    continue
                for j, ((lo, hi), (t, f, joined, xw, rest)) in enumerate(zip(edges, parts, strict=True)):
                    if hi - lo < 2:
                        continue
                    near = slice(lo, min(hi + 1, len(t)))
                    phase = (t[near] - start) / duration
                    window = np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase) ** 2, 0.0)
                    s = solved.noise.whiten(j, window[:, None] * f[near], joined[near])
                    g += s.T @ rest[near]
                    ss += s.T @ s
                    xs += xw[near].T @ s
                own = ss - xs.T @ solved.inverse @ xs
                c = np.linalg.solve(own, g)
                push = {"start": float(start), "duration": float(duration)}
                push |= {f"force_{a}": float(x) for a, x in zip("xyz", c, strict=True)}
                yield which, float(g @ c), ArmEffect(CONTACT, None, push)


def felt(solved: Solved, left: list[np.ndarray], columns: dict[int, np.ndarray]) -> bool:
    """Whether more than one joint speaks for a push."""
    brings = np.zeros(solved.rows.n)
    for j, x in columns.items():
        s = solved.noise.whiten(j, x[:, 0], solved.rows.joined[j])
        brings[j] = max(float(2 * s @ left[j] - s @ s), 0.0)
    return bool(brings.max() < ONE_JOINT * brings.sum())


def push_columns(solved: Solved, item: ArmEffect, log: int) -> dict[int, np.ndarray]:
    """(R, 1) per joint: torque of a push, as one column."""
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
