"""From a published model file to a usable arm: its joints are chosen, and everything missing is requested by name."""

from __future__ import annotations

import fnmatch
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np

from sim.arm import Arm, load_arm
from sim.arm_table import Numbers
from sim.bench_drive import bench_drive
from sim.enclosing import with_pieces
from sim.errors import ConfigError
from sim.files import is_name, printable
from sim.foreign_physics import foreign_physics
from sim.locked import locked, require_within
from sim.mjcf_tree import tree_text
from sim.model import compiled, kinematic_tree
from sim.model_text import urdf_speed_limits
from sim.prior import stated_prior
from sim.resources import nearest
from sim.ros_urdf import NO_MASS, parents_of, reduced_urdf
from sim.size import sized
from sim.tree import KinematicTree

FINGER = 0.15  # m: a last joint that slides by less may be a gripper's finger
ROBOT = 300  # joints of a whole robot, of which the arm is a part
REWRITTEN = (
    "left out: sites, sensors, cameras, keyframes, tendons and actuators of the model; each joint has a motor with gear 1"
)
MOST_TURNS = 10  # of a joint: more than multi-turn drives have; any range above 63 degrees exceeds it if written in degrees


@dataclass
class Choice:
    """Which part of a model file is the arm. joints: names or patterns of the joints that move (all if empty). lock: those held
    still, and where (rad or m). tool: a link; the arm's joints are those between it and the base. no_shapes: accept shapes
    without their mesh. hulls: enclose meshes in convex pieces instead of capsules."""

    joints: Sequence[str] = ()
    lock: Mapping[str, float] = field(default_factory=dict)
    tool: str | None = None
    geometry_only: bool = False
    no_shapes: bool = False
    numbers: Numbers | None = None
    hulls: bool = False


def read_model(file: Path, staging: Path, root: Path | None = None, choice: Choice | None = None) -> tuple[Arm, list[str]]:
    """The arm in a model file, and a sentence for everything left out, held still or not found.

    A URDF is first reduced to links and joints (sim.ros_urdf), its meshes copied to `staging`. ConfigError: what is missing.
    """
    choice = choice or Choice()
    notes: list[str] = []
    shapeless, impossible = False, {}
    if root is not None and not root.is_dir():
        raise ConfigError(f"--root {root}: there is no such folder; give the folder of the ROS package")
    if file.suffix.lower() == ".urdf":
        found = reduced_urdf(file, staging, root)
        notes += found.notes
        shapeless, impossible = bool(found.without_shape), found.impossible
        model = compiled(found.text, staging, str(file))
        tree = kinematic_tree(model, str(file), most=ROBOT)
        rotors = np.array([found.rotors.get(joint, 0.0) for joint in tree.joint_names])
        tree = replace(tree, dq_max=urdf_speed_limits(found.text, tree.joint_names), armature=tree.armature + rotors)
        followers = {name: found.followers[name] for name in tree.joint_names if name in found.followers}
        parents = parents_of(found.text)
        whole, name = None, _name(file, found.text, notes)
    else:
        whole = load_arm(file)
        tree = whole.tree
        model = compiled(whole.model_text, file.parent, str(file))
        followers, parents, name = _followers(model), _body_parents(model), whole.name
        notes += [f"left out of the arm, whose model has no such term: {found}" for found in foreign_physics(model)]
    held = _held(file, tree, choice, followers, parents, notes)
    kept = locked(tree, held) if held else tree
    _check_chain(file, kept, choice, notes)
    _check_radians(file, kept)
    _check_possible(file, impossible, kept, parents, choice, notes)
    massless = [kept.link_names[j] for j in range(kept.n) if kept.mass[j] <= 10 * NO_MASS]
    if massless and not choice.geometry_only:
        raise ConfigError(
            f"{file}: no mass for {', '.join(massless)}; give the links their <inertial>, or use --geometry-only: then only the "
            "geometry counts, every fit treats the masses as unknown, and no motion is possible until they are identified"
        )
    numbers: Numbers | None = "unknown" if choice.geometry_only else choice.numbers
    if choice.geometry_only:
        kept = sized(kept)
        notes.append("masses and inertias are unknown: those in the model are placeholders derived from the arm's size")
    if whole is None or kept is not whole.tree:
        meshes = sum(s.kind == "mesh" for s in kept.shapes)
        kept = with_pieces(kept, choice.hulls)
        if meshes:
            notes.append(
                f"{meshes} collision meshes are enclosed in {'convex pieces' if choice.hulls else 'capsules'}; the arm has {len(kept.shapes)} shapes"
            )
        if whole is not None:
            notes.append(REWRITTEN)
        staged = staging / "model.xml"
        staged.write_text(tree_text(kept, name), encoding="utf-8")
        whole = replace(load_arm(staged), dq_max=kept.dq_max)
    missing = ("shapes",) if shapeless and not choice.no_shapes else ()
    return replace(whole, prior=stated_prior(numbers, kept), incomplete=(*whole.incomplete, *missing)), notes


