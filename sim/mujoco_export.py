"""An arm as a MuJoCo model with every effect: native elements where plain MuJoCo has one, the rest as a table inside the model.

The table is the <custom> text `calib_effects`: `calib.mujoco` reads it and simulates what no element can.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from sim.arm import Arm, ArmEffect
from sim.arm_folder import JOINT_KEYS, model_text
from sim.effects import Effect, Exported, Stage, effect_named
from sim.exported_table import SCHEMA, TABLE
from sim.foreign_physics import foreign_physics, without_foreign_physics
from sim.mjcf import SOFT_STEP, STEP, add_passive, joint_size, least_rotor, numbers, section
from sim.mjcf_drives import add_readings, set_limit, set_range
from sim.mjcf_edit import actuators_of, bodies_of, in_degrees
from sim.mjcf_form import passive
from sim.model import compiled
from sim.own_values import value_of
from sim.rigid_body import RigidBody
from sim.self_contact import exclude_lasting_contacts
from sim.slip import SLIP_WIDTH
from sim.split_joint import extend_keys, split_joint

Element = ElementTree.Element
DRY, WORLD, LAST = "calib_dry_friction_{}", "calib_world", "calib_last_link"
# the stiffest bristle of a joint of inertia M at a step h: its natural frequency is a quarter of 1/h
STIFFEST = 0.25**2
# bristle damping in units of stiffness * step. MuJoCo uses the deflection of the previous step, which acts as a damping of -stiffness * step;
# with less than this against it, a joint at rest under load vibrates and creeps by 1 mrad/s
DAMPING = 1.5
LITTLE = 0.01  # of a joint's inertia: no error that is stated


@dataclass(frozen=True)
class ExportedModel:
    """MJCF text, the files it names (path beside it -> file), the table of its effects, and the foreign physics removed."""

    text: str
    files: dict[str, Path]
    table: dict[str, Any]
    removed: list[str]


@dataclass(frozen=True)
class _Entry:
    item: ArmEffect
    effect: Effect
    form: Exported


def exported_model(arm: Arm) -> ExportedModel:
    """The arm for MuJoCo, with ctrl as in the arm's own model: the elements of effects add no entries."""
    entries = []
    for item in arm.effects:
        effect = effect_named(item.effect)
        sized = joint_size(arm, item.joint or arm.joint_names[0])
        entries.append(_Entry(item, effect, effect.exported(item.joint or "", item.parameters, sized)))
    text, files = model_text(arm)
    model = compiled(text, arm.model_path.parent, arm.name)
    root = ElementTree.fromstring(text, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    without_foreign_physics(root)
    exclude_lasting_contacts(root, model, arm)
    bodies = dict(zip(arm.joint_names, bodies_of(root), strict=True))
    soft = any(e.form.twist for e in entries)
    step = min(float(model.opt.timestep), SOFT_STEP if soft else STEP)
    _set_option(root, step)
    section(root, "actuator")
    degrees = in_degrees(root)
    elements = actuators_of(root)
    own = [e for e in elements if not e.get("name", "").startswith("calib_")]
    inertia = _inertia(arm)
    dry, heavier = {}, {}
    for j, joint in enumerate(arm.joint_names):
        here = [e for e in entries if e.item.joint == joint]
        element, motors = bodies[joint][1], [e for e in own if e.get("joint") == joint]
        for entry in here:
            attributes = entry.form.mjcf.joint if entry.form.mjcf else {}
            element.attrib.update({k: v for k, v in attributes.items() if k not in JOINT_KEYS})
        bend = np.sum([e.form.damping for e in here], axis=0) if here else np.zeros(3)
        if np.any(bend) or np.any(model.dof_dampingpoly[j]):
            element.set("damping", numbers(np.add(bend, (value_of(arm, "viscous_friction", joint, "viscous"), 0.0, 0.0))))
        if np.any(model.jnt_stiffnesspoly[j]):
            element.set("stiffness", numbers([model.jnt_stiffness[j]]))
        set_range(element, arm, model, j, degrees)
        limits = [e.form.limit for e in here if e.form.limit is not None]
        if np.isfinite(arm.tau_max[j]) and not np.isclose(arm.tau_max[j], arm.tree.tau_max[j]):
            limits.append(float(arm.tau_max[j]))
        if model.jnt_actfrclimited[j]:  # it would also clip what the passive elements add
            element.set("actuatorfrclimited", "false")
            limits.append(float(np.abs(model.jnt_actfrcrange[j]).min()))
        set_limit(model, elements, motors, limits)
        law = _dry_friction(here, float(inertia[j]), step, arm.tau_max[j])
        if law is not None:
            dry[joint] = law
            element.set("frictionloss", "0")
            lugre = {"lugre": numbers([law["stiffness"], law["damping"], *law["lugre"]])}
            add_passive(root, passive(DRY.format(joint), joint=joint) | lugre)
            if not any(e.form.twist or (e.effect.stage is Stage.FRICTION and e.form.form == "callback") for e in here):
                heavier[joint] = _without_implicit_inertia(element, arm, joint, step * law["damping"], float(inertia[j]))
    _add_forces(root, model, bodies, entries)
    add_readings(root, own, arm, max([e.form.delay for e in entries], default=0.0), step)
    gears = {e.item.joint: e for e in entries if e.form.twist and e.item.joint is not None}
    raised = {}
    for joint, entry in gears.items():
        least = least_rotor(entry.form.twist, step)
        if value_of(arm, "rotor_inertia", joint, "inertia") < least:
            raised[joint] = least
            bodies[joint][1].set("armature", numbers([least]))
        split_joint(root, bodies, joint, entry.form, model)
    extend_keys(root, [arm.joint_index(joint) for joint in gears], lambda: _states(root, arm))
    table = _table(arm, entries, dry, {e.get("joint") for e in own}, gears, raised, heavier)
    for custom in root.findall("custom"):
        for old in [e for e in custom.findall("text") if e.get("name") == TABLE]:
            custom.remove(old)
    ElementTree.SubElement(section(root, "custom"), "text", {"name": TABLE, "data": json.dumps(table, allow_nan=False)})
    ElementTree.indent(root)
    return ExportedModel(ElementTree.tostring(root, encoding="unicode") + "\n", files, table, foreign_physics(model))


def _states(root: Element, arm: Arm) -> int:
    """Number of activation states of the model's motors."""
    bare = deepcopy(root)
    for place in bare.findall("keyframe"):
        bare.remove(place)
    return int(compiled(ElementTree.tostring(bare, encoding="unicode"), arm.model_path.parent, arm.name).na)


def _table(
    arm: Arm,
    entries: Iterable[_Entry],
    dry: dict[str, dict[str, Any]],
    driven: set[str | None],
    gears: dict[str, _Entry],
    raised: dict[str, float],
    heavier: dict[str, float],
) -> dict[str, Any]:
    """Table that `calib.mujoco` reads and `calib export` reports: each effect with its parameters, form, element and error."""
    rows = []
    for entry in entries:
        item, form = entry.item, entry.form
        error, kind, how = form.error, form.form, "dcmotor lugre" if form.dry and item.joint in dry else form.how
        if form.limit is not None and item.joint not in driven:
            error = "this model has no motor on the joint: limit the torque that you apply"
        if form.twist and gears.get(item.joint or "") is not entry:
            error, kind, how = "left out: another effect of this joint is its soft gear", "none", ""
        elif form.twist and item.joint in raised:
            error = (
                f"reflected inertia raised to {raised[item.joint]:.2g} kg m^2: the simulation step needs it behind this gear"
            )
        if "stiffness" in form.dry and dry.get(item.joint or "", {}).get("softened"):
            error = f"softened to {dry[item.joint or '']['stiffness']:.3g} N m/rad, the limit of the simulation step"
        elif form.dry and heavier.get(item.joint or "", 0.0) > LITTLE:
            more = f"the joint moves as with {heavier[item.joint or '']:.0%} more inertia"
            error = f"{error}; {more}" if error else more
        rows.append({
            "effect": item.effect, "joint": item.joint, "parameters": item.parameters, "form": kind, "how": how,
            "error": error, "shapes": "excess" in form.dry or "stiffness" in form.dry,
        })  # fmt: skip
    return {
        "schema": SCHEMA,
        "arm": arm.name,
        "sha256": arm.sha256,
        "joints": list(arm.joint_names),
        "dry_friction": dry,
        "effects": rows,
    }


def _inertia(arm: Arm) -> np.ndarray:
    """Least inertia (n,) kg m^2 at each joint: its reflected inertia, plus the links at q = 0 with the other joints free."""
    rotors = [joint_size(arm, joint).rotor for joint in arm.joint_names]
    mass = RigidBody(arm).mass_matrix(np.zeros(arm.n))
    return np.array(rotors) + 1 / np.diag(np.linalg.inv(mass))


def _dry_friction(here: list[_Entry], inertia: float, step: float, tau_max: float) -> dict[str, Any] | None:
    """LuGre element of a joint whose dry friction is more than a constant level; None if frictionloss expresses all of it."""
    shares: dict[str, float] = {}
    for entry in here:
        shares |= entry.form.dry
    varies = any(e.effect.stage is Stage.FRICTION and e.form.form == "callback" for e in here)
    if not varies and not set(shares) - {"level"}:
        return None
    level, excess = shares.get("level", 0.0), shares.get("excess", 0.0)
    peak = level + excess
    if not varies and peak <= 0:
        return None
    if "stiffness" in shares:
        stiffness = shares["stiffness"]
    else:
        usual = peak if peak > 0 else 0.01 * (tau_max if np.isfinite(tau_max) else 100.0)
        stiffness = usual / SLIP_WIDTH
    floor = max(peak, 1e-9)  # MuJoCo wants a level above zero
    lugre = [max(level, floor - excess), floor, shares.get("velocity", 1.0)]
    stiffest = STIFFEST * inertia / step**2
    softened, stiffness = bool(stiffness > stiffest and "stiffness" in shares), float(min(stiffness, stiffest))
    law = {"stiffness": stiffness, "damping": DAMPING * stiffness * step, "softened": softened, "lugre": lugre}
    # a level that varies, with a build-up of no stated stiffness, builds up over the same distance at every level
    return law | ({} if "stiffness" in shares else {"stiffest": float(stiffest)})


def _without_implicit_inertia(element: Element, arm: Arm, joint: str, excess: float, inertia: float) -> float:
    """Lower the reflected inertia by `excess` kg m^2, which MuJoCo adds; return the share of the joint's inertia that is left too much.

    implicitfast counts the bristle's damping as that of the joint, although a bristle that slides does not move with it: step * damping
    is added to the joint's inertia.
    """
    rotor = value_of(arm, "rotor_inertia", joint, "inertia")
    taken = min(excess, rotor)
    element.set("armature", numbers([rotor - taken]))
    return (excess - taken) / inertia


def _set_option(root: Element, step: float) -> None:
    """Set integrator and step: passive actuators and stiff friction need implicitfast and at most a millisecond."""
    option = section(root, "option")
    for other in root.findall("option"):
        for key in ("timestep", "integrator"):
            other.attrib.pop(key, None)
    option.set("timestep", repr(step))
    option.set("integrator", "implicitfast")


def _add_forces(
    root: Element, model: mujoco.MjModel, bodies: dict[str, tuple[Element, Element]], entries: list[_Entry]
) -> None:
    """Add a constant force in the world on the origin of the last link."""
    forces = [e.form.force for e in entries if e.form.force is not None]
    if not forces:
        return
    world, last = root.find("worldbody"), list(bodies.values())[-1][0]
    if world is None:
        return
    for place, name, position in ((world, WORLD, np.zeros(3)), (last, LAST, model.jnt_pos[len(bodies) - 1])):
        ElementTree.SubElement(place, "site", {"name": name, "pos": numbers(position)})
    at = {"site": LAST, "refsite": WORLD, "gear": numbers([*np.sum(forces, axis=0), 0, 0, 0])}
    add_passive(root, passive("calib_tool_force", 1.0) | at)
