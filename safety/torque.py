"""|tau| <= tau_max and sum |tau dq| <= power_max for every parameter set that the arm may have, at every sample that is sent.

tau = Y(q, dq, ddq) pi is linear in the parameters, so for pi in a box its interval is exact row by row:
tau in Y pi_0 +- |Y| delta. The box is two standard deviations of the arm's prior wide, and the payload may be a fifth
lighter or heavier than declared. Between two sent samples half the step from one to the next is added.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arm import Arm
from sim.cell import Cell
from sim.errors import SafetyStop
from sim.prior import EFFECT, spread, torque_scale, unstated
from sim.rigid_body import RigidBody, link_parameters
from sim.trajectory import Trajectory

PAYLOAD_DOUBT = 0.2
SIGMAS = 2.0
CHUNK = 20_000
# Universal Robots' safety presets allow up to 1000 W of mechanical power ("least restricted"), the usual preset 300 W
POWER_MAX = 1000.0
# s: windings of servo drives take about a minute and more to warm up (thermal time constants of catalogue servo motors, 30 s to 60 min),
# so that a shorter peak above the continuous torque does no harm
WARMING = 30.0


@dataclass(frozen=True)
class Torque:
    """tau_hat (N, n) N m expected at the joint, friction included; doubt (N, n) N m half-width of its interval."""

    tau_hat: np.ndarray
    doubt: np.ndarray


def torque_interval(motion: Trajectory, arm: Arm, cell: Cell) -> Torque:
    """Expected torque of each sample and the half-width of its interval over the parameter box."""
    body = RigidBody(arm)
    pi, delta = parameter_box(arm, cell)
    f = friction_of(arm)
    tau_hat, doubt = np.empty_like(motion.q), np.empty_like(motion.q)
    for start in range(0, len(motion), CHUNK):
        part = slice(start, start + CHUNK)
        dq, ddq = motion.dq[part], motion.ddq[part]
        y = body.regressor(motion.q[part], dq, ddq)
        tau_hat[part] = y @ pi + f.inertia * ddq + f.coulomb * np.sign(dq) + f.viscous * dq
        doubt[part] = np.abs(y) @ delta + f.inertia_doubt * np.abs(ddq) + f.coulomb_doubt + np.abs(dq) * f.viscous_doubt
    return Torque(tau_hat, doubt)


@dataclass(frozen=True)
class Friction:
    """Each (n,): rotor inertia kg m^2, dry friction N m, viscous friction N m s/rad, and the half-width of the interval of each."""

    inertia: np.ndarray
    inertia_doubt: np.ndarray
    coulomb: np.ndarray
    coulomb_doubt: np.ndarray
    viscous: np.ndarray
    viscous_doubt: np.ndarray


def friction_of(arm: Arm) -> Friction:
    """What the arm's own effects say, with the doubt of what was fitted, or else of its prior (`sim.prior.spread`).

    What nobody stated is not none: it may be as much as an ordinary drive has. A rotor takes no more than tau_max at ddq_max, or the arm
    could not reach that acceleration.
    """
    wide = spread(arm)
    inertia, inertia_doubt = _rows(arm, "rotor", wide["rotor"])
    inertia_doubt = np.minimum(inertia_doubt, np.maximum(inertia, torque_scale(arm) / arm.ddq_max))
    return Friction(inertia, inertia_doubt, *_rows(arm, "coulomb", wide["coulomb"]), *_rows(arm, "viscous", wide["viscous"]))


WORDS = {"coulomb": "dry friction", "viscous": "viscous friction", "rotor": "rotor inertia"}


def missing_facts(arm: Arm, joint: int) -> str:
    """What nobody stated of a joint and the proof therefore takes as large, as the end of a refusal; "" where all is stated."""
    missing = [WORDS[key] for key, rows in unstated(arm).items() if rows[joint]]
    if not missing:
        return ""
    return (
        f". Nobody stated {' and '.join(missing)} of {arm.joint_names[joint]}, so they count as much as an ordinary drive has: state "
        f"them in arm.toml, or identify the arm on a slower motion first"
    )


def parameter_box(arm: Arm, cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Centre (10 n,) and half-widths (10 n,) of the inertial parameters, the declared payload on the last link included."""
    tree, prior = arm.tree, arm.prior
    pi, delta = [], []
    for mass, com, inertia in zip(tree.mass, tree.com, tree.inertia, strict=True):
        centre = link_parameters(mass, com, inertia)
        reach = float(np.linalg.norm(com)) + float(np.sqrt(max(np.trace(inertia), 0.0) / (2 * mass))) if mass > 0 else 0.0
        widths = np.empty(10)
        widths[0] = prior.mass * mass
        widths[1:4] = np.abs(centre[1:4]) * prior.mass + mass * reach * prior.com
        widths[4:] = prior.inertia * np.trace(inertia) + mass * reach**2 * (prior.mass + 2 * prior.com)
        pi.append(centre)
        delta.append(SIGMAS * widths)
    if cell.table.payload is not None:
        load = cell.table.payload
        more = link_parameters(load.mass, np.array(load.com), np.zeros((3, 3)))
        pi[-1] = pi[-1] + more
        delta[-1] = delta[-1] + PAYLOAD_DOUBT * np.abs(more)
    return np.concatenate(pi), np.concatenate(delta)


