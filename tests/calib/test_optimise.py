"""The optimiser: its gradient is the slope of its value, its motions fit the limits, and none is worse than its start."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.excitation.beside import Beside, slowed, stopping
from calib.excitation.capsules import capsules, from_box
from calib.excitation.cleared_motions import cleared_fourier
from calib.excitation.design import Information, Worth, coarse, fitted_to_room, noise_of, random_start
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.gap import Mixture
from calib.excitation.home import open_cell
from calib.excitation.objective import Objective
from calib.excitation.optimise import CONDITION_CAP, Site, lowest, optimised, preference
from calib.excitation.room import Room
from calib.identification.known import Known
from calib.identification.model import TorqueModel
from drivers.driver import DeviceStop
from sim.arm import Arm, load_arm
from sim.arm_folder import write_arm
from sim.cell import Cell, CellTable

ARM = load_arm("ur10e")
CELL = open_cell(ARM)
MODEL = TorqueModel.of_arm(ARM)
HOME = np.array([0.173, -1.69, 0.605, -1.521, -1.485, -0.367])


def boxed(arm: Arm) -> Cell:
    """A cell with a rotated box that motions about HOME run into."""
    cell = open_cell(arm)
    box = {"kind": "box", "name": "crate", "position": [0.5, 0.3, 0.3], "rpy": [0.2, 0.1, 0.6], "size": [0.4, 0.5, 0.6]}
    table = cell.table.model_dump(by_alias=True) | {"obstacles": [*cell.table.model_dump()["obstacles"], box]}
    return Cell(CellTable.model_validate(table), cell.path, cell.sha256)


def test_boxes_take_part_in_the_gradient() -> None:
    motion = random_fourier(Basis(5, 10.0), HOME, np.random.default_rng(0))
    free, full = (Objective(Room(ARM, cell), MODEL, noise_of(ARM), motion, samples=40) for cell in (CELL, boxed(ARM)))
    assert full(motion.x)[0] > free(motion.x)[0]
    _, gradient = full(motion.x)
    for seed in range(3):
        along = np.random.default_rng(seed).standard_normal(motion.x.shape)
        rise = (full(motion.x + 1e-6 * along)[0] - full(motion.x - 1e-6 * along)[0]) / 2e-6
        assert rise == pytest.approx(np.sum(gradient * along), rel=1e-5)


def test_the_distance_of_a_box_is_signed() -> None:
    ends = np.array(
        [[[[0.0, 0.0, 0.4], [0.0, 0.0, 0.4]], [[0.0, 0.0, 0.05], [0.0, 0.0, 0.05]], [[-0.5, 0.0, 0.3], [0.5, 0.0, 0.3]]]]
    )
    distance, share, slope = from_box(ends, np.eye(3), np.zeros(3), np.array([0.1, 0.1, 0.1]))
    assert distance[0] == pytest.approx([0.3, -0.05, 0.2 - 0.125])
    assert share[0, 2] == pytest.approx(0.5)
    assert slope[0] == pytest.approx(np.array([[0.0, 0.0, 1.0]] * 3))


@pytest.mark.parametrize("name", ["ur10e", "servo6"])
def test_the_gradient_is_the_slope_of_the_value(name: str) -> None:
    arm = load_arm(name)
    model = TorqueModel.of_arm(arm)
    # large enough to exceed every limit, the clearance and the cap on the condition number, so that all of them contribute
    motion = random_fourier(Basis(5, 10.0), HOME, np.random.default_rng(0)).scaled(1.2)
    objective = Objective(Room(arm, open_cell(arm)), model, noise_of(arm), motion, samples=40, fine=True)
    _, gradient = objective(motion.x)
    for seed in range(3):
        along = np.random.default_rng(seed).standard_normal(motion.x.shape)
        rise = (objective(motion.x + 1e-6 * along)[0] - objective(motion.x - 1e-6 * along)[0]) / 2e-6
        assert rise == pytest.approx(np.sum(gradient * along), rel=1e-5)


def test_a_short_descent_already_determines_more() -> None:
    room, information = Room(ARM, CELL), Information(MODEL, noise_of(ARM))
    start, before = random_start(room, information, Basis(4, 10.0), HOME, np.random.default_rng(1), 1)
    objective = Objective(room, MODEL, noise_of(ARM), start, samples=60)
    x, value, gain, _ = lowest(objective, start.x, 60)
    assert value < objective(start.x)[0] - 10
    assert 0 <= gain < objective(start.x)[0] - value
    ended = fitted_to_room(room, Fourier(start.basis, HOME, x), grow=False)
    assert ended is not None
    assert information.worth(coarse(ended)).log_det > before.log_det + 10


def test_what_keeps_the_cap_is_preferred() -> None:
    well, better, wild = (Worth(d, c, 10.0) for d, c in ((300.0, 30.0), (310.0, 39.0), (400.0, CONDITION_CAP + 1)))
    assert sorted([wild, well, better], key=preference) == [wild, well, better]


@pytest.mark.parametrize("t", [0.05, 0.2, np.inf])
@pytest.mark.parametrize("proportional", [False, True])
def test_where_a_stop_is_has_the_slopes_of_its_way(proportional: bool, t: float) -> None:
    stop = DeviceStop(0.1, 4.0, proportional)
    q, dq = np.random.default_rng(0).standard_normal((2, 5, 6))
    there, by_speed = stopping(q, dq, stop, t)
    j = int(np.argmax(np.abs(dq[0])))
    if np.isinf(t):
        assert there[0, j] - q[0, j] == pytest.approx(dq[0, j] * 0.1 + dq[0, j] * abs(dq[0, j]) / 8)
    for k in range(6):
        moved = 1e-6 * np.eye(6)[k]
        slope = (stopping(q, dq + moved, stop, t)[0] - stopping(q, dq - moved, stop, t)[0]) / 2e-6
        assert by_speed[:, :, k] == pytest.approx(slope, abs=1e-8)


@pytest.mark.parametrize("proportional", [False, True])
def test_what_a_stop_leaves_of_a_speed_is_the_slope_of_its_way(proportional: bool) -> None:
    stop = DeviceStop(0.1, 4.0, proportional)
    q, dq = np.random.default_rng(0).standard_normal((2, 5, 6))
    for t in (0.05, 0.2, 0.3):
        left, by_speed = slowed(dq, stop, t)
        way = (stopping(q, dq, stop, t + 1e-6)[0] - stopping(q, dq, stop, t - 1e-6)[0]) / 2e-6
        assert left == pytest.approx(way, abs=1e-5)
        for k in range(6):
            moved = 1e-6 * np.eye(6)[k]
            slope = (slowed(dq + moved, stop, t)[0] - slowed(dq - moved, stop, t)[0]) / 2e-6
            assert by_speed[:, :, k] == pytest.approx(slope, abs=1e-8)


def test_shapes_whose_capsules_never_part_push_too() -> None:
    room = Room(ARM, CELL)
    names = [shape.name for shape in room.arm.tree.shapes for _ in capsules(shape)]
    room.nearness.pairs = [(a, b) for a, b in room.nearness.pairs if "wrist_1_0" not in (names[a], names[b])]
    folded = HOME.copy()
    folded[2] = 2.85  # wrist 1 comes near the upper arm
    q = folded + 0.01 * np.random.default_rng(0).standard_normal((4, 6))
    beside = Beside(room)
    value, slope = beside.exact(q, room.capsules.segments(q))
    assert value > 0
    for k in range(4):
        along = np.zeros_like(q)
        along[k, 2] = 1e-4
        rise = (
            beside.exact(q + along, room.capsules.segments(q + along))[0]
            - beside.exact(q - along, room.capsules.segments(q - along))[0]
        )
        assert slope[k, 2] == pytest.approx(rise / 2e-4, rel=0.05, abs=1e-6)
    assert beside.exact(HOME[None], room.capsules.segments(HOME[None]))[0] == 0


def test_the_gap_of_a_mixture_bounds_every_member_and_closes_at_the_optimum() -> None:
    rows = [np.array([1.0, x, x**2]) for x in (-0.5, 0.0, 0.4)]
    mixture = Mixture([np.outer(r, r) for r in rows], np.zeros((3, 3)))
    before = np.linalg.slogdet(
        np.outer(rows[0], rows[0]) / 3 + np.outer(rows[1], rows[1]) / 3 + np.outer(rows[2], rows[2]) / 3
    )[1]
    for _ in range(4):  # the directions that add most, over the whole interval
        x = max(np.linspace(-1, 1, 41), key=lambda x: float((r := np.array([1.0, x, x**2])) @ mixture.slope @ r))
        mixture.add([np.outer(r := np.array([1.0, x, x**2]), r)])
    best = np.log(4 / 27)  # thirds at -1, 0 and 1
    assert before < best - 1
    assert best - 1e-6 <= mixture.bound() <= best + 0.02


def test_the_next_motion_determines_what_the_first_left_open(tmp_path: Path) -> None:
    write_arm(tmp_path / "arm", ARM)
    known = np.full(MODEL.p, 1e-8)
    unknown = [k for k, name in enumerate(MODEL.names) if name.split(" ")[0].endswith("_6")]
    known[unknown] = 1e4
    Known(np.diag(known), np.ones(6), "a first recording").write(tmp_path / "arm", MODEL)
    again = load_arm(str(tmp_path / "arm"))
    # small motions exceed no limit, so the value is that of the information alone
    motions = [random_fourier(Basis(4, 10.0), HOME, np.random.default_rng(seed)).scaled(0.1) for seed in range(6)]
    first, second = (
        Objective(Room(a, CELL), TorqueModel.of_arm(a), noise_of(ARM), motions[0], 40, capped=False) for a in (ARM, again)
    )
    open_ones = [*unknown, *range(MODEL.p, second.p)]  # no recording has determined the candidates

    def left(x: np.ndarray) -> float:
        whole = np.linalg.inv(second.information(x) + second.prior)
        return float(np.linalg.slogdet(whole[np.ix_(open_ones, open_ones)])[1])

    found = np.array([(left(m.x), second(m.x)[0], first(m.x)[0]) for m in motions])
    rise = np.diff(found, axis=0)
    assert np.ptp(found[:, 0]) > 3
    assert rise[:, 1] == pytest.approx(rise[:, 0], abs=1e-3)
    assert np.abs(rise[:, 2] - rise[:, 0]).min() > 1


@pytest.mark.slow
def test_eight_starts_reach_the_cap_and_are_cleared_as_they_are() -> None:
    room, information = Room(ARM, CELL), Information(MODEL, noise_of(ARM))
    best, before = random_start(room, information, Basis(6, 20.0), HOME, np.random.default_rng(0), 20)
    shares: list[float] = []
    found = optimised(Site(ARM, CELL), best, 8, 0, lambda stage, share: shares.append(share))
    assert len(found.ends) == 8
    assert shares[-1] == 1.0
    first = found.ends[0]
    assert preference(first.worth) >= preference(before)
    assert first.worth.condition <= 35
    assert 0 < found.gap < 60
    _, kept = cleared_fourier(first.motion, Room(ARM, CELL), 500.0)
    assert np.linalg.norm(kept.x) >= 0.95 * np.linalg.norm(first.motion.x)
