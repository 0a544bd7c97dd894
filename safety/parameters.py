"""The box of an arm's parameters before a motion: two standard deviations to either side of their nominal values.

The payload may be a fifth lighter or heavier than declared.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.arm import Arm
from sim.cell import Cell
from sim.prior import EFFECT, spread, torque_scale, unstated
from sim.rigid_body import link_parameters

PAYLOAD_DOUBT = 0.2
SIGMAS = 2.0


@dataclass(frozen=True)
class Friction:
    """Each (n,): reflected inertia kg m^2, dry friction N m, viscous friction N m s/rad, and the half-width of each."""

    inertia: np.ndarray
    inertia_doubt: np.ndarray
    coulomb: np.ndarray
    coulomb_doubt: np.ndarray
    viscous: np.ndarray
    viscous_doubt: np.ndarray


def friction_of(arm: Arm) -> Friction:
    """The arm's own effects, with the uncertainty of the fit, or else of the prior (`sim.prior.spread`).

    An unstated value is not zero: it may be as large as in an ordinary drive. Reflected inertia takes no more than tau_max at
    ddq_max, or the arm could not reach that acceleration.
    """
    wide = spread(arm)
    inertia, inertia_doubt = _rows(arm, "rotor", wide["rotor"])
    inertia_doubt = np.minimum(inertia_doubt, np.maximum(inertia, torque_scale(arm) / arm.ddq_max))
    return Friction(inertia, inertia_doubt, *_rows(arm, "coulomb", wide["coulomb"]), *_rows(arm, "viscous", wide["viscous"]))


WORDS = {"coulomb": "dry friction", "viscous": "viscous friction", "rotor": "reflected inertia"}


def missing_facts(arm: Arm, joint: int) -> str:
    """The end of a refusal: which values of a joint are unstated and therefore assumed large; "" if all are stated."""
    missing = [WORDS[key] for key, rows in unstated(arm).items() if rows[joint]]
    if not missing:
        return ""
    return (
        f". No values are stated for {' and '.join(missing)} of {arm.joint_names[joint]}, so they are assumed as large as in an "
        f"ordinary drive: state them (`calib arm new --drive`), or identify the arm on a slower motion first"
    )


def reach_of(mass: float, com: np.ndarray, inertia: np.ndarray) -> float:
    """m: distance of a link's centre of mass from its joint plus its radius of gyration; com (3,) m, inertia (3, 3) kg m^2 about it."""
    return float(np.linalg.norm(com) + np.sqrt(max(np.trace(inertia), 0.0) / (2 * mass))) if mass > 0 else 0.0


def parameter_box(arm: Arm, cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Centre (10 n,) and half-widths (10 n,) of the inertial parameters, including the declared payload on the last link."""
    tree, prior = arm.tree, arm.prior
    pi, delta = [], []
    for mass, com, inertia in zip(tree.mass, tree.com, tree.inertia, strict=True):
        centre = link_parameters(mass, com, inertia)
        reach = reach_of(mass, com, inertia)
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


def _rows(arm: Arm, key: str, std: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A parameter of every joint, zero where the arm has none, and its half-width: SIGMAS times the fitted or prior std."""
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
