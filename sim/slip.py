"""The direction of dry friction after a change of direction: Dahl's law along a motion."""

from __future__ import annotations

import numba
import numpy as np

# Default displacement, rad, over which dry friction builds up: of the order of the asperity contacts of bearings,
# 1e-5 to 1e-4 m on a radius of a few centimetres (B. Armstrong-Helouvry 1991, Control of Machines with Friction, chapter 2).
SLIP_WIDTH = 1e-4
SUBSTEPS = 4


@numba.njit(cache=True)
def slip_direction(q: np.ndarray, width: np.ndarray, start: float = 0.0) -> np.ndarray:
    """z in [-1, 1]: dz = (sign(dq) - z) |dq|/width, Dahl's law; q (N,) rad, width (N,) rad."""
    z = np.empty(len(q))
    z[0] = start
    for k in range(1, len(q)):
        step = q[k] - q[k - 1]
        s = 1.0 if step > 0 else -1.0
        z[k] = s + (z[k - 1] - s) * np.exp(-abs(step) / width[k])
    return z


@numba.njit(cache=True)
def spring_slip(q: np.ndarray, width: np.ndarray) -> np.ndarray:
    """z in [-1, 1]: dz = dq/width, held at its bounds; q (N,) rad, width (N,) rad."""
    z = np.zeros(len(q))
    for k in range(1, len(q)):
        z[k] = min(1.0, max(-1.0, z[k - 1] + (q[k] - q[k - 1]) / width[k]))
    return z


@numba.njit(cache=True, error_model="numpy")
def slip_along(t, q, dq, width, lead):  # type: ignore[no-untyped-def]
    """z + lead dz/dt: Dahl's law along a motion whose position is the cubic through (q, dq), (N,) each.

    The lead is the bristles' damping over their stiffness in the LuGre model (C. Canudas de Wit et al. 1995,
    doi:10.1109/9.376053): friction changes that much earlier at a reversal.
    """
    z = np.empty(len(q))
    out = np.empty(len(q))
    now = 0.0
    for k in range(len(q)):
        if k > 0:
            h = t[k] - t[k - 1]
            way = q[k] - q[k - 1]
            # a cubic is monotone where its end slopes lie between 0 and 3 chords (F. Fritsch, R. Carlson 1980, doi:10.1137/0717021)
            if 0.0 <= h * dq[k - 1] / way <= 3.0 and 0.0 <= h * dq[k] / way <= 3.0:
                s = 1.0 if way > 0 else -1.0
                now = s + (now - s) * np.exp(-abs(way) / width[k])
            else:
                before = q[k - 1]
                for i in range(1, SUBSTEPS + 1):
                    x = i / SUBSTEPS
                    here = (
                        (1 + 2 * x) * (1 - x) ** 2 * q[k - 1]
                        + x * (1 - x) ** 2 * h * dq[k - 1]
                        + x * x * (3 - 2 * x) * q[k]
                        + x * x * (x - 1) * h * dq[k]
                    )
                    step = here - before
                    s = 1.0 if step > 0 else -1.0
                    now = s + (now - s) * np.exp(-abs(step) / width[k])
                    before = here
        z[k] = now
    for k in range(len(q)):
        lo, hi = max(k - 1, 0), min(k + 1, len(q) - 1)
        out[k] = z[k] + lead * (z[hi] - z[lo]) / (t[hi] - t[lo])
    return out
