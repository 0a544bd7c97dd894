"""Fitted parameters as an arm, which serves wherever the nominal arm does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calib.identification.consistency import PossibleArm
from calib.identification.model import SLIP_WIDTHS, TorqueModel
from sim.arm import Arm, ArmEffect
from sim.arm_folder import write_arm
from sim.arm_table import PriorTable
from sim.effects.presliding_friction import built_up
from sim.rigid_body import link_inertia

FITTED_PROVENANCE = "links, reflected inertias, friction, offsets"
# prior after a fit to motion alone of an arm whose numbers had not been measured: what one recording of about 20 s leaves open
FOUND = {
    "numbers": "measured",
    "unknown": [],
    "mass": 0.05,
    "com": 0.05,
    "inertia": 0.2,
    "coulomb": 0.1,
    "viscous": 0.2,
    "rotor": 0.3,
}
LINEAR_EFFECTS = ("coulomb_friction", "viscous_friction", "rotor_inertia", "torque_offset", "presliding_friction")


def write_calibrated(folder: Path, nominal: Arm, calibrated: Arm) -> Arm:
    """Write the folder of a calibrated arm, based on its nominal model file; return the arm as loaded from there."""
    tree = calibrated.tree
    provenance = {FITTED_PROVENANCE: calibrated.provenance[FITTED_PROVENANCE]}
    if calibrated.torque_constant is not nominal.torque_constant:
        provenance |= {"torque_constant": calibrated.provenance["torque_constant"]}
        nominal = replace(nominal, torque_constant=calibrated.torque_constant)
    nominal = replace(nominal, prior=calibrated.prior, speed_from=calibrated.speed_from)
    inertials = {joint: (float(tree.mass[j]), tree.com[j], tree.inertia[j]) for j, joint in enumerate(calibrated.joint_names)}
    return write_arm(
        folder,
        nominal,
        inertials=inertials,
        effects=calibrated.effects,
        provenance=provenance,
    )


def calibrated_arm(
    arm: Arm, model: TorqueModel, possible: PossibleArm, std: np.ndarray, sources: Sequence[str], laws: Sequence[ArmEffect] = ()
) -> Arm:
    """`arm` with the links, reflected inertias, friction and offsets of `possible`; its other effects stay unchanged.

    std (p,): of friction and offsets, and of a reflected inertia that is a base parameter by itself. Dry friction that reverses
    over more than the narrowest slip width becomes a presliding stiffness, level / width. laws: added to the arm's own of that
    joint.
    """
    n = arm.n
    links = [link_inertia(possible.pi[10 * i : 10 * i + 10]) for i in range(n)]
    own = {
        kind: np.array([possible.theta[model.friction_column(kind, j)] for j in range(n)])
        for kind in ("viscous", "coulomb", "offset")
    }
    own["offset"] *= model.gain
    tree = replace(
        arm.tree,
        mass=np.array([m for m, _, _ in links]),
        com=np.array([c for _, c, _ in links]),
        inertia=np.array([(i + i.T) / 2 for _, _, i in links]),
        armature=possible.pi[10 * n :].copy(),
        damping=own["viscous"],
        frictionloss=own["coulomb"],
    )
    known = {kind: [float(std[model.friction_column(kind, j)]) for j in range(n)] for kind in own}
    known["offset"] = (np.array(known["offset"]) * model.gain).tolist()
    # a reflected inertia that is a base parameter by itself has its own standard deviation
    alone = {name: float(s) for name, s in zip(model.names, std, strict=True) if name.startswith("Ia_")}
    effects = []
    for j, joint in enumerate(arm.joint_names):
        for kind, effect in (("coulomb", "coulomb_friction"), ("viscous", "viscous_friction"), ("offset", "torque_offset")):
            effects.append(ArmEffect(effect, joint, {kind: float(own[kind][j])}, {kind: known[kind][j]}))
        sure = {"inertia": alone[f"Ia_{j + 1}"]} if f"Ia_{j + 1}" in alone else {}
        effects.append(ArmEffect("rotor_inertia", joint, {"inertia": float(tree.armature[j])}, sure))
    wide = [j for j in range(n) if model.slip_width[j] > SLIP_WIDTHS[0] and own["coulomb"][j] > 0]
    replaced: set[tuple[str, str]] = set()
    for j in wide:
        effects += built_up(arm.joint_names[j], float(own["coulomb"][j]), float(model.slip_width[j]))
    for law in laws:
        own_law = arm.effect(law.effect, law.joint)
        terms = {k: v + (own_law.parameters[k] if own_law else 0.0) for k, v in law.parameters.items()}
        effects.append(replace(law, parameters=terms))
        replaced.add((law.effect, law.joint or ""))
    kept = [e for e in arm.effects if e.effect not in LINEAR_EFFECTS and e.key not in replaced]
    fitted = "identified by calib identify from " + ", ".join(sources)
    provenance = dict(arm.provenance) | {FITTED_PROVENANCE: fitted}
    return replace(arm, tree=tree, effects=(*effects, *kept), provenance=provenance, prior=_known(arm.prior))


def _known(prior: PriorTable) -> PriorTable:
    """Prior of the calibrated arm: guessed or unknown numbers are now measured."""
    if prior.numbers not in ("guessed", "unknown"):
        return prior.model_copy(update={"unknown": []})
    return prior.model_copy(update=FOUND)
