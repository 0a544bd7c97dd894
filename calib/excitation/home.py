"""Where motions begin: a posture in which motions have room, and the cell assumed for an arm without one."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from calib.excitation.climb import Slack, climbed
from calib.excitation.design import fitted_to_room
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.reaches import sweepable
from calib.excitation.room import Room
from safety.collision import Clearance
from safety.parameters import missing_facts
from safety.reach import spine
from sim.arm import Arm
from sim.cell import Cell, CellTable, MotionTable
from sim.errors import AnswerIsNo, ConfigError
from sim.postures import postures
from sim.prior import unstated
from sim.rigid_body import RigidBody

# random postures per draw, and most draws until twice LOOKED_AT are clear and can be held
POSTURES, DRAWS = 1000, 8
LOOKED_AT = 15
# share of half a joint's range, or of pi if that is less, about its middle from which postures are drawn
ABOUT_MIDDLE = 0.6
# share of random postures that are clear and can be held, below which there is little choice
SCARCE = 0.1
# least share of random postures that must be free for capsules to suffice
FREE = 0.1
# share of the usable torque that the gentlest stop may take at a home: up to ENOUGH the roomiest posture stays; above it one of
# at most CALM is preferred, which leaves torque for the motion and the boxes of its proof. Tuned on one arm: tiago's plan is
# refused at a home where the stop takes 1.08 and verified where it takes 0.73; at the homes of ur10e, ur3e, ur20 and servo6 it
# takes 0.5 or less
ENOUGH, CALM = 1.0, 0.7
PLANE = "mounting_plane"


def open_cell(arm: Arm) -> Cell:
    """Cell of an arm of which nothing else is known: it stands on a plane below all shapes of constant height.

    These are the fixed shapes and those that only a joint with a vertical axis turns; the latter also need their clearance. The
    plane is at least 50 mm below the origin of the base, to leave room for a flange.
    """
    heights, tree = [-0.05], arm.tree
    upright = not tree.prismatic[0] and np.allclose(np.abs((tree.rotation[0] @ tree.axis[0])[2]), 1.0)
    for shape in tree.shapes:
        points, radius = spine(shape)
        if shape.link < 0:
            heights.append(float(points[:, 2].min()) - radius)
        elif shape.link == 0 and upright:
            lowest = points @ tree.rotation[0][2] + tree.position[0][2] - radius
            heights.append(float(lowest.min()) - MotionTable().clearance_obstacle - 2 * CLEARANCE_MARGIN)
    height = float(np.floor(min(heights) * 1e3) / 1e3)
    table = CellTable.model_validate(
        {
            "schema": "cell/1", "name": "open", "arm": arm.name, "driver": "mock",
            "obstacles": [{"kind": "plane", "name": PLANE, "position": [0, 0, height], "normal": [0, 0, 1]}],
        }
    )  # fmt: skip
    return Cell(table, Path("open"), "0" * 64)


def free_share(arm: Arm) -> float:
    """Share of random postures with the clearances that a proof requires, in the open cell; 1 without moving shapes."""
    if all(shape.link < 0 for shape in arm.tree.shapes):
        return 1.0
    cell = open_cell(arm)
    clearance = Clearance(arm, cell)
    needed = clearance.needed(cell.table.motion.following_error) + CLEARANCE_MARGIN
    return float(np.mean([np.all(clearance.distances(q) >= needed) for q in postures(arm)]))


def posture(text: str, arm: Arm) -> np.ndarray:
    """(n,) rad from comma-separated numbers."""
    try:
        found = np.array([float(x) for x in text.split(",")])
    except ValueError:
        found = np.zeros(0)
    if found.shape != (arm.n,) or not np.all(np.isfinite(found)):
        raise ConfigError(
            f"--home {text!r}: {arm.name} needs {arm.n} comma-separated numbers in rad, such as 0,-1.4,1.3,-1.4,-1.2,0.3"
        )
    return found


def home_of(room: Room, cell: Cell, wanted: np.ndarray | None, rng: np.random.Generator) -> np.ndarray:
    """Posture (n,) rad where every motion begins and ends: as given, the cell's home, or the roomiest of many random ones."""
    arm = room.arm
    given = wanted if wanted is not None else None if cell.table.home is None else np.array(cell.table.home)
    if given is not None:
        if given.shape != (arm.n,) or not np.all((arm.q_min <= given) & (given <= arm.q_max)):
            raise ConfigError(
                f"home {np.round(given, 3).tolist()} rad: {arm.name} has {arm.n} joints within {np.round(arm.q_min, 2).tolist()} to "
                f"{np.round(arm.q_max, 2).tolist()} rad; give a posture inside them with --home"
            )
        return given
    middle, half = (arm.q_max + arm.q_min) / 2, np.minimum((arm.q_max - arm.q_min) / 2, np.pi)
    parts: list[tuple[np.ndarray, ...]] = []
    slack: Slack | None = None
    for _ in range(DRAWS):
        q = middle + ABOUT_MIDDLE * half * rng.uniform(-1, 1, (POSTURES, arm.n))
        (clearances, names), holding = room.nearness.clearances(q), room.holding(q)
        slack = slack or Slack(clearances, holding)
        near = (clearances < CLEARANCE_MARGIN).mean(axis=0)
        parts.append((q, clearances.min(axis=1), holding, slack.of(clearances, holding), near))
        q, free, taken, spare = (np.concatenate([part[k] for part in parts]) for k in range(4))
        clear, share = free >= CLEARANCE_MARGIN, taken.max(axis=1)
        usable = clear & (share <= 1)
        if np.count_nonzero(usable) >= 2 * LOOKED_AT:
            break
    candidates = None
    if slack and usable.mean() <= SCARCE:  # torque and room leave little choice, so look for slack in both
        candidates = climbed(room, slack, q, spare, middle, half, rng)
    if candidates is None and not clear.any():
        near = np.mean([part[-1] for part in parts], axis=0)
        worst = int(np.argmax(near))
        raise AnswerIsNo(
            f"{arm.name} in {cell.name}: in none of {len(q)} postures is the arm clear of itself and the cell; {names[worst][0]} and {names[worst][1]} are too "
            f"near to each other in {near[worst]:.0%} of them: correct these two shapes or obstacles, or give a free posture with --home"
            + (
                f"; {PLANE} is assumed if no cell is given: state with --cell where the arm stands"
                if PLANE in names[worst]
                else ""
            )
        )
    if candidates is None and not usable.any():
        best = int(np.argmin(np.where(clear, share, np.inf)))
        j = int(np.argmax(taken[best]))
        raise AnswerIsNo(
            f"{arm.name}: in none of {clear.sum()} postures that are clear of itself and the cell do its torque limits hold it, given the uncertainty of "
            f"its masses: {arm.joint_names[j]} may take {share[best]:.0%} of its limit (less margin) in the best of them. Correct tau_max "
            f"({np.round(arm.tau_max, 1).tolist()} N m) or the masses, state with --numbers how well they are known, or give a posture with "
            f"--home{_unsupported(arm, q[clear], j)}{missing_facts(arm, j)}"
        )
    if candidates is None:  # the roomiest first
        candidates = q[np.argsort(-np.where(share <= 1, free, -np.inf))]
    basis = Basis(4, 20.0)
    trials = [random_fourier(basis, middle, np.random.default_rng(seed)) for seed in range(4)]
    by_torque = q[np.argsort(np.where(clear, share, np.inf))]
    best, best_key, most = candidates[0], (False, False, -np.inf), ENOUGH
    unsure = any(rows.any() for rows in unstated(arm).values())
    # if torque allows no motion about the roomiest, or hardly a stop: free postures that take least to hold, then to stop
    for ranked_postures in itertools.chain((candidates, by_torque), _steady(room, middle, half, rng)):
        chosen = free_postures(room, ranked_postures[: 2 * LOOKED_AT])
        scores = np.array([sum(_amplitude(room, Fourier(basis, q, trial.x)) for trial in trials) for q in chosen])
        # torque that is only assumed, for unstated drive values, is no reason for another home: the plan asks for these values
        strain = np.full(len(chosen), ENOUGH) if unsure else np.maximum(room.stopping(chosen).max(axis=1), most)
        for k in np.lexsort((-scores, strain, scores <= 0)).tolist():
            key = (bool(scores[k] > 0), bool(scores[k] > 0 and sweepable(room, chosen[k])), -max(float(strain[k]), ENOUGH))
            if key > best_key:
                best, best_key = chosen[k], key
            if key[1]:
                break
        if best_key[0] and (unsure or (best_key[1] and best_key[2] >= -ENOUGH)):
            break
        most = CALM
    return np.round(best, 3)


