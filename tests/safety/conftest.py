"""A six-joint arm of capsules, small enough to read, and a cell with a table and a post."""

from __future__ import annotations

import importlib.util
import multiprocessing
import os
import types
from collections.abc import Iterator
from datetime import UTC, datetime
from multiprocessing.connection import Connection
from pathlib import Path

import numba
import numpy as np
import pytest

from safety import cycle, looks, monitor
from safety.clear import ClearedTrajectory, clear
from safety.collision import Clearance
from safety.monitor import Expected, Monitor
from safety.monitor_link import tube_file
from safety.plan import Motion, Plan, write_plan
from safety.verified_samples import VerifiedSamples
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.joint_state import JointState
from sim.trajectory import Trajectory
from tests.safety.perfect import PerfectDriver, simulated

CONTEXT = multiprocessing.get_context("spawn")
MODEL = """<mujoco model="test6">
 <compiler angle="radian" inertiafromgeom="false"/>
 <option gravity="0 0 -9.81"/>
 <worldbody>
  <body name="shoulder" pos="0 0 0.18"><joint name="j1" axis="0 0 1" range="-6.28 6.28" armature="0.4"/>
   <inertial pos="0 0 0" mass="7" diaginertia="0.03 0.03 0.02"/>
   <geom name="shoulder" type="capsule" size="0.08" fromto="0 0 -0.02 0 0.06 0"/>
   <body name="upper" pos="0 0.17 0"><joint name="j2" axis="0 1 0" range="-6.28 6.28" armature="0.4"/>
    <inertial pos="0.2 0 0" mass="12" diaginertia="0.03 0.4 0.4"/>
    <geom name="upper" type="capsule" size="0.07" fromto="0 0 0 0.6 0 0"/>
    <body name="fore" pos="0.61 -0.13 0"><joint name="j3" axis="0 1 0" range="-3.14 3.14" armature="0.3"/>
     <inertial pos="0.25 0 0" mass="4" diaginertia="0.01 0.1 0.1"/>
     <geom name="fore" type="capsule" size="0.05" fromto="0 0 0 0.55 0 0"/>
     <body name="w1" pos="0.57 0.12 0"><joint name="j4" axis="0 1 0" range="-6.28 6.28" armature="0.1"/>
      <inertial pos="0 0 0" mass="2" diaginertia="0.003 0.003 0.003"/>
      <geom name="w1" type="capsule" size="0.045" fromto="0 -0.03 0 0 0.03 0"/>
      <body name="w2" pos="0 0 0.12"><joint name="j5" axis="0 0 1" range="-6.28 6.28" armature="0.1"/>
       <inertial pos="0 0 0" mass="2" diaginertia="0.003 0.003 0.003"/>
       <geom name="w2" type="capsule" size="0.045" fromto="0 0 -0.03 0 0 0.03"/>
       <body name="w3" pos="0 0.1 0"><joint name="j6" axis="0 1 0" range="-6.28 6.28" armature="0.05"/>
        <inertial pos="0 0 0" mass="0.6" diaginertia="0.0004 0.0004 0.0004"/>
        <geom name="w3" type="sphere" size="0.045"/>
       </body></body></body></body></body></body>
 </worldbody>
</mujoco>
"""

ARM = """schema = "arm/1"
name = "test6"
model = "model.xml"
joints = ["j1", "j2", "j3", "j4", "j5", "j6"]
[limits]
q_min = [-6.28, -6.28, -3.14, -6.28, -6.28, -6.28]
q_max = [6.28, 6.28, 3.14, 6.28, 6.28, 6.28]
dq_max = [2.0, 2.0, 3.0, 3.0, 3.0, 3.0]
ddq_max = [10.0, 10.0, 12.0, 20.0, 20.0, 20.0]
jerk_max = [200.0, 200.0, 200.0, 400.0, 400.0, 400.0]
tau_max = [330.0, 330.0, 150.0, 56.0, 56.0, 56.0]
[sensors]
rate = 500.0
encoder_resolution = 1e-5
velocity_noise = [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3]
torque_noise = [0.5, 0.5, 0.5, 0.1, 0.1, 0.1]
[provenance]
all = "made for the tests of the package safety"
"""
# a zero with a standard deviation states that there is no friction
FRICTIONLESS = "".join(
    f"""[[effects]]
effect = "{effect}_friction"
joint = "j{j}"
parameters = {{ {effect} = 0.0 }}
std = {{ {effect} = 1e-9 }}
"""
    for effect in ("coulomb", "viscous")
    for j in range(1, 7)
)

CELL = """schema = "cell/1"
name = "test-cell"
arm = "test6"
driver = "mock"
home = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]
[[obstacles]]
kind = "plane"
name = "table"
position = [0.0, 0.0, -0.05]
normal = [0.0, 0.0, 1.0]
[[obstacles]]
kind = "box"
name = "post"
position = [-1.2, 0.0, 0.5]
size = [0.2, 0.2, 1.0]
"""

