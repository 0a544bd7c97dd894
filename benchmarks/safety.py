"""Motion safety: clearing a long plan, a monitor cycle, and for every fault how soon the arm slows down and how far it still travels.

Faults are injected into the mock (MuJoCo plant, simulated clock): `reaction` counts readings from the first one that shows the fault to
the first command that is not the planned one, 0 being the command that answers that very reading. Angles are the plant's own.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from drivers.mock import MockDriver
from safety import ClearedTrajectory, MotionStopped, clear
from safety.collision import Clearance
from safety.guard import STANDSTILL, Guard
from safety.monitor import Monitor
from safety.sudden import sudden_change
from safety.torque import torque_interval
from sim.arm import Arm, ArmEffect, load_arm
from sim.cell import BoxObstacle, Cell, PayloadTable, load_cell
from sim.clock import SimulatedClock
from sim.effects import with_effect
from sim.errors import DeviceError, SafetyStop
from sim.joint_state import JointState
from sim.plant import Plant
from sim.trajectory import Trajectory

CELL = "mock-ur10e"
RATE = 500.0
SETTLE, AFTER = 1500, 200
BOX = 0.3
SEEDS = (3, 4, 5, 6)
LOAD = PayloadTable(mass=6.0, com=[0.0, 0.0, 0.1])


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


def motion(
    home: np.ndarray, duration: float, amplitude: float, step: float = 0.01, harmonics: int = 5, seed: int = 0
) -> Trajectory:
    """Sums of sines about `home` below a window that is at rest at both ends, exact in all derivatives."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, duration, round(duration / step) + 1)[:, None]
    base = 2 * np.pi / min(duration, 10.0)
    x, dx, ddx = (np.zeros((len(t), len(home))) for _ in range(3))
    for k in range(1, harmonics + 1):
        w, phase, size = k * base, rng.uniform(0, 2 * np.pi, len(home)), rng.uniform(0.3, 1.0, len(home)) * amplitude / k
        x += size * np.sin(w * t + phase)
        dx += size * w * np.cos(w * t + phase)
        ddx -= size * w**2 * np.sin(w * t + phase)
    p = np.pi / duration
    a, da, dda = np.sin(p * t) ** 2, p * np.sin(2 * p * t), 2 * p**2 * np.cos(2 * p * t)
    return Trajectory(t[:, 0], home + a * x, da * x + a * dx, dda * x + 2 * da * dx + a * ddx)


def clearing(arm: Arm, cell: Cell) -> list[dict[str, Any]]:
    """Time to prove a motion of 60 s, CPU and wall clock, geometry included."""
    home = np.array(cell.table.home)
    best, wall = np.inf, np.inf
    for seed in (0, 1, 2):
        path = motion(home, 60.0, 0.35, seed=seed)
        for _ in range(2):
            begin, cpu = time.perf_counter(), time.process_time()
            verdict = clear(path, arm, cell, RATE).verdict
            best, wall = min(best, time.process_time() - cpu), min(wall, time.perf_counter() - begin)
    used = max(verdict.used.items(), key=lambda item: item[1])
    note = f"30,001 samples with both stops of each; {used[0]} used to {used[1]:.0%}; wall clock {wall:.2f} s"
    return [row("clear a 60 s plan, CPU", f"{best:.2f}", "s", "<= 2", note)]


def monitoring(arm: Arm, cell: Cell, count: int = 20_000) -> list[dict[str, Any]]:
    """CPU time of one monitor cycle on readings of the plant, the clearance of the measured posture included."""
    driver = MockDriver.from_cell(cell, arm)
    driver.connect()
    clearance = Clearance(arm, cell)
    monitor = Monitor(arm, cell, RATE, clearance, driver.read())
    q, still = np.array(cell.table.home), np.zeros((2, arm.n))
    standing = Trajectory(np.array([0.0, 0.002]), np.vstack((q, q)), still, still)
    load = torque_interval(standing, arm, cell)
    expected = load.tau_hat[0], load.doubt[0], sudden_change(standing, arm, cell)[0]
    spent = np.empty(count)
    for k in range(count):
        state = driver.read()
        begin = time.thread_time()
        trip = monitor.check(state, driver.clock.now(), q, expected)
        spent[k] = time.thread_time() - begin
        if trip is not None:
            raise RuntimeError(str(trip))
    p50, p99, p999 = np.percentile(spent, [50, 99, 99.9]) * 1e6
    note = "the clearance of the measured posture is looked at over and over, in 50 ms for all pairs"
    return [row(f"monitor cycle, p50/p99/p99.9 CPU of {count}", f"{p50:.0f}/{p99:.0f}/{p999:.0f}", "us", "< 200", note)]


