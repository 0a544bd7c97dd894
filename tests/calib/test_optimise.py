"""The optimiser: its gradient is the slope of its value, its motions fit, and none is worse than where it began."""

from __future__ import annotations

import numpy as np
import pytest

from calib.excitation.capsules import from_box
from calib.excitation.design import Information, Worth, coarse, fitted_to_room, noise_of, random_start
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.objective import Objective
from calib.excitation.optimise import CONDITION_CAP, adam, optimised, preference
from calib.excitation.room import Room
from calib.excitation.session import cleared_fourier, open_cell
from calib.identification.model import TorqueModel
from sim.arm import Arm, load_arm
from sim.cell import Cell, CellTable

ARM = load_arm("ur10e")
CELL = open_cell(ARM)
MODEL = TorqueModel.of_arm(ARM)
HOME = np.array([0.173, -1.69, 0.605, -1.521, -1.485, -0.367])


def boxed(arm: Arm) -> Cell:
    """A cell with a turned box that motions about HOME run into."""
    cell = open_cell(arm)
    box = {"kind": "box", "name": "crate", "position": [0.5, 0.3, 0.3], "rpy": [0.2, 0.1, 0.6], "size": [0.4, 0.5, 0.6]}
    table = cell.table.model_dump(by_alias=True) | {"obstacles": [*cell.table.model_dump()["obstacles"], box]}
    return Cell(CellTable.model_validate(table), cell.path, cell.sha256)


def test_boxes_take_part_in_the_gradient() -> None:
    motion = random_fourier(Basis(5, 10.0), HOME, np.random.default_rng(0))
    free, full = (Objective(Room(ARM, cell), MODEL, noise_of(MODEL), motion, samples=40) for cell in (CELL, boxed(ARM)))
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
    # large enough that every limit, the clearance and the condition number are passed and take part
    motion = random_fourier(Basis(5, 10.0), HOME, np.random.default_rng(0)).scaled(1.2)
    objective = Objective(Room(arm, open_cell(arm)), model, noise_of(model), motion, samples=40)
    _, gradient = objective(motion.x)
    for seed in range(3):
        along = np.random.default_rng(seed).standard_normal(motion.x.shape)
        rise = (objective(motion.x + 1e-6 * along)[0] - objective(motion.x - 1e-6 * along)[0]) / 2e-6
        assert rise == pytest.approx(np.sum(gradient * along), rel=1e-5)


def test_a_short_descent_already_determines_more() -> None:
    room, information = Room(ARM, CELL), Information(MODEL, noise_of(MODEL))
    start, before = random_start(room, information, Basis(4, 10.0), HOME, np.random.default_rng(1), 1)
    objective = Objective(room, MODEL, noise_of(MODEL), start, samples=60)
    ended = fitted_to_room(room, Fourier(start.basis, HOME, adam(objective, start.x, iterations=60)), grow=False)
    assert ended is not None
    assert information.worth(coarse(ended)).log_det > before.log_det + 10


def test_what_keeps_the_cap_is_preferred() -> None:
    well, better, wild = (Worth(d, c, 10.0, ()) for d, c in ((300.0, 30.0), (310.0, 39.0), (400.0, CONDITION_CAP + 1)))
    assert sorted([wild, well, better], key=preference) == [wild, well, better]


@pytest.mark.slow
def test_eight_starts_reach_the_cap_and_are_never_worse_than_the_best_random_motion() -> None:
    room, information = Room(ARM, CELL), Information(MODEL, noise_of(MODEL))
    best, before = random_start(room, information, Basis(6, 20.0), HOME, np.random.default_rng(0), 20)
    shares: list[float] = []
    found = optimised(ARM, CELL, best, 8, 0, lambda stage, share: shares.append(share))
    assert len(found) == 8
    assert shares[-1] == 1.0
    assert preference(found[0].worth) >= preference(before)
    assert found[0].worth.condition <= CONDITION_CAP
    _, kept = cleared_fourier(found[0].motion, ARM, CELL, 500.0, 1)
    assert information.worth(coarse(kept)).condition <= CONDITION_CAP
