"""Start postures: clear of obstacles, held within the torque limits, and with room to sweep every joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib.excitation import home
from calib.excitation.climb import FAR, Slack, climbed
from calib.excitation.fourier import Fourier
from calib.excitation.home import free_postures, home_of, open_cell
from calib.excitation.nearness import CLEARANCE_MARGIN
from calib.excitation.reaches import sweep_range
from calib.excitation.room import Room
from sim.arm import load_arm
from sim.errors import AnswerIsNo
from sim.rigid_body import RigidBody
from sim.stated_facts import with_springs
from sim.trajectory import Trajectory
from sim.tree import Shape
from tests.calib.drives import silent

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


@pytest.mark.slow
def test_a_home_that_the_torque_limits_cannot_hold_is_not_taken() -> None:
    arm = load_arm("ur10e")
    weak = replace(arm, tau_max=np.array([330.0, 150.0, 150.0, 56.0, 56.0, 56.0]))
    room = Room(weak, open_cell(weak))
    home = home_of(room, room.cell, None, np.random.default_rng(0))
    assert (room.holding(home[None]) <= 1).all()
    outstretched = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]])
    assert (room.holding(outstretched) <= 1).all(axis=1).tolist() == [False, True]
    weaker = replace(arm, tau_max=np.full(6, 1e-3))
    with pytest.raises(AnswerIsNo, match=r"postures that are clear of itself and the cell do its torque limits hold it"):
        home_of(Room(weaker, room.cell), room.cell, None, np.random.default_rng(0))


def test_where_the_arm_can_be_held_only_where_it_is_not_clear_the_torque_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    room = Room(load_arm("ur10e"), open_cell(load_arm("ur10e")))

    def holding(q: np.ndarray) -> np.ndarray:
        clear = room.nearness.clearances(q)[0].min(axis=1) >= CLEARANCE_MARGIN
        share = np.full(q.shape, 0.2)
        share[:, 1] = np.where(clear, 1.7, 0.5)
        return share

    monkeypatch.setattr(room, "holding", holding)
    with pytest.raises(
        AnswerIsNo, match=r"in none of \d+ postures that are clear .* shoulder_lift_joint may take 170% of its limit"
    ):
        home_of(room, room.cell, None, np.random.default_rng(0))


def test_where_what_nobody_stated_takes_the_torque_the_sentence_names_it() -> None:
    arm = replace(load_arm("ur10e"), tau_max=np.array([330.0, 330.0, 150.0, 56.0, 56.0, 0.2]))
    room = Room(silent(arm), open_cell(arm))
    with pytest.raises(
        AnswerIsNo, match=r"wrist_3_joint may take \d+% .*No values are stated for dry friction .* of wrist_3_joint.*--drive"
    ):
        home_of(room, room.cell, None, np.random.default_rng(0))


@pytest.mark.slow
def test_a_home_lets_every_joint_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best posture that allows it; if none does, the best one with a motion."""
    arm = load_arm("ur10e")
    room = Room(arm, open_cell(arm))
    asked: list[np.ndarray] = []

    def sweepable(of: Room, posture: np.ndarray) -> bool:
        asked.append(posture)
        return len(asked) == 3

    monkeypatch.setattr("calib.excitation.home.sweepable", sweepable)
    third = home_of(room, room.cell, None, np.random.default_rng(0))
    assert len(asked) == 3
    assert np.array_equal(third, np.round(asked[2], 3))
    monkeypatch.setattr("calib.excitation.home.sweepable", lambda of, posture: False)
    assert np.array_equal(home_of(room, room.cell, None, np.random.default_rng(0)), np.round(asked[0], 3))


