"""The blind cases: their rigid dynamics are right, no code under test makes their truth, and a seed reproduces every case."""

from __future__ import annotations

import ast
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

import benchmarks.exam
from benchmarks.exam import injected
from benchmarks.exam.cases import ARMS, BY_NAME, CONFUSABLE, Case, listed, make
from benchmarks.exam.dynamics import inertia_at, torque_along
from benchmarks.exam.effects import EFFECTS
from benchmarks.exam.true_arm import chain_of
from benchmarks.exam.unknowns import UNKNOWNS
from logs import read_log
from sim.arm import load_arm
from sim.rigid_body import RigidBody


@pytest.mark.parametrize("name", ARMS)
def test_its_own_rigid_dynamics_are_right(name: str) -> None:
    tree = load_arm(name).tree
    bodies, rng = RigidBody(tree), np.random.default_rng(2)
    q, dq, ddq = rng.uniform(-3, 3, (3, 40, tree.n))
    expected = bodies.inverse_dynamics(q, dq, ddq)
    chain = chain_of(tree)
    np.testing.assert_allclose(torque_along(chain, tree.gravity, q, dq, ddq), expected, atol=1e-11 * np.abs(expected).max())
    mass = bodies.mass_matrix(q[0])
    np.testing.assert_allclose(inertia_at(chain, q[0]), mass, atol=1e-11 * np.abs(mass).max())


def test_the_truth_is_not_made_by_what_has_to_find_it() -> None:
    # true_model writes the true arm for the comparison after an answer; no recording is made from it
    forbidden = {"sim.effects", "sim.plant", "sim.prediction", "sim.rigid_body", "calib", "mujoco", "pinocchio"}
    for file in Path(str(benchmarks.exam.__file__)).parent.glob("*.py"):
        if file.name == "true_model.py":
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [a.name for a in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert not any(name == f or name.startswith(f"{f}.") for f in forbidden), f"{file.name} imports {name}"


def test_three_hundred_cases_hold_everything() -> None:
    cases = listed(300, 1)
    kinds = {k: [c for c in cases if c.kind == k] for k in ("clean", "single", "pair", "triple", "unknown")}
    assert len(kinds["clean"]) >= 100
    assert {c.chosen[0][0] for c in kinds["single"]} == {e.name for e in EFFECTS}
    assert {c.chosen[0][0] for c in kinds["unknown"]} == {u.name for u in UNKNOWNS}
    assert all(len(c.chosen) == n for k, n in (("clean", 0), ("pair", 2), ("triple", 3)) for c in kinds[k])
    for kind in kinds.values():
        assert {c.arm for c in kind} == set(ARMS)
    assert {c.severity for c in cases} == {1, 2, 3}
    assert 0.25 < np.mean([c.hard for c in cases]) < 0.42
    assert len({c.seed for c in cases}) == len(cases)
    joints = {j for c in kinds["single"] for _, j in c.chosen}
    assert joints == {-1, 0, 1, 2, 3, 4, 5}


def test_an_exam_is_a_function_of_its_seed() -> None:
    assert listed(300, 4)[:60] == listed(60, 4)
    assert listed(60, 5) != listed(60, 4)


def test_confusable_pairs_are_of_the_catalogue() -> None:
    assert all(a in BY_NAME and b in BY_NAME and a != b for a, b in CONFUSABLE)


@pytest.mark.slow
def test_a_case_comes_again_and_reads(tmp_path: Path) -> None:
    case = Case(0, "pair", "servo6", 2, True, 99, (("coulomb_friction", 2), ("time_delay", -1)))
    digests = []
    for folder in (tmp_path / "one", tmp_path / "two"):
        make(case, folder)
        files = [f for f in sorted(folder.rglob("*")) if f.is_file()]
        digests.append({f.relative_to(folder).as_posix(): hashlib.sha256(f.read_bytes()).hexdigest() for f in files})
    assert digests[0] == digests[1]
    assert set(digests[0]) == {
        "arm.xml", "friction.mcap", "excitation.mcap", "validation.mcap", "final.mcap", "truth.json", "true/arm.toml", "true/model.xml",
    }  # fmt: skip
    arm = load_arm(tmp_path / "one" / "arm.xml")
    log = read_log(tmp_path / "one" / "excitation.mcap", arm.joint_names)
    assert log.t[-1] - log.t[0] > 25
    assert np.isfinite(log.q).all()
    assert np.isfinite(log.tau).all()
    truth = json.loads((tmp_path / "one" / "truth.json").read_text())
    assert [(e["effect"], e["joint"]) for e in truth["effects"]] == [
        ("coulomb_friction", "elbow_joint"), ("time_delay", None),
    ]  # fmt: skip
    assert all(e["severity"] in (1, 2, 3) and e["rho"] > 0 for e in truth["effects"])


def test_an_effect_adds_its_torque_to_a_recorded_motion(tmp_path: Path) -> None:
    """A spring adds k (q - rest) / K_t to the current; a gain then scales the whole reading."""
    from benchmarks.exam import motions
    from benchmarks.exam.real import bare

    t = np.arange(0, 8, 0.0105)
    q = motions.HOME + 0.4 * np.sin(np.outer(t, np.linspace(0.8, 1.4, 6)))
    columns = ["timestamp", *(f"{name}_{j}" for name in ("actual_q", "actual_qd", "actual_current") for j in range(6))]
    table = np.column_stack([t + 500, q, np.gradient(q, t, axis=0), np.ones((len(t), 6))])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(columns), comments="")
    motion = injected.recorded(tmp_path / "log.csv")
    clean = bare(1, load_arm("ur10e"))
    hidden = clean.copy()
    hidden.joints["spring"][2], hidden.joints["spring_rest"][2] = 20.0, 1.0
    hidden.sensors.gain[2] = 1.1
    constant = np.full(6, 10.0)
    changed = injected.with_hidden(motion, clean, hidden, constant, np.random.default_rng(0)).table
    moved = changed[:, motion.block("actual_current")]
    np.testing.assert_allclose(moved[:, 2], 1.1 * (1.0 + 20.0 * (q[:, 2] - 1.0) / 10.0), atol=2e-3)
    np.testing.assert_allclose(np.delete(moved, 2, axis=1), 1.0, atol=1e-9)
    np.testing.assert_array_equal(changed[:, :13], motion.table[:, :13])


def test_a_gear_that_needs_shorter_steps_is_measured_at_the_same_instants() -> None:
    from benchmarks.exam import motions, severity
    from benchmarks.exam.arms import HARDWARE
    from benchmarks.exam.real import bare
    from benchmarks.exam.true_arm import run

    clean, hardware = bare(1, load_arm("ur10e")), HARDWARE["ur10e"]
    reference = motions.fourier_motion(np.random.default_rng(3), motions.HOME, hardware.speed, 2.0, 3, hardware.control_period)
    stiff = clean.copy()
    stiff.joints["stiffness"][2], stiff.joints["gear_damping"][2] = 2e7, 1e3
    step = np.diff(run(stiff, reference, motions.SETTLE, np.full(6, 25.0), severity.COARSE).t[:2])
    assert step < 0.6 * severity.COARSE
    without, with_gear = severity.rows(clean, reference), severity.rows(stiff, reference)
    assert len(with_gear.residual) == len(without.residual) == round(severity.RATE * reference.duration)
    np.testing.assert_allclose(with_gear.q, without.q, atol=2e-3)