def drive_arm(name: str, joint: str, load: tuple[float, float] | None, unknown: bool, staging: Path) -> Arm:
    """One drive on a bench as an arm of one joint (sim.bench_drive); a given load counts as measured."""
    tree = bench_drive(joint, load, unknown)
    file = staging / "model.xml"
    file.write_text(tree_text(tree, name), encoding="utf-8")
    return replace(load_arm(file), prior=stated_prior("measured" if load else "unknown", tree))


def _held(
    file: Path, tree: KinematicTree, choice: Choice, followers: Mapping[str, tuple[str, float, float]],
    parents: Mapping[str, str], notes: list[str],
) -> dict[str, float]:  # fmt: skip
    """joint -> angle of each joint that stands still: those locked by name, those not chosen, and followers of another joint."""
    held = {joint: value for pattern, value in choice.lock.items() for joint in _matching(file, tree, pattern)}
    require_within(file, tree, held)
    free = {joint: how for joint, how in followers.items() if joint not in held}
    if choice.tool is not None:
        chain = _chain(file, tree, choice.tool, parents)
        held |= {joint: held.get(joint, 0.0) for joint in tree.joint_names if joint not in chain}
    if choice.joints:
        moving = {joint for pattern in choice.joints for joint in _matching(file, tree, pattern)}
        held |= {joint: held.get(joint, 0.0) for joint in tree.joint_names if joint not in moving}
    for joint, (driver, multiplier, offset) in free.items():
        held[joint] = multiplier * held.get(driver, 0.0) + offset
        notes.append(
            f"joint {joint} follows {driver}: it is held still at {held[joint]:g}, because the joints of an arm move independently here"
            + ("" if driver in held else f", even while {driver} moves; if that moves a large mass, the model is wrong by it")
        )
    if len(held) == tree.n:
        raise ConfigError(f"{file}: no joint is left to move; it has {', '.join(tree.joint_names)}")
    return held


def _matching(file: Path, tree: KinematicTree, pattern: str) -> list[str]:
    found = [name for name in tree.joint_names if fnmatch.fnmatchcase(name, pattern)]
    if not found:
        raise ConfigError(f"{file}: has no joint {pattern!r}; {nearest(pattern, tree.joint_names)}")
    return found


def _chain(file: Path, tree: KinematicTree, link: str, parents: Mapping[str, str]) -> set[str]:
    """Joints between the base and a link; the link may be fixed to a moving one."""
    if link not in parents and link not in tree.link_names:
        wrong = (
            "the base, which does not move" if link in parents.values() else f"no link of the file; {nearest(link, parents)}"
        )
        raise ConfigError(f"{file}: {link!r} is {wrong}")
    while link not in tree.link_names and link in parents:
        link = parents[link]
    end = tree.link_names.index(link) if link in tree.link_names else -1
    return {tree.joint_names[j] for j in np.flatnonzero(tree.moved_by(end))}


