"""The planner's room: exact distances where capsules come too near, and postures that the torque limits hold."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from calib.excitation.design import SLOWER, binding, coarse, own_scale
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.home import open_cell
from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.reaches import sweep_range
from calib.excitation.room import MARGIN, Room
from calib.excitation.session import QUICK, cleared_friction
from sim.arm import Arm, load_arm
from sim.errors import AnswerIsNo, SafetyStop
from sim.trajectory import Trajectory
from sim.tree import Shape
from tests.calib.drives import silent

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def plated() -> Arm:
    """A UR10e with a thin plate on its forearm and one on its last link, which capsules represent badly."""
    arm = load_arm("ur10e")
    plates = [
        Shape(link, f"plate_{link}", "box", (0.2 if link == 2 else 0.06, 0.06, 0.004), np.eye(3), np.array(place))
        for link, place in ((2, [-0.4, 0.0, 0.1]), (5, [0.0, 0.0, 0.06]))
    ]
    return replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, *plates)))


@pytest.fixture(scope="module")
def room() -> Room:
    arm = plated()
    return Room(arm, open_cell(arm))


def test_bodies_are_measured_where_their_capsules_are_too_near(room: Room) -> None:
    q = HOME + np.random.default_rng(1).uniform(-1, 1, (60, 6))
    found, names = room.nearness.clearances(q)
    capsules = room.nearness.by_capsules(room.capsules.segments(q))
    exact = np.array([room.clearance.distances(x) for x in q]) - room.clearance.needed(room.cell.table.motion.following_error)
    column = {pair: k for k, pair in enumerate(room.clearance.pairs)}
    seen = 0
    for k, pair in enumerate(names[-capsules.shape[1] :]):
        if not any(name.startswith("plate") for name in pair):
            continue
        near = capsules[:, k] < CLEARANCE_MARGIN
        own = found[:, len(names) - capsules.shape[1] + k]
        assert own[near] == pytest.approx(exact[near, column[pair]], abs=1e-9)
        assert own[~near] == pytest.approx(capsules[~near, k], abs=1e-12)
        seen += int((near & (own >= CLEARANCE_MARGIN)).sum())
    assert seen > 20  # free postures that the capsules would have rejected


def test_the_nearest_agrees_with_all_clearances_whether_a_way_is_free(room: Room) -> None:
    rng, answers = np.random.default_rng(2), set()
    for scale in np.repeat((0.1, 0.3, 0.9), 20):
        start = HOME + scale * rng.uniform(-1, 1, 6)
        q = start + np.linspace(0, 0.4, 50)[:, None] * rng.uniform(-1, 1, 6)
        least = float(room.nearness.clearances(q)[0].min())
        nearest, _ = room.nearness.nearest(q, room.capsules.segments(q))
        assert (nearest >= CLEARANCE_MARGIN) == (least >= CLEARANCE_MARGIN)
        if least >= CLEARANCE_MARGIN:
            assert nearest <= least + 1e-12
        answers.add(least >= CLEARANCE_MARGIN)
    assert answers == {True, False}


def test_no_clearance_of_cylinders_is_larger_than_that_of_the_bodies() -> None:
    """A capsule of a cylinder's length leaves out its rim. A published arm's start once had 1.4 mm less room than it seemed."""
    arm = load_arm("ur10e")
    along = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    cylinders = [
        Shape(2, "long", "cylinder", (0.06, 0.2, 0.0), along, np.array([-0.4, 0.0, 0.1])),
        Shape(5, "flat", "cylinder", (0.09, 0.02, 0.0), np.eye(3), np.array([0.0, 0.0, 0.06])),
    ]
    arm = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, *cylinders)))
    room = Room(arm, open_cell(arm))
    q = HOME + np.random.default_rng(1).uniform(-1, 1, (200, 6))
    found, names = room.nearness.clearances(q)
    exact = np.array([room.clearance.distances(x) for x in q]) - room.clearance.needed(room.cell.table.motion.following_error)
    seen = 0
    for k, pair in enumerate(room.clearance.pairs):
        if set(pair) & {"long", "flat"} and room.clearance.of_self[k]:
            own = found[:, [name == pair for name in names]].min(axis=1)
            assert (own <= exact[:, k] + 2e-6).all()
            seen += int((own < CLEARANCE_MARGIN).sum())
    assert seen > 20


def test_where_a_motion_comes_too_near_the_torque_that_keeps_it_there_is_named() -> None:
    arm = replace(load_arm("ur10e"), tau_max=np.array([330.0, 180.0, 250.0, 56.0, 56.0, 56.0]))
    home, basis = np.array([0.0, -1.9, 1.9, -1.4, -1.2, 0.3]), Basis(6, 20.0)
    known, unknown = (binding(Room(of, open_cell(of)), basis, home) for of in (arm, silent(arm)))
    assert "nearer to each other" in known
    assert "No values are stated for" not in known
    assert re.search(r"shoulder_lift_joint takes \d+% of its torque limit there.*No values are stated for", unknown)


def test_where_torque_holds_the_arm_in_few_postures_it_is_named_beside_what_is_near(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = load_arm("ur10e")
    monkeypatch.setattr("calib.excitation.design.STRAINED", 2.0)
    home, basis = np.array([0.0, -1.9, 1.9, -1.4, -1.2, 0.3]), Basis(6, 20.0)
    room, known = Room(silent(arm), open_cell(arm)), Room(arm, open_cell(arm))
    assert "No values are stated for" not in binding(room, basis, home)
    for of in (room, known):
        monkeypatch.setattr(of, "holding", lambda q: np.where(np.arange(6) == 2, 1.0 + 0.1 * (q[:, :1] > -1.0), 0.3))
    assert re.search(
        r"In [6-9]\d% of random postures .* most often that of elbow_joint.*No values are stated for.*--drive",
        binding(room, basis, home),
    )
    assert "random postures" not in binding(known, basis, home)


@pytest.mark.parametrize(("name", "helps"), [("torque", False), ("point speed", True)])
def test_a_longer_period_is_advised_only_where_the_path_then_fits(name: str, helps: bool) -> None:
    """A stop takes torque at any speed. The speed of a point falls with a longer period."""
    arm = load_arm("ur10e")
    home, basis, cell = np.array([0.0, -1.9, 1.9, -1.4, -1.2, 0.3]), Basis(6, 20.0), open_cell(arm)
    if name == "torque":
        arm = silent(replace(arm, tau_max=arm.tau_max * np.array([1.0, 0.37, 1.0, 1.0, 1.0, 1.0])))
    else:
        slow = cell.table.motion.model_copy(update={"point_speed_max": 0.15})
        cell = replace(cell, table=cell.table.model_copy(update={"motion": slow}))
    room = Room(arm, cell)
    sentence = binding(room, basis, home)
    assert "a fifth of the full amplitude takes" in sentence
    assert ("shoulder_lift_joint's torque limit" if name == "torque" else "the point speed limit") in sentence
    advised = re.search(r"--period \(about (\S+) s", sentence)
    assert (advised is not None) is helps
    trial = random_fourier(basis, home, np.random.default_rng(0))
    trial = trial.scaled(0.2 * own_scale(room, trial))
    for times in SLOWER:
        slower = Fourier(Basis(6, 20.0 * times), home, trial.x / times)
        fits = float(room.use(coarse(slower)).shares[name].max()) <= MARGIN[name]
        assert fits is (advised is not None and 20.0 * times >= float(advised[1]))


def test_sweeps_are_gentler_where_they_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = load_arm("ur10e")
    room, asked = Room(arm, open_cell(arm)), []

    def refused_twice(motion: Trajectory) -> None:
        asked.append(motion)
        if len(asked) < 3:
            raise SafetyStop("too much torque")

    monkeypatch.setattr(room, "clear", refused_twice)
    found = cleared_friction(room, HOME, QUICK, 100.0)
    assert found is asked[2]
    first, _, third = ((np.abs(m.dq).max(), np.abs(m.ddq).max(), np.abs(m.q - HOME).max()) for m in asked)
    assert all(b < 0.75 * a for a, b in zip(first, third, strict=True))


def test_a_joint_of_small_range_is_swept_through_less(monkeypatch: pytest.MonkeyPatch) -> None:
    """A linear axis of 0.35 m may not have 0.12 m to either side."""
    arm = load_arm("ur10e")
    q_min, q_max = arm.q_min.copy(), arm.q_max.copy()
    q_min[5], q_max[5] = HOME[5] - 0.1, HOME[5] + 0.25
    narrow = replace(arm, q_min=q_min, q_max=q_max)
    room = Room(narrow, open_cell(narrow))
    monkeypatch.setattr(room.nearness, "clearances", lambda q: (np.where(np.abs(q[:, 5:] - HOME[5]) > 0.05, -1.0, 1.0), []))
    low, high, _ = sweep_range(room, HOME, 5, np.array([0.1]))
    assert 0.02 < HOME[5] - low <= 0.05
    assert 0.02 < high - HOME[5] <= 0.05
    monkeypatch.setattr(room.nearness, "clearances", lambda q: (np.full((len(q), 1), -1.0), []))
    with pytest.raises(AnswerIsNo, match=r"less than 0.021 rad to either side; a body near it restricts it"):
        sweep_range(room, HOME, 5, np.array([0.1]))


def test_a_speed_from_which_no_stop_fits_its_range_is_swept_slower() -> None:
    """A model file may state a dq_max that no motor of the arm reaches."""
    arm = load_arm("ur10e")
    room = Room(arm, open_cell(arm))
    *_, usual = sweep_range(room, HOME, 5, np.array([0.06, 0.2]))
    np.testing.assert_array_equal(usual, [0.06, 0.2])
    low, high, fast = sweep_range(room, HOME, 5, np.array([6.0, 20.0]))
    assert 0.05 < fast[1] < 0.35 * 20.0
    assert fast[0] == pytest.approx(0.3 * fast[1])
    assert high - low > 0.2