class Watched(MockDriver):
    """The mock with one trouble from its `at`-th reading on; keeps what was sent and where the plant really was."""

    trouble: Trouble
    at: int
    joint: int
    visible: int | None

    def begin(self, trouble: Trouble, at: int, joint: int) -> None:
        self.trouble, self.at, self.joint, self.visible = trouble, at, joint, None
        self.reads, self.sent, self.true, self.kept = 0, [], [], None
        self.connect()
        for _ in range(SETTLE if trouble.loaded else 0):  # the drive does not know of the load: it takes a while to hold it
            MockDriver.read(self)

    def read(self) -> JointState:
        state = super().read()
        self.look()
        self.reads += 1
        if self.reads >= self.at:
            state = self.trouble.change(self, state)
        return state

    def look(self) -> None:
        """Where the plant really is."""
        data, names = self.plant.data, self.arm.joint_names
        at = [self.plant.model.joint(name).qposadr[0] for name in names]
        self.true.append((self.plant.time, data.qpos[at].copy(), float(np.max(np.abs(data.qvel[at])))))

    def send(self, q: np.ndarray, dq: np.ndarray, tau: np.ndarray) -> np.ndarray:
        self.sent.append((self.reads, q.copy()))
        return super().send(q, dq, tau)

    def show(self) -> None:
        """The reading that is being made is the first that shows the trouble."""
        self.visible = self.visible or self.reads


@dataclass(frozen=True)
class Trouble:
    """One fault: what it does to readings from the `at`-th on, and how the plant is made for it."""

    name: str
    change: Callable[[Watched, JointState], JointState]
    note: str = ""
    stops: bool = True
    plant: Callable[[Arm, Cell, ClearedTrajectory, int], Plant | None] | None = None
    moving: float = 0.2
    loaded: bool = False


def once(change: Callable[[JointState, int], JointState]) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        driver.show()
        return change(state, driver.joint) if driver.reads == driver.at else state

    return apply


def always(change: Callable[[JointState, int], JointState]) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        driver.show()
        return change(state, driver.joint)

    return apply


def with_joint(values: np.ndarray, joint: int, value: float) -> np.ndarray:
    out = values.copy()
    out[joint] = value
    return out


def frozen(driver: Watched, state: JointState) -> JointState:
    """Visible from the first reading that repeats the one before."""
    driver.kept = driver.kept or state
    if driver.reads > driver.at:
        driver.show()
    j = driver.joint
    return replace(state, q=with_joint(state.q, j, driver.kept.q[j]), dq=with_joint(state.dq, j, driver.kept.dq[j]))


def stale(driver: Watched, state: JointState) -> JointState:
    driver.kept = driver.kept or state
    if driver.reads > driver.at:
        driver.show()
    return replace(driver.kept, t=state.t)


def lost(count: int) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        if driver.reads == driver.at:
            for _ in range(count):
                state = MockDriver.read(driver)
            driver.show()
        return state

    return apply


def cable_out(driver: Watched, state: JointState) -> JointState:
    driver.show()
    raise DeviceError("no reading within three periods")


def stalled(seconds: float) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        if driver.reads == driver.at:
            driver.show()
            driver.clock.sleep_until(driver.clock.now() + seconds)
        return state

    return apply


def touched(driver: Watched, state: JointState) -> JointState:
    """Visible from the first contact between the arm and the hidden box."""
    data, model = driver.plant.data, driver.plant.model
    box = model.geom("obstacle:hidden").id
    if any(box in (contact.geom1, contact.geom2) for contact in data.contact[: data.ncon]):
        driver.show()
    return state