def _check_chain(file: Path, tree: KinematicTree, choice: Choice, notes: list[str]) -> None:
    """ConfigError if links branch and no joints were chosen; a note if the last joint looks like a gripper's finger."""
    for link in range(-1, tree.n):
        branches = [tree.joint_names[k] for k in np.flatnonzero(tree.parent == link)]
        if len(branches) > 1 and not choice.joints:
            where = tree.link_names[link] if link >= 0 else "the base"
            raise ConfigError(
                f"{file}: joints {' and '.join(branches)} are both attached to {where}; an arm is one chain. Say with --tool LINK where it "
                f"ends, with --joints which move, or with --lock which stand still (all joints: {', '.join(tree.joint_names)})"
            )
    last = tree.n - 1
    if tree.n > 1 and tree.prismatic[last] and not tree.prismatic[:last].any() and tree.q_max[last] - tree.q_min[last] < FINGER:
        notes.append(f"joint {tree.joint_names[last]} slides at the end of the arm; leave out a gripper's finger with --lock")


def _check_radians(file: Path, tree: KinematicTree) -> None:
    """ConfigError for a range of so many turns that it must be in degrees; one too large even for degrees means no limit."""
    span = np.where(tree.prismatic, 0.0, tree.q_max - tree.q_min)
    for j in np.flatnonzero((span > 2 * np.pi * MOST_TURNS) & (span <= 360 * MOST_TURNS)):
        raise ConfigError(
            f"{file}: joint {tree.joint_names[j]} moves from {tree.q_min[j]:g} to {tree.q_max[j]:g} rad, {span[j] / (2 * np.pi):.0f} turns; at "
            f"most {MOST_TURNS} are read (degrees?): write its limits in radians and radians per second, or declare it continuous"
        )


def _check_possible(
    file: Path, impossible: Mapping[str, np.ndarray], tree: KinematicTree, parents: Mapping[str, str], choice: Choice,
    notes: list[str],
) -> None:  # fmt: skip
    """ConfigError for an inertia of a moving link that no body has; if the numbers are guesses, a note: the nearest is used."""
    for link, moments in impossible.items():
        home = link
        while home not in tree.link_names and home in parents:
            home = parents[home]
        if home not in tree.link_names or choice.geometry_only:
            continue
        what = (
            f"inertia of link {link} has principal moments {', '.join(f'{m:.4g}' for m in moments)} kg m^2, which no body has"
        )
        if choice.numbers != "guessed":
            raise ConfigError(
                f"{file}: {what} (none may be negative, and any two must add up to the third); correct it, or use --numbers guessed: "
                "then the nearest possible one is used"
            )
        notes.append(f"{what}; the nearest possible one is used")


def _followers(model: mujoco.MjModel) -> dict[str, tuple[str, float, float]]:
    """Joints that an MJCF equality ties to another joint or to a constant: joint -> driver, multiplier, offset."""
    out = {}
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}" for j in range(model.njnt)]
    for e in range(model.neq):
        if int(model.eq_type[e]) == int(mujoco.mjtEq.mjEQ_JOINT):
            a, b, terms = int(model.eq_obj1id[e]), int(model.eq_obj2id[e]), model.eq_data[e]
            out[names[a]] = (names[b] if b >= 0 else "the base", float(terms[1]), float(terms[0]))
    return out


def _body_parents(model: mujoco.MjModel) -> dict[str, str]:
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, b) or f"body_{b}" for b in range(model.nbody)]
    return {names[b]: names[int(model.body_parentid[b])] for b in range(1, model.nbody)}


def _name(file: Path, text: str, notes: list[str]) -> str:
    """Name of a URDF's robot, or that of its file, with a note, if the robot's name is not valid for an arm."""
    from xml.etree import ElementTree

    stated = ElementTree.fromstring(text).get("name", "")
    if is_name(stated):
        return stated
    name = file.stem if is_name(file.stem) else "arm"
    notes.append(
        f"{printable(stated)!r} cannot be an arm's name (letters, digits, dots, dashes, underscores); it is {name} unless --name gives another"
    )
    return name


def staging_folder() -> tempfile.TemporaryDirectory[str]:
    """A temporary folder for copies of meshes, deleted at the end of its context."""
    return tempfile.TemporaryDirectory(prefix="calib-arm-")
