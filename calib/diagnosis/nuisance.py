"""The nuisance: uncertain parameters of every arm, free within their priors beside every effect. Order, spreads and columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from calib.measurement.ripple_cycles import waves
from sim.arm import Arm, ArmEffect
from sim.prior import spread
from sim.torque_path import PathState

# No model file states how dry friction builds up: its width is SLIP_WIDTH within a factor (e^0.7), its lead some milliseconds.
WIDTH_SPREAD = 0.7
LEAD_SPREAD = 4e-3
# A drive that holds its torque between control instants leads its own reading by half a control period (1 ms at 500 Hz).
DELAY_MEAN, DELAY_SPREAD = -0.7e-3, 0.35e-3
# Unmodelled drive dynamics act like a reflected inertia that is off by one factor on all joints.
ROTOR_TOGETHER = 0.3
# Motors warm up: share of all friction that may go in a minute of work, or over the whole rise of the measured temperature.
WARMTH_SPREAD = 0.015
WARMING_SPREAD = 0.03
# steps of the finite differences by width (a factor) and lead (s)
WIDER, LATER = 1.3, 1e-3
BEYOND = 3.0  # prior standard deviations
OWN = ("Fc", "Fv", "Ia", "offset", "width", "lead", "warmth", "ripple_sin", "ripple_cos")
# effect, parameter and prior of the first three of OWN, which cannot be negative
POSITIVE = (
    ("coulomb_friction", "coulomb", "coulomb"),
    ("viscous_friction", "viscous", "viscous"),
    ("rotor_inertia", "inertia", "rotor"),
)


@dataclass(frozen=True)
class Ripple:
    """A gear ripple along a joint's angle: cycles in a turn, and size N m, the amplitude that scales its prior."""

    cycles: float
    size: float


def nuisance_names(n: int) -> list[str]:
    """The uncertain parameters of an arm of n joints, in the order of their columns."""
    links = [f"{what}_{i + 1}" for i in range(n) for what in ("m", "cx", "cy", "cz", "I")]
    return [*links, *[f"{what}_{j + 1}" for j in range(n) for what in OWN], "Ia_all", "delay"]


def first_own(n: int) -> int:
    """Index of the first joint's own parameters, after those of the links."""
    return 5 * n


@lru_cache
def nuisance_of_joint(n: int, j: int) -> np.ndarray:
    """(q,) indices of the parameters that affect joint j: of the links from its own on, its own, and those of all joints."""
    own = first_own(n) + len(OWN) * j
    used = np.r_[5 * j : 5 * n, own : own + len(OWN), first_own(n) + len(OWN) * n : len(nuisance_names(n))]
    used.flags.writeable = False
    return used


def spreads(arm: Arm) -> dict[str, np.ndarray]:
    """Standard deviations (n,) of `coulomb`, `viscous`, `rotor` and `offset`; the offset is 0 unless listed as unknown."""
    out = spread(arm)
    if "offset" not in arm.prior.unknown:
        out["offset"] = np.zeros(arm.n)
    return out


def own_columns(
    state: PathState,
    own: Sequence[ArmEffect],
    spread: Mapping[str, float],
    rate: np.ndarray,
    wider: np.ndarray,
    later: np.ndarray,
    lost: np.ndarray,
    written: bool,
    waves: np.ndarray,
) -> tuple[np.ndarray, ...]:
    """(N,) N m per prior standard deviation of OWN, of all reflected inertias together and of the delay, for one joint.

    state has arrays (N, 1). own: the joint's effects; spread: its standard deviations; rate (N,): d tau / dt; wider, later
    (N,): change of torque with a width WIDER times as large and a lead longer by LATER; lost: `friction_lost`; written: as an
    arm folder can hold it, without lead; waves (N, 2): `waves_of`.
    """
    friction = state.warmth[:, 0] * state.slip[:, 0]
    viscous = sum((e.parameters["viscous"] for e in own if e.effect == "viscous_friction"), 0.0)
    rotor = sum((e.parameters["inertia"] for e in own if e.effect == "rotor_inertia"), 0.0)
    speed, push = state.dq_motor[:, 0], state.ddq_motor[:, 0]
    return (
        spread["coulomb"] * friction,
        spread["viscous"] * speed,
        spread["rotor"] * push,
        np.full(len(rate), spread["offset"]),
        WIDTH_SPREAD / np.log(WIDER) * wider,
        (0.0 if written else LEAD_SPREAD / LATER) * later,
        -lost * (friction * state.level[:, 0] + viscous * speed),
        *waves.T,
        ROTOR_TOGETHER * rotor * push,
        -DELAY_SPREAD * rate,
    )


def friction_lost(t: np.ndarray, warming: np.ndarray | None) -> np.ndarray:
    """(N,) share of friction lost, one prior standard deviation, at times t (N,) s.

    warming (N,): of the joint, None if not measured.
    """
    return WARMTH_SPREAD * t / 60.0 if warming is None else WARMING_SPREAD * warming


def waves_of(ripple: Ripple | None, angle: np.ndarray) -> np.ndarray:
    """(N, 2) N m of sine and cosine along a joint's angle (N,) rad, one prior standard deviation; zeros without a ripple."""
    if ripple is None:
        return np.zeros((len(angle), 2))
    return ripple.size * waves(ripple.cycles, angle)


def within_prior(names: Sequence[str], theta: np.ndarray) -> np.ndarray:
    """theta (p,) with warmth and delay, which no arm folder holds, clipped to BEYOND: anything beyond is an effect."""
    free = np.array([name.startswith("warmth_") or name == "delay" for name in names])
    return np.where(free, np.clip(theta, -BEYOND, BEYOND), theta)
