"""Friction of one joint fitted to data: a sum of given terms, where no single effect of the catalogue describes it."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np

from sim.effects.effect import Effect, Parameter, Probe, Values
from sim.interval import Interval
from sim.slip import slip_along
from sim.slip_bounds import slip_amplitude
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage

WIDTHS = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1)
POWERS = (0.3, 0.6, 1.0, 2.0)
SPEEDS = (0.02, 0.1, 0.4)
# displacement over which the other terms reverse, so that none of them steps
TURNING = 1e-3
_TURNING = WIDTHS.index(TURNING)
# rad/s: below it, the roots of the speed become linear, which a simulation can follow
SLOW = 0.01
FAMILIES: dict[str, tuple[str, ...]] = {
    "slip": ("slip_1e-4", "slip_3e-4", "slip_1e-3", "slip_3e-3", "slip_1e-2", "slip_3e-2", "slip_1e-1"),
    "speed": ("power_0.3", "power_0.6", "power_1", "power_2"),
    "stribeck": ("stribeck_0.02", "stribeck_0.1", "stribeck_0.4"),
    "load": ("load", "load_2", "load_driving"),
}
# effect -> family of terms that describe it in a more flexible form
FORMS = {
    "presliding_friction": "slip",
    "nonlinear_viscous_friction": "speed",
    "stribeck_friction": "stribeck",
    "load_dependent_friction": "load",
}
SYMBOLS = {
    **{name: f"z({w:g})" for name, w in zip(FAMILIES["slip"], WIDTHS, strict=True)},
    **{name: f"sign(dq) |dq|^{p:g}" for name, p in zip(FAMILIES["speed"], POWERS, strict=True)},
    **{name: f"z exp(-|dq|/{v:g})" for name, v in zip(FAMILIES["stribeck"], SPEEDS, strict=True)},
    "load": "z |load|", "load_2": "z load^2", "load_driving": "max(load z, 0) z",
}  # fmt: skip
TERMS = tuple(name for family in FAMILIES.values() for name in family)


def formula(p: Values) -> str:
    """The law as text, largest coefficients first: "3.1 z(0.003) + 0.04 z |load|"."""
    names = sorted((n for n in TERMS if p[n] != 0.0), key=lambda n: -abs(p[n]))
    shown = [f"{'-' if p[name] < 0 else '+'} {abs(p[name]):.3g} {SYMBOLS[name]}" for name in names]
    return " ".join(shown).removeprefix("+ ") or "0"


class FrictionLaw(Effect):
    """tau += sum_w a_w z_w + sum_p b_p sign(dq) |dq|^p + z (sum_v c_v exp(-|dq|/v) + d_1 |load| + d_2 load^2 + d_3 max(load z, 0)).

    z_w in [-1, 1] is the slip direction that builds up over a displacement w (parallel Maxwell slip elements, F. Al-Bender et al.
    2005, doi:10.1109/TAC.2005.858676), z that of TURNING. The terms are a library for regression: coefficients may have either sign.
    """

    name = "friction_law"
    summary = "friction as a fitted sum of terms"
    looks = "memory on several scales after each reversal, and friction that depends on speed and load in no simple way"
    reference = (
        "F. Al-Bender, V. Lampaert, J. Swevers (2005), doi:10.1109/TAC.2005.858676; terms chosen by regression on the data"
    )
    stage = Stage.MOTOR
    needs_load = True
    parameters = (
        *(Parameter(n, "N*m", f"dry friction that builds up over {w:g} rad") for n, w in zip(FAMILIES["slip"], WIDTHS, strict=True)),
        *(Parameter(n, f"N*m/(rad/s)^{p:g}", f"friction that grows with |dq|^{p:g}") for n, p in zip(FAMILIES["speed"], POWERS, strict=True)),
        *(
            Parameter(n, "N*m", f"excess of friction at rest that falls with exp(-|dq|/{v:g} rad/s)")
            for n, v in zip(FAMILIES["stribeck"], SPEEDS, strict=True)
        ),
        Parameter("load", "1", "dry friction per transmitted torque"),
        Parameter("load_2", "1/(N*m)", "dry friction per square of the transmitted torque", grid=(0.01,)),
        Parameter("load_driving", "1", "dry friction per torque against which the joint moves"),
    )  # fmt: skip

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Add the terms with non-zero coefficients. If the caller keeps a memory, continue where the previous part ended."""
        assert joint is not None
        memory = None if state.memory is None else state.memory.get((self.name, joint))
        if memory is None:
            values = [p[name] for name in TERMS]
            if not any(values):
                return
            if state.memory is None:
                wanted = [name for name, value in zip(TERMS, values, strict=True) if value != 0.0]
                state.tau[:, joint] += self.terms(state, joint, wanted) @ np.array([p[name] for name in wanted])
                return
            # the coefficients are kept behind the slips, because this is called at every step of a simulation
            memory = state.memory[self.name, joint] = np.array([state.q_motor[0, joint], *(0.0 for _ in WIDTHS), *values])
        _go_on(state.q_motor, state.dq_motor, state.load, state.tau, joint, memory)

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """The slips of all widths together, then the other terms one by one, each with its own uncertainty."""
        dq, load = box.dq[:, joints], box.load[:, joints]
        turn = box.slip(joints, TURNING)
        size = abs(load)
        out = Interval.zeros(dq.lo.shape)
        level = Interval.zeros(dq.lo.shape)
        for width, name in zip(WIDTHS, FAMILIES["slip"], strict=True):
            row = box.slips.setdefault(width, np.zeros(box.tau.lo.shape[1]))
            row[joints] += p[name].middle
            half = p[name].half
            out = Interval(out.lo - half, out.hi + half)
        for power, name in zip(POWERS, FAMILIES["speed"], strict=True):
            speeds = Interval(*(v * (v**2 + SLOW**2) ** ((power - 1) / 2) for v in (dq.lo, dq.hi)))
            out = out + p[name] * speeds
        for scale, name in zip(SPEEDS, FAMILIES["stribeck"], strict=True):
            speed = abs(dq)
            level = level + p[name] * Interval(np.exp(-speed.hi / scale), np.exp(-speed.lo / scale))
        level = level + p["load"] * size + p["load_2"] * (size * size)
        driving = load * turn
        positive = Interval(np.maximum(driving.lo, 0.0), np.maximum(driving.hi, 0.0))
        out = out + level * turn + p["load_driving"] * positive * turn
        box.add(box.tau, joints, out)
        slips = np.array([p[name].middle for name in FAMILIES["slip"]])
        more = unsure * (out.magnitude + [slip_amplitude(np.array(WIDTHS), a) for a in slips.T])
        box.add(box.tau, joints, Interval(-more, more))
        steep = box.steep[:, joints]
        by_square = p["load_2"].magnitude * (2 * size.hi + steep * box.farthest)
        share = p["load"].magnitude + p["load_driving"].magnitude + by_square
        box.by_friction[:, joints] += (1 + unsure) * share * steep

    def terms(self, state: PathState, joint: int, names: Sequence[str] = TERMS) -> np.ndarray:
        """Torque (N, k) of each named term with a coefficient of one, along a whole path."""
        q, dq, load = (np.ascontiguousarray(x[:, joint]) for x in (state.q_motor, state.dq_motor, state.load))
        slips = np.zeros((len(q), len(WIDTHS)))
        for i, (width, name) in enumerate(zip(WIDTHS, FAMILIES["slip"], strict=True)):
            if len(q) > 1 and (name in names or width == TURNING):
                slips[:, i] = slip_along(state.t, q, dq, np.full(len(q), width), 0.0)
        return np.asarray(_terms(dq, load, slips, np.array([TERMS.index(name) for name in names])))

    def probes(self, own: Values | None) -> list[Probe]:
        """None: the law is fitted to what the named effects leave; it is not a candidate among them."""
        return []


