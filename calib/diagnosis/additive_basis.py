"""Additive basis in position, speed, acceleration, load, pairs, memory, hysteresis, resonance and time: columns per log."""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.interpolate import BSpline
from scipy.signal import lfilter

from calib.diagnosis.model import LogModel
from sim.slip import slip_along

MEMORIES = (0.3, 1.0, 3.0)  # s
# Damped oscillators driven by a joint's acceleration: a liquid, a pedestal, a hanging tool. Steps of about 1.5, so one is near.
RESONANCES, DAMPING = (0.6, 0.9, 1.4, 2.1, 3.2, 4.8), 0.12  # Hz
# rad in which friction of a dress pack, seal or belt builds up after a reversal; dry friction in the gear takes a hundredth.
WIDTHS = (0.05, 0.1, 0.2, 0.4)
KNOTS = 8
SPOTS = 42  # hat functions in a turn, one every 0.15 rad: friction at one angle, from a damaged tooth or a dented race


class AdditiveBasis:
    """Groups of columns for some logs; what all joints share (positions, speeds, time) is filtered once."""

    def __init__(self, models: list[LogModel]) -> None:
        self.models = models
        self._common = self._filtered([_common(m) for m in models])

    def groups(self, j: int) -> dict[str, list[np.ndarray]]:
        """Group name -> filtered columns (R, k) per log, for the residual of joint j."""
        name, own = self.models[0].arm.joint_names[j], self._filtered([_own(m, j) for m in self.models])
        linear = {"resonance": _resonances, "hysteresis": _hystereses}
        return self._common | own | {f"{key}:{name}": [m.rows(of(m, j)) for m in self.models] for key, of in linear.items()}

    def spots(self, j: int) -> dict[str, list[np.ndarray]]:
        """The same for friction at single angles of joint j: its direction times SPOTS hat functions that cover a turn."""
        return {
            f"spot:{self.models[0].arm.joint_names[j]}": [m.rows(hats(m, j) * _direction(m, j)[:, None]) for m in self.models]
        }

    def _filtered(self, per_log: list[dict[str, list[np.ndarray]]]) -> dict[str, list[np.ndarray]]:
        return {
            name: [m.rows(x) for m, x in zip(self.models, _splined([f[name] for f in per_log]), strict=True)]
            for name in per_log[0]
        }


def _common(m: LogModel) -> dict[str, list[np.ndarray]]:
    """Variable -> arguments (N,) whose splines are the columns."""
    out: dict[str, list[np.ndarray]] = {}
    for k, name in enumerate(m.arm.joint_names):
        out[f"q:{name}"] = [m.link.q[:, k]]
        out[f"dq:{name}"] = [m.link.dq[:, k]]
    return out | {"time": [m.link.t]}


def _own(m: LogModel, j: int) -> dict[str, list[np.ndarray]]:
    """The same for joint j alone; of a pair of arguments, the columns are the first one's splines times the second."""
    name, link = m.arm.joint_names[j], m.link
    sign = _direction(m, j)
    out = {
        f"ddq:{name}": [link.ddq[:, j]],
        f"load:{name}": [link.load[:, j]],
        f"q:{name}*sign(dq)": [link.q[:, j], sign],
        f"load:{name}*sign(dq)": [link.load[:, j], sign],
        f"memory:{name}": [],
    }
    for memory in MEMORIES:
        out[f"memory:{name}"].append(m.measurement.by_stretch(partial(_since, memory * m.measurement.rate), link.q[:, j]))
    return out


def _since(memory: float, q: np.ndarray) -> np.ndarray:
    """(N,) distance of q from its first-order lag with a time constant of `memory` samples."""
    decay = np.exp(-1.0 / memory)
    return np.asarray(q - q[0] - lfilter([1 - decay], [1, -decay], q - q[0]))


def _direction(m: LogModel, j: int) -> np.ndarray:
    """(N,) sign of the speed, smooth through zero."""
    return np.tanh(m.link.dq[:, j] / 0.02)


def hats(m: LogModel, j: int) -> np.ndarray:
    """(N, SPOTS) hat functions: 1 at a centre, 0 from the next centre on, periodic in a turn."""
    away = np.abs((m.link.q[:, j] * SPOTS / (2 * np.pi) % SPOTS)[:, None] - np.arange(SPOTS))
    return np.clip(1.0 - np.minimum(away, SPOTS - away), 0.0, None)


def _resonances(m: LogModel, j: int) -> np.ndarray:
    """(N, 2 k) x and x' / w of k oscillators x'' + 2 d w x' + w^2 x = -w^2 ddq_j."""
    dt, out = 1.0 / m.measurement.rate, []
    for frequency in RESONANCES:
        w = 2 * np.pi * frequency
        decay, ring = np.exp(-DAMPING * w * dt), np.cos(w * np.sqrt(1 - DAMPING**2) * dt)
        recursion = [1.0, -2.0 * decay * ring, decay**2]
        x = m.measurement.by_stretch(partial(lfilter, [0.0, -((w * dt) ** 2)], recursion), m.link.ddq[:, j])
        out += [x, m.measurement.by_stretch(partial(_slope, dt), x) / w]
    return np.column_stack(out)


def _slope(dt: float, x: np.ndarray) -> np.ndarray:
    return np.gradient(x, dt) if len(x) > 1 else np.zeros_like(x)


def _hystereses(m: LogModel, j: int) -> np.ndarray:
    """(N, k) levels z of Dahl's law dz/dq = (1 - z sign(dq)) / width (P. Dahl 1968)."""
    link = m.link
    return np.column_stack([slip_along(link.t, link.q[:, j], link.dq[:, j], np.full(len(link.t), w), 0.0) for w in WIDTHS])


def _splined(per_log: list[list[np.ndarray]]) -> list[np.ndarray]:
    """Cubic splines of every argument, knots common to all logs; those of the first times the second where that is a sign."""
    arguments = list(zip(*per_log, strict=True))
    signed = len(arguments) == 2 and all(np.all(np.abs(x) <= 1.0) for x in arguments[1])
    blocks: list[list[np.ndarray]] = [[] for _ in per_log]
    for values in arguments[:1] if signed else arguments:
        whole = np.concatenate(values)
        lo, hi = float(whole.min()), float(whole.max())
        if hi - lo < 1e-9:
            hi = lo + 1.0
        inner = np.linspace(lo, hi, KNOTS - 2)
        knots = np.concatenate([[lo] * 3, inner, [hi] * 3])
        every = BSpline(knots, np.eye(KNOTS), 3)  # a third of the time that design_matrix takes
        for block, x in zip(blocks, values, strict=True):
            block.append(every(np.clip(x, lo, hi - 1e-9 * (hi - lo))))
    out = [np.concatenate(block, axis=1) for block in blocks]
    if signed:
        out = [x * s[:, None] for x, s in zip(out, arguments[1], strict=True)]
    return out