def check_torque(motion: Trajectory, torque: Torque, arm: Arm) -> dict[str, float]:
    """Refuse a motion whose torque, RMS torque or power interval leaves the limits; returns the largest share of each that is used."""
    worst = np.abs(torque.tau_hat) + torque.doubt + _half_steps(torque.tau_hat)
    inside = np.isfinite(worst) & (worst <= arm.tau_max)
    if not inside.all():
        k, j = np.argwhere(~inside)[0]
        raise SafetyStop(
            f"{arm.joint_names[j]}: torque up to {worst[k, j]:.4g} N m (expected {torque.tau_hat[k, j]:.4g}, doubt "
            f"{torque.doubt[k, j]:.4g}) exceeds {arm.tau_max[j]:.4g} N m at t={motion.t[k]:.4f} s; plan a slower motion, declare the "
            f"real payload in the cell file, or state better known masses in [prior] of arm.toml{missing_facts(arm, j)}"
        )
    power = np.sum(worst * (np.abs(motion.dq) + _half_steps(motion.dq)), axis=1)
    inside = np.isfinite(power) & (power <= POWER_MAX)
    if not inside.all():
        k = int(np.argmin(inside))
        raise SafetyStop(
            f"{arm.name}: mechanical power up to {power[k]:.4g} W exceeds {POWER_MAX:g} W at t={motion.t[k]:.4f} s; plan a slower motion"
        )
    rms, rated = _largest_rms(motion.t, worst), arm.tau_max if arm.torque_continuous is None else arm.torque_continuous
    inside = np.isfinite(rms) & (rms <= rated)
    if not inside.all():
        j = int(np.argmin(inside))
        raise SafetyStop(
            f"{arm.joint_names[j]}: RMS torque up to {rms[j]:.4g} N m over {min(WARMING, motion.duration):.3g} s exceeds the {rated[j]:.4g} N m "
            f"that its drive holds for any time (torque_continuous); plan a slower motion, or one about a posture that needs less to hold"
            f"{missing_facts(arm, j)}"
        )
    return {
        "tau": float(np.max(worst / arm.tau_max)), "rms torque": float(np.max(rms / rated)), "power": float(np.max(power) / POWER_MAX),
    }  # fmt: skip


def suffices(motion: Trajectory, arm: Arm, cell: Cell) -> bool:
    """Whether the torque of every sample is within the limits, over the whole box of parameters."""
    torque = torque_interval(motion, arm, cell)
    return bool(np.all(np.abs(torque.tau_hat) + torque.doubt <= arm.tau_max))


def _largest_rms(t: np.ndarray, torque: np.ndarray) -> np.ndarray:
    """(n,) the largest RMS over any WARMING s of torque (N, n) at t (N,), or over all of it where it is shorter."""
    energy = np.vstack(
        (np.zeros((1, torque.shape[1])), np.cumsum(np.diff(t)[:, None] * np.maximum(torque[1:], torque[:-1]) ** 2, axis=0))
    )
    window = min(WARMING, float(t[-1] - t[0]))
    begin = t[t <= t[-1] - window * (1 - 1e-9)]
    end = np.clip(np.searchsorted(t, begin + window, side="left"), 1, len(t) - 1)
    return np.asarray(np.sqrt(np.max(energy[end] - energy[: len(begin)], axis=0) / window))


def _half_steps(x: np.ndarray) -> np.ndarray:
    """Half of the larger step to a neighbouring sample, (N, n)."""
    step = np.abs(np.diff(x, axis=0)) / 2
    return np.maximum(np.vstack((step, np.zeros((1, x.shape[1])))), np.vstack((np.zeros((1, x.shape[1])), step)))


def _rows(arm: Arm, key: str, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A parameter of every joint, zero where the arm has none, and its doubt: the fitted std, or that of the prior."""
    value, doubt = np.zeros(arm.n), SIGMAS * std
    effect, parameter = EFFECT[key]
    missing = unstated(arm)[key]
    for j, joint in enumerate(arm.joint_names):
        known = arm.effect(effect, joint)
        if known is not None:
            value[j] = known.parameters[parameter]
            if not missing[j]:
                doubt[j] = SIGMAS * known.std.get(parameter, std[j])
    return value, doubt