# Numba's cache notices changes of this file but not of the files it imports, so these kernels call none from another file.
@numba.njit(cache=True)
def _term(which, dq, load, slips):  # type: ignore[no-untyped-def]
    """Value of the term with index `which` in TERMS at one instant, from the slips of WIDTHS."""
    speed, turn, k = abs(dq), slips[_TURNING], which
    if k < len(WIDTHS):
        return slips[k]
    k -= len(WIDTHS)
    if k < len(POWERS):
        return dq * (speed**2 + SLOW**2) ** ((POWERS[k] - 1) / 2)
    k -= len(POWERS)
    if k < len(SPEEDS):
        return turn * np.exp(-speed / SPEEDS[k])
    k -= len(SPEEDS)
    if k == 0:
        return turn * abs(load)
    return turn * load**2 if k == 1 else max(load * turn, 0.0) * turn


@numba.njit(cache=True)
def _terms(dq, load, slips, wanted):  # type: ignore[no-untyped-def]
    """Values (N, k) of the terms with the `wanted` indices, at every instant."""
    out = np.empty((len(dq), len(wanted)))
    for i in range(len(wanted)):
        for k in range(len(dq)):
            out[k, i] = _term(wanted[i], dq[k], load[k], slips[k])
    return out


@numba.njit(cache=True)
def _go_on(q, dq, load, tau, joint, memory):  # type: ignore[no-untyped-def]
    """Add the torque of all terms to that of one joint; q, dq, load and tau are (N, n).

    memory, updated in place: the angle before the first sample, the slips of WIDTHS there, and the coefficients of the terms.
    """
    slips, coefficients = memory[1 : 1 + len(WIDTHS)], memory[1 + len(WIDTHS) :]
    for k in range(len(q)):
        step, torque = q[k, joint] - memory[0], 0.0
        way = 1.0 if step > 0 else -1.0
        memory[0] = q[k, joint]
        for i in range(len(WIDTHS)):
            slips[i] = way + (slips[i] - way) * np.exp(-abs(step) / WIDTHS[i])
        for i in range(len(coefficients)):
            if coefficients[i] != 0.0:
                torque += coefficients[i] * _term(i, dq[k, joint], load[k, joint], slips)
        tau[k, joint] += torque