def _steady(room: Room, middle: np.ndarray, half: np.ndarray, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield postures with torque slack for the gentlest stop as well, largest first; nothing if there are none."""
    q = middle + ABOUT_MIDDLE * half * rng.uniform(-1, 1, (POSTURES, room.arm.n))
    clearances, stopping = room.nearness.clearances(q)[0], room.stopping(q)
    slack = Slack(clearances, stopping)
    found = climbed(room, slack, q, slack.of(clearances, stopping), middle, half, rng, room.stopping)
    if found is not None:
        yield found


def _unsupported(arm: Arm, q: np.ndarray, joint: int) -> str:
    """Clause: what is likely missing if the file's masses alone exceed tau_max in the median of postures q (N, n).

    A real arm holds itself up. Empty otherwise.
    """
    weight = np.abs(RigidBody(arm).inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))[:, joint])
    if np.median(weight) <= arm.tau_max[joint]:
        return ""
    return (
        f". The file's masses alone require {np.median(weight):.3g} N m of {arm.joint_names[joint]} in the median posture: if a spring or a "
        f"counterbalance carries them, state it (`calib arm new --spring`)"
    )


def free_postures(room: Room, q: np.ndarray) -> np.ndarray:
    """First LOOKED_AT of postures q, in order, at which the bodies themselves are free; if none is, just the first ones.

    The bodies are checked because a capsule does not contain a cylinder's rim.
    """
    needed = room.clearance.needed(room.cell.table.motion.following_error) + CLEARANCE_MARGIN
    free = [k for k, posture in enumerate(q) if np.all(room.clearance.distances(posture) >= needed)]
    return q[free[:LOOKED_AT] or slice(LOOKED_AT)]


def _amplitude(room: Room, motion: Fourier) -> float:
    """Sum over the joints of the peak speed of the motion once it fits, as a share of dq_max; 0 if it does not fit."""
    found = fitted_to_room(room, motion)
    return 0.0 if found is None else float((np.abs(found.sampled(4.0).dq).max(axis=0) / room.arm.dq_max).sum())
