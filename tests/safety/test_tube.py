"""Torque, point speed and range keep their limits everywhere in the tube, checked by other code at random states in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from drivers.driver import DeviceStop
from safety.clear import clear
from safety.device_stops import DeviceStops
from safety.loads import Loads
from safety.parameters import PAYLOAD_DOUBT, SIGMAS, friction_of
from safety.reach import spine
from safety.sheets import OwnStops, PathSheet, Sheet
from safety.tube import Tube
from sim.arm import Arm
from sim.cell import Cell, PayloadTable
from sim.errors import SafetyStop
from sim.rigid_body import RigidBody
from sim.trajectory import Trajectory
from tests.safety.conftest import sine


def heavy(cell: Cell, mass: float) -> Cell:
    load = PayloadTable(mass=mass, com=[0.0, 0.05, 0.0])
    return replace(cell, table=cell.table.model_copy(update={"payload": load}))


def random_arm(arm: Arm, cell: Cell, rng: np.random.Generator) -> tuple[RigidBody, np.ndarray]:
    """A body within the prior's two standard deviations and with the payload a fifth off, whose torque must be covered."""
    tree, prior = arm.tree, arm.prior
    mass, com, inertia = tree.mass.copy(), tree.com.copy(), tree.inertia.copy()
    for j in range(arm.n):
        mass[j] *= 1 + SIGMAS * prior.mass * rng.choice((-1, 1))
        inertia[j] *= 1 + 0.5 * SIGMAS * prior.inertia * rng.choice((-1, 1))
    load = cell.table.payload
    assert load is not None
    more = load.mass * (1 + PAYLOAD_DOUBT * rng.choice((-1, 1)))
    total = mass[-1] + more
    at = np.array(load.com)
    middle = (mass[-1] * com[-1] + more * at) / total
    for m, c in ((mass[-1], com[-1]), (more, at)):
        d = c - middle
        inertia[-1] = inertia[-1] + m * (d @ d * np.eye(3) - np.outer(d, d))
    mass[-1], com[-1] = total, middle
    return RigidBody(replace(tree, mass=mass, com=com, inertia=inertia)), friction_of(arm).inertia


