"""Excitation: motions from rest to rest within all limits, the session built from them, and refusals with their reason."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib import main as program
from calib.excitation.design import Information, fitted_to_room, noise_of, random_start, too_small
from calib.excitation.distances import least_distances, pair_distances, too_near
from calib.excitation.fourier import Basis, random_fourier
from calib.excitation.home import home_of, open_cell, posture
from calib.excitation.room import Room
from calib.excitation.session import QUICK, Session, design
from calib.excitation.sweeps import Waypoint, friction_sweeps, overlay, through
from calib.identification.model import TorqueModel
from safety.clear import clear
from safety.collision import Clearance
from safety.limits import check_limits
from safety.plan import load_plan
from sim.arm import load_arm
from sim.errors import AnswerIsNo, ConfigError

ARM = load_arm("ur10e")
CELL = open_cell(ARM)
MODEL = TorqueModel.of_arm(ARM)
HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])


def test_a_fourier_motion_is_smooth_from_rest_to_rest() -> None:
    basis = Basis(5, 8.0)
    motion = random_fourier(basis, HOME, np.random.default_rng(1))
    t = np.array([0.0, 8.0])
    for order in (1, 2):
        assert np.abs(basis.matrix(t, order) @ motion.x.T).max() < 1e-9
    path = motion.sampled(200.0, periods=2)
    assert np.allclose(path.q[[0, -1]], HOME)
    middle = slice(1, -1)
    assert np.abs(np.gradient(path.q, path.t, axis=0) - path.dq)[middle].max() < 2e-3
    assert np.abs(np.gradient(path.dq, path.t, axis=0) - path.ddq)[middle].max() < 2e-2
    assert np.allclose(path.q[: 8 * 200], path.q[8 * 200 : -1], atol=1e-12)


def test_capsules_agree_with_the_geometry_that_decides() -> None:
    room, clearance = Room(ARM, CELL), Clearance(ARM, CELL)
    rng = np.random.default_rng(2)
    for q in HOME + 0.5 * rng.uniform(-1, 1, (20, 6)):
        found, names = room.nearness.clearances(q[None])
        exact = {frozenset(p): d - m for p, d, m in zip(clearance.pairs, clearance.distances(q), clearance.margin, strict=True)}
        nearest: dict[frozenset[str], float] = {}
        for distance, pair in zip(found[0], names, strict=True):
            nearest[frozenset(pair)] = min(distance, nearest.get(frozenset(pair), np.inf))
        shared = [(d, exact[p]) for p, d in nearest.items() if p in exact]
        assert len(shared) > 15
        # a plan keeps up to 18 mm beyond its margin, and the capsule of a base rounds off its edge by 25 mm
        assert max(abs(a - b) for a, b in shared if b > 0.05) < 0.045


def test_distances_of_segments() -> None:
    z = np.zeros(3)
    x, y, up = np.eye(3)

    def apart(*ends: np.ndarray) -> float:
        return float(pair_distances(np.array(ends).reshape(1, 2, 2, 3), np.array([0]), np.array([1]))[0, 0])

    assert apart(z, x, y, x + y) == pytest.approx(1.0)
    assert apart(-x, x, -y + up, y + up) == pytest.approx(1.0)
    assert apart(z, z, 3 * x, 4 * x) == pytest.approx(3.0)
    assert apart(z, x, 2 * x, 5 * x) == pytest.approx(1.0)


@pytest.mark.parametrize("enough", [0.02, 0.3])
def test_skipped_distances_change_neither_the_least_nor_what_is_too_near(enough: float) -> None:
    rng = np.random.default_rng(4)
    ends = rng.uniform(-1, 1, (40, 8, 1, 3)) + 0.2 * rng.standard_normal((40, 8, 2, 3))
    a, b = np.triu_indices(8, 1)
    less = rng.uniform(0.0, 0.1, len(a))
    exact = pair_distances(ends, a, b) - less
    found = least_distances(ends, a, b, less, enough)
    near = exact < enough
    assert near.any()
    assert np.array_equal(found < enough, near)
    assert np.array_equal(found[near], exact[near])
    assert found[~near].min() == exact[~near].min()
    assert np.all(found <= exact)
    assert (found < exact).any()  # some were skipped


def test_the_pull_of_what_is_too_near_is_that_of_every_pair() -> None:
    rng = np.random.default_rng(5)
    ends = rng.uniform(-1, 1, (30, 6, 1, 3)) + 0.2 * rng.standard_normal((30, 6, 2, 3))
    a, b = np.triu_indices(6, 1)
    least = rng.uniform(0.1, 0.6, len(a))
    pull = np.zeros_like(ends)
    lack = np.maximum(least - pair_distances(ends, a, b), 0.0)
    assert too_near(ends, a, b, least, pull) == pytest.approx(np.sum(lack**2), rel=1e-12)
    step = 1e-6
    for where in ((0, 0, 0, 0), (3, 2, 1, 1), (29, 5, 0, 2)):
        up, down = ends.copy(), ends.copy()
        up[where] += step
        down[where] -= step
        slope = (too_near(up, a, b, least, np.zeros_like(ends)) - too_near(down, a, b, least, np.zeros_like(ends))) / (2 * step)
        assert pull[where] == pytest.approx(slope, abs=1e-6)


def test_a_distance_that_is_not_a_number_is_not_skipped() -> None:
    ends = np.random.default_rng(6).uniform(-1, 1, (1, 4, 2, 3))
    ends[0, 2, 0, 1] = np.nan
    a, b = np.triu_indices(4, 1)
    found = least_distances(ends, a, b, np.zeros(len(a)), 0.02)
    assert np.array_equal(np.isnan(found[0]), (a == 2) | (b == 2))


def test_a_random_motion_fitted_to_its_room_is_cleared() -> None:
    room = Room(ARM, CELL)
    found = fitted_to_room(room, random_fourier(Basis(4, 10.0), HOME, np.random.default_rng(3)))
    assert found is not None
    assert room.use(found.sampled(20.0)).fits
    assert len(clear(found.sampled(200.0), ARM, CELL, rate=100.0)) > 900


def test_information_grows_with_the_motion() -> None:
    model = TorqueModel.of_arm(ARM)
    information = Information(model, noise_of(model.arm))
    motion = random_fourier(Basis(6, 20.0), HOME, np.random.default_rng(3))
    small, large = (information.worth(motion.scaled(k).sampled(10.0)) for k in (0.2, 0.6))
    assert large.log_det > small.log_det + 20
    assert large.condition < small.condition


def test_sweeps_are_at_constant_speed_and_within_limits() -> None:
    low, high = HOME - 0.5, HOME + 0.5
    speeds = np.outer(ARM.dq_max, [0.05, 0.15])
    path = friction_sweeps(ARM, HOME, low, high, speeds, 1.0, 200.0)
    check_limits(path, ARM)
    for j in range(6):
        for speed in speeds[j]:
            for way in (1, -1):
                assert np.sum(np.abs(path.dq[:, j] - way * speed) < 1e-6) > 100
    assert np.all(np.sum(np.abs(path.dq) > 1e-9, axis=1) <= 1)


def test_the_chirp_reaches_its_frequency_within_limits() -> None:
    size = np.full(6, 0.2)
    path = overlay(ARM, HOME, size, 10.0, 500.0)
    check_limits(path, ARM)
    late = (path.t > 7.5) & (path.t < 8.3)
    crossings = np.sum(np.diff(np.sign(path.dq[late, 0])) != 0)
    assert crossings / 2 / 0.8 > 3.5
    assert np.allclose(path.q[-1], HOME)


def test_a_stop_outside_the_limits_is_refused() -> None:
    with pytest.raises(ConfigError, match="no motion from"):
        through(ARM, HOME, [Waypoint(np.full(6, np.nan), ARM.dq_max)], 100.0)


def test_a_start_in_collision_says_which_bodies() -> None:
    folded = np.array([0.0, -1.4, 2.9, 0.0, 0.0, 0.0])
    room = Room(ARM, CELL)
    assert fitted_to_room(room, random_fourier(Basis(4, 10.0), folded, np.random.default_rng(0))) is None
    with pytest.raises(AnswerIsNo, match=r" and wrist.* mm nearer to each other"):
        random_start(room, Information(MODEL, noise_of(MODEL.arm)), Basis(4, 10.0), folded, np.random.default_rng(0), 1)


def test_a_cell_without_a_free_posture_names_what_is_too_near() -> None:
    raised = CELL.table.obstacles[0].model_copy(update={"position": [0.0, 0.0, 3.0]})
    cell = replace(CELL, table=CELL.table.model_copy(update={"obstacles": [raised]}))
    with pytest.raises(AnswerIsNo, match="and mounting_plane are too near to each other in 100% of them"):
        home_of(Room(ARM, cell), cell, None, np.random.default_rng(0))


def test_limits_that_are_too_tight_name_the_one_that_binds() -> None:
    weak = replace(ARM, tau_max=np.array([330.0, 60.0, 150.0, 54.0, 54.0, 54.0]))
    room, model = Room(weak, CELL), TorqueModel.of_arm(weak)
    with pytest.raises(AnswerIsNo, match="torque"):
        random_start(room, Information(model, noise_of(model.arm)), Basis(4, 10.0), HOME, np.random.default_rng(0), 2)


QUICKEST = replace(QUICK, tries=3)


@pytest.mark.parametrize(
    ("change", "session", "words"),
    [
        ({}, replace(QUICKEST, period=1.0), ["moves through", "jerk_max of 100 restricts it at a period of 1 s", "--period of"]),
        ({"dq_max": np.array([2.0, 2.0, 3.0, 3.0, 0.01, 3.0])}, QUICKEST, ["wrist_2_joint", "dq_max of 0.01 restricts it", "--period of"]),
        ({"ddq_max": np.array([5.0, 0.003, 5.0, 5.0, 5.0, 5.0])}, QUICKEST, ["shoulder_lift_joint", "ddq_max of 0.003", "in arm.toml"]),
    ],
)  # fmt: skip
def test_a_plan_that_is_too_small_says_what_holds_it_and_what_would_relax_it(
    change: dict[str, np.ndarray], session: Session, words: list[str]
) -> None:
    with pytest.raises(AnswerIsNo) as caught:
        design(replace(ARM, **change), CELL, replace(session, home=HOME))
    assert [word for word in words if word not in str(caught.value)] == []


def test_the_period_that_a_refusal_asks_for_is_enough() -> None:
    with pytest.raises(AnswerIsNo) as caught:
        design(ARM, CELL, replace(QUICKEST, period=1.0, home=HOME))
    proposed = re.search(r"--period of ([\d.]+) s", str(caught.value))
    assert proposed
    found = fitted_to_room(Room(ARM, CELL), random_fourier(Basis(6, 1.3 * float(proposed[1])), HOME, np.random.default_rng(5)))
    assert found is not None
    assert too_small(Room(ARM, CELL), found) is None


@pytest.mark.parametrize("text", ["1,2,3", "a,b", "nan,0,0,0,0,0"])
def test_a_home_that_is_no_posture(text: str) -> None:
    with pytest.raises(ConfigError, match="--home"):
        posture(text, ARM)


@pytest.mark.parametrize(
    "name", ["ur5e", *(pytest.param(a, marks=pytest.mark.slow) for a in ("ur3e", "ur10e", "ur16e", "ur20", "servo6"))]
)
def test_every_arm_has_a_home_with_room(name: str) -> None:
    arm = load_arm(name)
    cell = open_cell(arm)
    room = Room(arm, cell)
    home = home_of(room, cell, None, np.random.default_rng(0))
    trials = [random_fourier(Basis(4, 20.0), home, np.random.default_rng(seed)) for seed in range(6)]
    assert sum(fitted_to_room(room, trial) is not None for trial in trials) >= 2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur3e", "ur5e", "ur10e", "ur16e", "ur20", "servo6"])
def test_every_arm_has_a_quick_plan(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert program.main(["plan", name, "--quick", "--json", "--out", str(tmp_path / "plan")]) == 0
    reply = json.loads(capsys.readouterr().out)
    plan = load_plan(tmp_path / "plan")
    assert [m.name for m in plan.motions] == ["friction", "excitation", "validation"]
    assert reply["condition_number"] == pytest.approx(plan.summary["condition_number"])
    assert reply["identifiable"]