HOME = np.array([0.0, -1.4, 1.3, -1.4, -1.2, 0.3])
PERIOD, RATE = 0.002, 500.0
NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
NO_TORQUE = Expected(np.zeros(6), np.zeros(6), np.zeros(6), 0.1)


@pytest.fixture(scope="session", autouse=True)
def traced() -> None:
    """Under coverage, replace the monitor's compiled functions by interpreted ones: coverage sees only interpreted lines."""
    if "COVERAGE_RUN" not in os.environ:
        return
    for module in (cycle, looks):  # their register_jitable callees in other files are Python when called from Python
        numba.config.DISABLE_JIT = True
        spec = importlib.util.spec_from_file_location(f"{module.__name__}_interpreted", str(module.__file__))
        assert spec is not None
        assert spec.loader is not None
        interpreted = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(interpreted)
        numba.config.DISABLE_JIT = False
        for name, value in vars(interpreted).items():
            if isinstance(value, types.FunctionType):
                for user in (module, monitor):
                    if hasattr(user, name):
                        setattr(user, name, value)


@pytest.fixture(scope="session")
def arm_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("arms") / "test6"
    folder.mkdir()
    (folder / "model.xml").write_text(MODEL)
    (folder / "arm.toml").write_text(ARM + FRICTIONLESS)
    return folder


@pytest.fixture(scope="session")
def arm(arm_folder: Path) -> Arm:
    return load_arm(arm_folder)


@pytest.fixture(scope="session")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Cell:
    file = tmp_path_factory.mktemp("cells") / "test-cell.toml"
    file.write_text(CELL)
    return load_cell(file)


def sine(n: int = 6, duration: float = 4.0, amplitude: float = 0.2, step: float = 0.01, cycles: int = 2) -> Trajectory:
    """A motion from rest to rest at HOME: a sine under a squared-sine window, with exact derivatives."""
    t = np.linspace(0, duration, round(duration / step) + 1)
    w, p = 2 * np.pi * cycles / duration, np.pi / duration
    a, s, c = np.sin(p * t) ** 2, np.sin(w * t), np.cos(w * t)
    da, dda = p * np.sin(2 * p * t), 2 * p**2 * np.cos(2 * p * t)
    x, dx = a * s, da * s + a * w * c
    ddx = dda * s + 2 * da * w * c - a * w**2 * s
    scale = amplitude * np.linspace(1, 0.5, n)
    return Trajectory(t, HOME[:n] + x[:, None] * scale, dx[:, None] * scale, ddx[:, None] * scale)


@pytest.fixture
def motion() -> Trajectory:
    return sine()


@pytest.fixture(scope="module")
def cleared(arm: Arm, cell: Cell) -> ClearedTrajectory:
    return clear(sine(duration=3.0), arm, cell)


@pytest.fixture(scope="module")
def clearance(arm: Arm, cell: Cell) -> Clearance:
    return Clearance(arm, cell)


@pytest.fixture(scope="module")
def motions(arm: Arm, cell: Cell) -> list[ClearedTrajectory]:
    return [clear(sine(duration=3.0), arm, cell), clear(sine(duration=2.0, amplitude=0.1), arm, cell)]


@pytest.fixture
def tube(motions: list[ClearedTrajectory], arm: Arm, cell: Cell, tmp_path: Path) -> VerifiedSamples:
    return VerifiedSamples(tube_file(tmp_path, motions), [len(m) for m in motions], arm, cell, RATE)


@pytest.fixture
def plan(tmp_path: Path, arm: Arm, cell: Cell, motion: Trajectory) -> Plan:
    motions = [Motion("friction", "friction", motion), Motion("excitation", "excitation", motion.scaled(0.5))]
    return write_plan(tmp_path / "plan", arm, motions, cell, {"condition_number": 31.5, "seed": 4}, NOON)


@pytest.fixture
def driver(arm: Arm, cell: Cell) -> PerfectDriver:
    made = simulated(cell, arm)
    made.connect()
    return made


def state_at(k: int = 0, **changes: object) -> JointState:
    t = k * PERIOD
    known = {"q": HOME, "dq": np.zeros(6), "tau": np.zeros(6), "current": np.full(6, np.nan), "temperature": np.full(6, 30.0)}
    return JointState(**({"t": t, "t_device": t} | known | changes))  # type: ignore[arg-type]


@pytest.fixture(name="monitor")
def a_monitor(arm: Arm, cell: Cell) -> Monitor:
    return Monitor(arm, cell, 500.0, Clearance(arm, cell), state_at())


def ask(
    monitor: Monitor,
    state: JointState,
    now: float | None = None,
    tau_hat: np.ndarray | None = None,
    q_cmd: np.ndarray = HOME,
) -> str | None:
    expected = None if tau_hat is None else Expected(tau_hat, np.zeros(6), np.zeros(6), 0.1)
    trip = monitor.check(state, state.t if now is None else now, q_cmd, expected)
    return None if trip is None else trip.quantity


@pytest.fixture
def talk() -> Iterator[tuple[Connection, Connection]]:
    """Both ends of the pipe between control and monitor process."""
    ours, theirs = CONTEXT.Pipe()
    yield ours, theirs
    ours.close()
    theirs.close()