def states_of(
    sheet: Sheet, room: np.ndarray, rng: np.random.Generator, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random states in random boxes, with q moved off by the verified room."""
    rows, stages = sheet.boxes.lo.shape[:2]
    k, m = rng.integers(rows, size=count), rng.integers(stages, size=count)
    lo, hi = sheet.boxes.lo[k, m], sheet.boxes.hi[k, m]
    q, dq, ddq = (lo + (hi - lo) * rng.uniform(0, 1, lo.shape)).transpose(1, 0, 2)
    return q + np.minimum(room[k], 0.1)[:, None] * rng.choice((-1, 1), q.shape), dq, ddq


@pytest.mark.parametrize("kind", ["path", "own", "device"])
def test_no_state_in_the_tube_needs_more_than_there_is(arm: Arm, cell: Cell, kind: str) -> None:
    loaded, rng = heavy(cell, 3.0), np.random.default_rng(1)
    motion = sine(amplitude=0.2, duration=3.0, step=0.002)
    sheets: dict[str, Sheet] = {
        "path": PathSheet(motion, arm), "own": OwnStops(motion, arm, arm.ddq_max),
        "device": DeviceStops(motion, arm, DeviceStop(0.02, 4.0), 0.0),
    }  # fmt: skip
    loads, sheet = Loads(arm, loaded), sheets[kind]
    room = loads.room(sheet, kind, 1e-4, 0.1)
    assert np.all(room >= 1e-4)
    q, dq, ddq = states_of(sheet, room, rng, 3000)
    limit, speed_limit = arm.tau_max, loaded.table.motion.point_speed_max
    for _ in range(4):
        body, rotor = random_arm(arm, loaded, rng)
        tau = body.inverse_dynamics(q, dq, ddq) + rotor * ddq
        assert np.all(np.abs(tau) <= limit)
    for shape in arm.tree.shapes:
        if shape.link < 0:
            continue
        for point in spine(shape)[0]:
            linear, _ = RigidBody(arm).jacobian(q, shape.link, point)
            assert np.all(np.linalg.norm(np.einsum("kij,kj->ki", linear, dq), axis=1) <= speed_limit)


def test_a_limit_just_below_what_a_state_takes_is_refused(arm: Arm, cell: Cell) -> None:
    """Torque and point speed are refused if their limit is below what the motion reaches."""
    motion = sine(amplitude=0.4, duration=3.0, step=0.002)
    sheet = PathSheet(motion, arm)
    body = RigidBody(arm)
    tau = np.abs(body.inverse_dynamics(motion.q, motion.dq, motion.ddq) + friction_of(arm).inertia * motion.ddq).max(axis=0)
    with pytest.raises(SafetyStop, match="torque up to"):
        Loads(replace(arm, tau_max=0.999 * tau), cell).room(sheet, "the motion", 1e-4, 0.1)
    slow = replace(
        cell, table=cell.table.model_copy(update={"motion": cell.table.motion.model_copy(update={"point_speed_max": 0.1})})
    )
    with pytest.raises(SafetyStop, match="a point of it may move faster"):
        Loads(arm, slow).room(sheet, "the motion", 1e-4, 0.1)


def test_a_box_that_proves_too_little_gets_the_room_of_its_parts(arm: Arm, cell: Cell) -> None:
    sheet, loads = PathSheet(sine(amplitude=0.2, duration=3.0, step=0.02), arm), Loads(arm, cell)
    whole = loads.room(sheet, "the motion", 1e-6, np.inf)
    k = int(np.argmin(whole))
    least = 1.001 * float(whole[k])
    room = loads.room(sheet, "the motion", least, np.inf)
    assert np.flatnonzero(room != whole).tolist() == np.flatnonzero(whole < least).tolist()
    assert least <= room[k] < 3 * least


def test_a_heavy_load_makes_the_stop_softer_and_longer_and_it_is_still_proved(arm: Arm, cell: Cell) -> None:
    motion = sine(amplitude=0.12, duration=3.0)
    # the test arm brakes with up to 20 rad/s^2, which its shoulder cannot do with a load at the tip
    strong, weak = arm, replace(arm, tau_max=np.array([330.0, 215.0, 120.0, 36.0, 36.0, 36.0]))
    easy, hard = clear(motion, strong, heavy(cell, 0.1)), clear(motion, weak, heavy(cell, 6.0))
    assert easy.verdict.braking == 1.0
    assert hard.verdict.braking < 1.0
    assert hard.verdict.stop_time > easy.verdict.stop_time
    np.testing.assert_allclose(hard.braking, hard.verdict.braking * arm.ddq_max)
    q, dq, ddq = hard.q[::20], hard.dq[::20], hard.ddq[::20]
    sheet = OwnStops(Trajectory(hard.t[::20], q, dq, ddq), weak, hard.braking)
    body, rotor = random_arm(weak, heavy(cell, 6.0), np.random.default_rng(0))
    for share in np.linspace(0, 1, 30):
        t = (share * sheet.duration)[:, None, None]
        travel, v, a = (x[:, 0] for x in sheet.profile.rows(slice(None)).state(t))
        assert np.all(np.abs(body.inverse_dynamics(q + travel, v, a) + rotor * a) <= weak.tau_max)


def test_a_tube_thinner_than_the_error_to_expect_is_refused(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    room = clear(motion, arm, cell).verdict.room

    def expecting(error: float) -> Cell:
        rules = cell.table.motion.model_copy(update={"following_error": error, "following_error_max": max(error, 0.1)})
        return replace(cell, table=cell.table.model_copy(update={"motion": rules}))

    assert clear(motion, arm, expecting(0.9 * room)).verdict.room >= 0.9 * room
    with pytest.raises(SafetyStop, match=r"following error|may move faster"):
        clear(motion, arm, expecting(0.4))
    upside_down = cell.table.motion.model_copy(update={"following_error": 0.2, "following_error_max": 0.1})
    with pytest.raises(SafetyStop, match="must be above 0 and at most following_error_max"):
        clear(motion, arm, replace(cell, table=cell.table.model_copy(update={"motion": upside_down})))


def test_the_end_of_the_range_is_kept_free_by_the_error_to_expect(arm: Arm, cell: Cell, motion: Trajectory) -> None:
    stop = DeviceStop(reaction=0.0, deceleration=20.0)
    far = clear(motion, arm, cell, stop=stop).verdict
    limit = motion.q.max(axis=0) + far.stop_angle
    assert clear(motion, replace(arm, q_max=limit + 0.02), cell, stop=stop).verdict.room <= 0.02 + far.stop_angle
    tight = np.where(np.arange(arm.n) == 2, motion.q.max(axis=0) + 0.009, arm.q_max)
    with pytest.raises(SafetyStop, match=r"^j3: the motion at t=.* s comes within 0\.00\d+ rad of the end of its range"):
        clear(motion, replace(arm, q_max=tight), cell, stop=stop)


def test_the_monitored_room_reaches_back_over_the_path_that_a_late_arm_may_still_be_on() -> None:
    room = np.full(300, 0.05)
    room[100] = 0.01
    tube = Tube(room, np.ones(6), 1.0, 0.1, 0.1)
    seen = np.flatnonzero(tube.monitored(500.0) == 0.01)
    assert seen[0] == 99
    assert 150 <= seen[-1] <= 153
    assert np.array_equal(seen, np.arange(seen[0], seen[-1] + 1))