def with_hidden_box(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant | None:
    """A plant with a box that nobody declared, its face across the way of the wrist 60 samples after `at`; None where the arm touches it before."""
    probe = Plant(arm, obstacles=cell.table.obstacles)
    ahead = []
    for k in (55, 65):
        probe.reset(cleared.q[min(at + k, len(cleared) - 1)])
        ahead.append(probe.data.geom_xpos[probe.model.geom("shape:wrist_3_0").id].copy())
    way = ahead[1] - ahead[0]
    way /= np.linalg.norm(way)
    turned = [0.0, -float(np.arcsin(way[2])), float(np.arctan2(way[1], way[0]))]
    place = (ahead[0] + ahead[1]) / 2 + way * BOX / 2
    box = BoxObstacle(kind="box", name="hidden", position=place.tolist(), rpy=turned, size=[BOX] * 3)
    plant = Plant(arm, obstacles=[*cell.table.obstacles, box], seed=at)
    for q in (cleared.q[0], *cleared.q[:at:10]):
        plant.reset(q)
        if plant.data.ncon:
            return None
    return plant


def with_load(arm: Arm, cell: Cell, cleared: ClearedTrajectory, at: int) -> Plant:
    return Plant(loaded(arm), drive=arm, obstacles=cell.table.obstacles, seed=at)


def loaded(arm: Arm) -> Arm:
    names = ("com_x", "com_y", "com_z")
    return with_effect(arm, ArmEffect("payload", None, {"mass": LOAD.mass, **dict(zip(names, LOAD.com, strict=True))}))


def load_lost(driver: Watched, state: JointState) -> JointState:
    if driver.reads == driver.at:
        model, bare = driver.plant.model, Plant(driver.arm, obstacles=[]).model
        name = driver.arm.tree.link_names[-1]
        here, there = model.body(name).id, bare.body(name).id
        for what in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
            getattr(model, what)[here] = getattr(bare, what)[there]
    elif driver.reads > driver.at:
        driver.show()
    return state


HOT = 90.0
TROUBLES = (
    Trouble("over-temperature", always(lambda s, j: replace(s, temperature=with_joint(s.temperature, j, HOT)))),
    Trouble("jump of one turn", once(lambda s, j: replace(s, q=with_joint(s.q, j, s.q[j] + 2 * np.pi)))),
    Trouble("sign flip of a position", once(lambda s, j: replace(s, q=with_joint(s.q, j, -s.q[j])))),
    Trouble("sign flip of a speed", always(lambda s, j: replace(s, dq=with_joint(s.dq, j, -s.dq[j]))), "five readings are averaged", moving=0.5),
    Trouble("frozen position and speed of a joint", frozen, "told from a value that comes late: three readings"),
    Trouble("stale readings", stale),
    Trouble("2 lost packets", lost(2), "no stop: within 3.5 periods", stops=False),
    Trouble("5 lost packets", lost(5)),
    Trouble("cable out", cable_out, "the device's own stop"),
    Trouble("stall of 5 ms", stalled(0.005), "no stop: within 3.5 periods", stops=False),
    Trouble("stall of 50 ms", stalled(0.05)),
    Trouble("stall of 500 ms", stalled(0.5)),
    Trouble("contact with a hidden box", touched, f"a box of {BOX:g} m, met by a face; seen by the residual of torque", plant=with_hidden_box),
    Trouble(f"payload of {LOAD.mass:g} kg lost", load_lost, "its drive lets go of the torque as the arm rises", plant=with_load, loaded=True),
)  # fmt: skip


@dataclass
class Seen:
    """What came of the repeats of one trouble."""

    reactions: list[int] = field(default_factory=list)
    angles: list[float] = field(default_factory=list)
    beyond: list[float] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    missed: int = 0
    done: int = 0
    bound: float = 0.0


def inject(trouble: Trouble, repeats: int, arm: Arm, cell: Cell) -> Seen:
    """`repeats` runs of one trouble, each at a random instant of a random motion and on a random joint that moves."""
    rng = np.random.default_rng(repeats)
    home = np.array(cell.table.home)
    if trouble.loaded:
        cell = replace(cell, table=cell.table.model_copy(update={"payload": LOAD}))
    clearance = Clearance(arm, cell)
    size = 0.12 if trouble.loaded else 0.3
    motions = [clear(motion(home, 3.0, size, harmonics=2, seed=s), arm, cell, RATE, clearance=clearance) for s in SEEDS]
    plain = Plant(arm, obstacles=cell.table.obstacles)
    seen = Seen()
    while seen.done < repeats:
        cleared = motions[int(rng.integers(len(motions)))]
        ways = np.argwhere(np.abs(cleared.dq[300:900]) > trouble.moving)
        at, joint = ways[int(rng.integers(len(ways)))] + np.array([300, 0])
        plant = trouble.plant(arm, cell, cleared, int(at)) if trouble.plant else plain
        if plant is None:
            continue
        seen.done += 1
        driver = Watched(plant, arm, RATE, SimulatedClock(), start=home)
        driver.begin(trouble, int(at), int(joint))
        guard = Guard(driver, arm, cell, clearance)
        seen.bound = max(seen.bound, cleared.verdict.stop_angle)
        try:
            guard.run(cleared, trouble.name)
        except MotionStopped as stop:
            keep(seen, driver, cleared, stop)
        except SafetyStop:
            seen.missed += 1
        else:
            seen.missed += driver.visible is not None
    return seen


def keep(seen: Seen, driver: Watched, cleared: ClearedTrajectory, stop: MotionStopped) -> None:
    """Reaction, true angle and time to standstill of one stop."""
    if driver.visible is None:
        raise RuntimeError(f"a stop before the trouble was visible: {stop}")
    first = next((reads for k, (reads, q) in enumerate(driver.sent) if not np.array_equal(q, cleared.q[k])), driver.reads)
    seen.reactions.append(first - driver.visible)
    for _ in range(AFTER):  # nobody reads after a lost link; the plant goes on
        MockDriver.read(driver)
        driver.look()
    before, end = driver.visible - 2, driver.true[-1][1]
    angles = np.abs(end - driver.true[before][1])
    after_told = np.abs(end - driver.true[first - 2][1])
    predicted = np.max(np.abs(stop.standstill.predicted_angle))
    fast = [t for t, _, speed in driver.true if speed > STANDSTILL]
    seen.angles.append(float(np.max(angles)))
    seen.beyond.append(float(np.max(after_told) / predicted))
    seen.times.append(max(fast) - driver.true[before + 1][0])


def faults(repeats: int, arm: Arm, cell: Cell) -> list[dict[str, Any]]:
    """Each trouble: reaction and angle to standstill over the repeats, beside what was predicted."""
    out = []
    for trouble in TROUBLES:
        seen = inject(trouble, repeats, arm, cell)
        if not trouble.stops:
            out.append(row(f"{trouble.name}: stops in {repeats}", len(seen.reactions), "", "0", trouble.note))
            continue
        reaction, angles = np.array(seen.reactions), np.degrees(seen.angles)
        if not angles.size:
            out.append(row(f"{trouble.name}: stops in {repeats}", 0, "", str(repeats), f"not seen; {trouble.note}"))
            continue
        value = (
            f"{np.percentile(reaction, 50):.0f}/{np.percentile(reaction, 99.9):.0f} readings; {np.median(angles):.2f}/{angles.max():.2f} deg; "
            f"{max(seen.beyond):.0%} of predicted; {max(seen.times) * 1e3:.0f} ms"
        )
        detail = f"{len(reaction)} stops, {seen.missed} missed; bound proved before: {np.degrees(seen.bound):.1f} deg"
        out.append(
            row(
                f"{trouble.name}: reaction p50/p99.9, angle p50/max, time",
                value,
                "",
                "<= 2 readings; <= 110 %",
                f"{detail}; {trouble.note}",
            )
        )
    return out


def run(repeats: int = 100) -> list[dict[str, Any]]:
    """All figures: what, value, unit, bar, note."""
    cell = load_cell(CELL)
    arm = load_arm(cell.table.arm)
    return [*clearing(arm, cell), *monitoring(arm, cell), *faults(repeats, arm, cell)]