def test_where_room_and_torque_leave_little_choice_a_home_has_some_of_both(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few postures can be held, and the roomiest of them takes nearly all of a torque limit."""
    arm = load_arm("ur10e")
    room = Room(arm, open_cell(arm))
    free = room.nearness.clearances
    shares: list[float] = []

    def holding(q: np.ndarray) -> np.ndarray:
        apart = free(q)[0].min(axis=1)
        few = q[:, 0] > 0.9 * q[:, 0].max()
        share = np.where(few & (apart > 0), np.where(apart > np.quantile(apart[few], 0.8), 0.99, 0.4), 1.5)
        return np.repeat(share[:, None], 6, axis=1)

    def amplitude(of: Room, motion: Fourier) -> float:
        shares.append(float(free(motion.home[None])[0].min()))
        return 1.0

    monkeypatch.setattr(room, "holding", holding)
    monkeypatch.setattr("calib.excitation.home._amplitude", amplitude)
    monkeypatch.setattr("calib.excitation.home.sweepable", lambda of, posture: True)
    home_of(room, room.cell, None, np.random.default_rng(0))
    roomiest = max(shares)
    assert shares[0] < roomiest


def test_the_assumed_plane_is_below_what_turns_upright_on_the_base() -> None:
    arm = load_arm("ur10e")
    low = Shape(0, "low", "sphere", (0.05, 0.0, 0.0), np.eye(3), -arm.tree.position[0] + [0.0, 0.0, -0.06])
    lowered = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, low)))
    assert open_cell(arm).table.obstacles[0].position[2] == -0.097  # that of its base
    room = Room(lowered, open_cell(lowered))
    assert ("low", "mounting_plane") in room.clearance.always_apart


def test_where_the_assumed_plane_leaves_no_posture_the_sentence_asks_for_the_cell() -> None:
    arm = load_arm("ur10e")
    ball = Shape(1, "ball", "sphere", (0.5, 0.0, 0.0), np.eye(3), np.zeros(3))
    hanging = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, ball)))
    room = Room(hanging, open_cell(hanging))
    with pytest.raises(AnswerIsNo, match=r"ball and mounting_plane .*state with --cell where the arm stands"):
        home_of(room, room.cell, None, np.random.default_rng(0))


def test_a_home_is_free_by_the_bodies_themselves_not_only_by_capsules() -> None:
    """A capsule leaves out the rim of a cylinder, which may be too near to a plane."""
    arm = load_arm("ur10e")
    drum = Shape(5, "drum", "cylinder", (0.12, 0.12, 0.0), np.eye(3), np.zeros(3))
    arm = replace(arm, tree=replace(arm.tree, shapes=(*arm.tree.shapes, drum)))
    room = Room(arm, open_cell(arm))
    q = HOME + np.random.default_rng(5).uniform(-2.5, 2.5, (100, 6))
    needed = room.clearance.needed(room.cell.table.motion.following_error) + CLEARANCE_MARGIN
    by_bodies = np.array([bool(np.all(room.clearance.distances(x) >= needed)) for x in q])
    near, free = q[~by_bodies][:20], q[by_bodies][:5]
    assert len(near) == 20
    np.testing.assert_array_equal(free_postures(room, np.concatenate([near, free])), free)
    np.testing.assert_array_equal(free_postures(room, near), near[:15])


def test_where_few_postures_can_be_held_those_with_slack_on_every_side_are_climbed_to() -> None:
    arm = load_arm("ur10e")
    weak = replace(arm, tau_max=np.array([330.0, 150.0, 150.0, 56.0, 56.0, 56.0]))
    room, rng = Room(weak, open_cell(arm)), np.random.default_rng(0)
    middle, half = (arm.q_max + arm.q_min) / 2, np.minimum((arm.q_max - arm.q_min) / 2, np.pi)
    q = middle + 0.6 * half * rng.uniform(-1, 1, (200, arm.n))
    clearances, holding = room.nearness.clearances(q)[0], room.holding(q)
    slack = Slack(clearances, holding)
    values = slack.of(clearances, holding)
    found = climbed(room, slack, q, values, middle, half, rng)
    assert found is not None
    after = slack.of(room.nearness.clearances(found)[0], room.holding(found))
    assert np.all(after > 0)
    assert after[0] == after.max()
    assert after[0] > 1.05 * values.max()
    assert np.all(np.abs(found - middle) <= FAR * half + 1e-12)
    helpless = Room(replace(arm, tau_max=np.full(6, 1e-3)), room.cell)
    holding = helpless.holding(q)
    slack = Slack(clearances, holding)
    assert climbed(helpless, slack, q, slack.of(clearances, holding), middle, half, rng) is None


def test_a_posture_from_which_no_stop_is_possible_is_told_from_one_that_is_only_held() -> None:
    """As in `Room.use`: the stop of even a very slow motion needs a share of the deceleration."""
    arm = load_arm("ur10e")
    room = Room(arm, open_cell(arm))
    held = room.holding(HOME[None]).max()
    taken = room.stopping(HOME[None])[0]
    assert held < taken.max() < 1
    # torque limits just above what it takes to hold the posture
    weak = replace(arm, tau_max=1.05 * room.holding(HOME[None])[0] * arm.tau_max)
    room = Room(weak, room.cell)
    assert room.holding(HOME[None]).max() < 1 < room.stopping(HOME[None]).max()
    t, still = np.array([0.0, 1.0]), np.zeros((2, 6))
    worst = [
        room.use(Trajectory(t, HOME + 1e-3 * sign * t[:, None], still + 1e-3 * sign, still)).worst
        for sign in np.random.default_rng(0).choice((-1.0, 1.0), (8, 6))
    ]
    assert max(worst, key=lambda use: use[1]) == ("torque", pytest.approx(room.stopping(HOME[None]).max(), rel=0.05))


@pytest.mark.slow
def test_where_a_stop_is_hardly_possible_at_the_roomiest_the_home_is_one_where_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = load_arm("ur10e")
    room = Room(arm, open_cell(arm))
    monkeypatch.setattr("calib.excitation.home.sweepable", lambda of, posture: True)
    plain = home_of(room, room.cell, None, np.random.default_rng(0))
    asked = 0

    def stopping(q: np.ndarray) -> np.ndarray:
        nonlocal asked
        asked += len(q)
        return np.repeat(np.where(np.abs(q[:, :1] - plain[0]) < 1.0, 1.05, 0.6), 6, axis=1)

    monkeypatch.setattr(room, "stopping", stopping)
    assert abs(home_of(room, room.cell, None, np.random.default_rng(0))[0] - plain[0]) >= 1.0
    asked, amplitude = 0, home._amplitude
    # only the postures that are searched for their stop allow a motion
    monkeypatch.setattr("calib.excitation.home._amplitude", lambda of, motion: amplitude(of, motion) if asked > 1000 else 0.0)
    found = home_of(room, room.cell, None, np.random.default_rng(0))
    assert asked > 1000
    assert (room.stopping(found[None]) < 0.7).all()


@pytest.mark.slow
def test_a_stop_by_drives_of_which_nobody_stated_anything_moves_no_home(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plan requires the missing values. Torque that is only assumed says little about a posture."""
    arm = silent(load_arm("ur10e"))
    room = Room(arm, open_cell(arm))
    plain = home_of(room, room.cell, None, np.random.default_rng(0))
    monkeypatch.setattr(room, "stopping", lambda q: np.full(q.shape, 1.5))
    assert np.array_equal(home_of(room, room.cell, None, np.random.default_rng(0)), plain)


def test_slack_counts_a_pair_that_is_always_near_by_how_much_it_changes() -> None:
    """Two neighbours are 5 mm apart in every posture. A posture far from moving bodies still has more slack."""
    neighbours = 0.005 + 1e-4 * np.array([0.0, 1.0, -1.0, 0.0])
    clearances = np.column_stack([np.full(4, np.inf), neighbours, [0.3, 0.1, 0.01, 0.2]])
    slack = Slack(clearances, np.full((4, 2), 0.5)).of(clearances, np.full((4, 2), 0.5))
    assert np.argsort(slack).tolist() == [2, 1, 3, 0]


def test_masses_that_no_motor_holds_ask_for_a_spring_which_takes_of_their_torque() -> None:
    """A shoulder lift that needs more torque than its motor gives in most postures, unless a counterbalance spring helps."""
    of = load_arm("ur10e")
    arm = replace(of, q_max=np.where(np.arange(6) == 1, -0.3, of.q_max), q_min=np.where(np.arange(6) == 1, -1.0, of.q_min))
    arm = replace(arm, tau_max=np.array([330.0, 60.0, 150.0, 56.0, 56.0, 56.0]))
    cell = open_cell(arm)
    with pytest.raises(
        AnswerIsNo, match=r"require \S+ N m of shoulder_lift_joint in the median posture: .*`calib arm new --spring`"
    ):
        home_of(Room(arm, cell), cell, None, np.random.default_rng(0))
    q = arm.q_min + (arm.q_max - arm.q_min) * np.random.default_rng(1).uniform(0.2, 0.8, (200, arm.n))
    gravity = np.median(RigidBody(arm).inverse_dynamics(q, np.zeros_like(q), np.zeros_like(q))[:, 1])
    # torque of the spring, k (q - q_0), opposite in the middle of the range
    held = with_springs(arm, {"shoulder_lift_joint": [20.0, -0.65 + gravity / 20.0]})
    assert np.median(Room(held, cell).holding(q)[:, 1]) < 0.8 * np.median(Room(arm, cell).holding(q)[:, 1])


def test_a_sweep_that_torque_refuses_names_what_nobody_stated_of_the_drives() -> None:
    room = Room(arm := load_arm("ur10e"), open_cell(arm))
    weak = replace(arm, tau_max=1.05 * room.holding(HOME[None])[0] * arm.tau_max)
    with pytest.raises(AnswerIsNo, match=r"to either side; the torque limit restricts it: give another start with --home$"):
        sweep_range(Room(weak, room.cell), HOME, 1, np.array([0.5]))
    with pytest.raises(AnswerIsNo, match=r"No values are stated for .*reflected inertia of .*state them"):
        sweep_range(Room(silent(weak), room.cell), HOME, 1, np.array([0.5]))
