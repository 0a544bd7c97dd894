"""Every number that can reach an arm, replaced by an invalid one: NaN, infinity, wrong shape, wrong type. None is accepted.

An entry is a place where numbers come in: motions, limits, cell, readings of a device, what a driver sends, plans, stages. A
mutant is one entry with one value replaced. It counts as accepted if there is no error and no trip.
"""

from __future__ import annotations

import hashlib
import io
import random
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.driver import DeviceStop
from drivers.mock import MockDriver
from safety.approach import joined, move
from safety.approval import approve
from safety.clear import clear
from safety.collision import Clearance
from safety.device_stops import DeviceStops
from safety.guard import Guard
from safety.limits import check_limits, check_sent
from safety.monitor import Expected, Monitor
from safety.plan import Motion, load_plan, write_plan
from safety.seal import sealed
from safety.stages import StageResult, gate
from safety.torque import torque_interval
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.errors import CalibError
from sim.joint_state import JointState
from sim.trajectory import Trajectory
from tests.safety.conftest import HOME, sine
from tests.safety.spoilt_numbers import array, number

REFUSALS = (CalibError, ValueError, TypeError)
Mutant = Callable[[random.Random], Callable[[], Any]]


class Entries:
    """All entries, each a method that returns the call with one random mutant."""

    def __init__(self, arm: Arm, cell: Cell, folder: Path) -> None:
        self.arm, self.cell, self.folder = arm, cell, folder
        self.motion = sine(duration=0.4, amplitude=0.002, step=0.1, cycles=1)
        self.clearance = Clearance(arm, cell)
        self.state = JointState(0.002, 0.002, HOME, np.zeros(6), np.zeros(6), np.full(6, np.nan), np.full(6, 30.0))
        self.first = replace(self.state, t=0.0, t_device=0.0)
        self.driver = MockDriver.from_cell(cell, arm)
        self.driver.connect()
        self.plan = write_plan(folder / "plan", arm, [Motion("probe", "probe", self.motion)], cell)
        (folder / "arm").mkdir()
        shutil.copy(arm.model_path, folder / "arm" / "model.xml")
        self.arm_text = (arm.model_path.parent / "arm.toml").read_text()
        self.cell_text = (
            cell.path.read_text() + "[payload]\nmass = 1.0\ncom = [0.0, 0.0, 0.1]\n[motion]\npoint_speed_max = 1.0\n"
        )
        clear(self.motion, arm, cell, clearance=self.clearance)
        assert (
            Monitor(arm, cell, 500.0, self.clearance, self.first).check(
                self.state, 0.002, HOME, Expected(*(np.zeros(6),) * 3, 0.1)
            )
            is None
        )

    def trajectory(self, rng: random.Random) -> Callable[[], Any]:
        name = rng.choice(("t", "q", "dq", "ddq"))
        values = {key: getattr(self.motion, key) for key in ("t", "q", "dq", "ddq")}
        values[name] = array(values[name], rng)
        return lambda: clear(Trajectory(**values), self.arm, self.cell, clearance=self.clearance)

    def limits(self, rng: random.Random) -> Callable[[], Any]:
        name = rng.choice(("q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max"))
        bad = getattr(self.arm, name).copy()
        bad[rng.randrange(6)] = rng.choice((np.nan, -np.inf if name != "q_min" else np.inf))
        arm = replace(self.arm, **{name: bad})  # type: ignore[arg-type]
        return lambda: clear(self.motion, arm, self.cell, clearance=self.clearance)

    def clear_settings(self, rng: random.Random) -> Callable[[], Any]:
        name, value = rng.choice(("rate", "latency", "stop")), number(rng)
        if name == "stop":
            value = rng.choice((1.0, "fast", [], object()))
        if name == "rate" and value is None:  # None means the arm's own rate
            value = "None"
        return lambda: clear(self.motion, self.arm, self.cell, clearance=self.clearance, **{name: value})

    def device_stop(self, rng: random.Random) -> Callable[[], Any]:
        values = {"reaction": 0.1, "deceleration": 4.0, rng.choice(("reaction", "deceleration")): number(rng)}
        return lambda: DeviceStops(self.motion, self.arm, DeviceStop(**values), 0.0).check_limits()

    def posture(self, rng: random.Random) -> Callable[[], Any]:
        q = array(HOME, rng)
        return lambda: self.clearance.distances(q)

    def approach(self, rng: random.Random) -> Callable[[], Any]:
        q = array(HOME, rng)
        if rng.random() < 0.5:
            return lambda: joined(self.motion, q, self.arm, 500.0, 0.25)
        return lambda: move(*rng.sample((HOME, q), 2), self.arm, 500.0, 0.25)

    def sent(self, rng: random.Random) -> Callable[[], Any]:
        name = rng.choice(("q", "dq", "tau"))
        values = {key: np.zeros(6) for key in ("q", "dq", "tau")}
        values[name] = array(HOME, rng)
        return lambda: self.driver.send(**values)

    def answer(self, rng: random.Random) -> Callable[[], Any]:
        """What a driver returns as sent."""
        value = array(HOME, rng)
        driver = MockDriver.from_cell(self.cell, self.arm)
        driver.connect()
        guard = Guard(driver, self.arm, self.cell, self.clearance).__enter__()
        driver.send = lambda q, dq, tau: value  # type: ignore[method-assign]
        return lambda: guard.hold(0.002, "a test")

    def reading(self, rng: random.Random) -> Callable[[], Any]:
        name = rng.choice(("t", "t_device", "q", "dq", "tau", "temperature", "status"))
        good = getattr(self.state, name)
        value = array(good, rng) if isinstance(good, np.ndarray) else number(rng)

        def ask() -> Any:
            state = replace(self.state, **{name: value})
            trip = Monitor(self.arm, self.cell, 500.0, self.clearance, self.first).check(
                state, 0.002, HOME, Expected(*(np.zeros(6),) * 3, 0.1)
            )
            if trip is not None:
                raise ValueError(str(trip))

        return ask

    def first_reading(self, rng: random.Random) -> Callable[[], Any]:
        name = rng.choice(("q", "dq", "status"))
        good = getattr(self.state, name)
        value = array(good, rng) if isinstance(good, np.ndarray) else number(rng)
        driver = MockDriver.from_cell(self.cell, self.arm)
        driver.connect()
        driver.faults.append(lambda state: replace(state, **{name: value}))
        return lambda: Guard(driver, self.arm, self.cell, self.clearance).__enter__()

    def plan_file(self, rng: random.Random) -> Callable[[], Any]:
        file, toml = self.plan.folder / "probe.npy", self.plan.folder / "plan.toml"
        raw, text = file.read_bytes(), toml.read_bytes()
        columns = np.load(io.BytesIO(raw))
        bad = array(columns, rng)
        data = io.BytesIO()
        np.save(data, np.array(bad), allow_pickle=True)
        body = (
            text.decode()
            .split("\n", 1)[1]
            .replace(hashlib.sha256(raw).hexdigest(), hashlib.sha256(data.getvalue()).hexdigest())
        )

        def read() -> Any:
            try:
                file.write_bytes(data.getvalue())
                toml.write_bytes(sealed(body))
                return load_plan(self.plan.folder)
            finally:
                file.write_bytes(raw)
                toml.write_bytes(text)

        return read

    def stage(self, rng: random.Random) -> Callable[[], Any]:
        values = {"speed": 0.1, "following_error": (0.0,) * 6, "residual": (0.0,) * 6}
        name = rng.choice(("following_error", "residual"))
        bad = list(values[name])  # type: ignore[call-overload]
        bad[rng.randrange(6)] = rng.choice((np.nan, np.inf, None, "x", 1j))
        return lambda: gate(StageResult(**values | {name: tuple(bad)}), 0.25, self.arm, self.cell, 0.1)  # type: ignore[arg-type]

    def arm_file(self, rng: random.Random) -> Callable[[], Any]:
        return self._text(rng, self.arm_text, self.folder / "arm" / "arm.toml", lambda file: load_arm(file.parent))

    def cell_file(self, rng: random.Random) -> Callable[[], Any]:
        return self._text(rng, self.cell_text, self.folder / "cell.toml", lambda file: Clearance(self.arm, load_cell(file)))

    def _text(self, rng: random.Random, text: str, file: Path, load: Callable[[Path], Any]) -> Callable[[], Any]:
        """Replace one number of a TOML file by an invalid value."""
        body, places = text, []
        at = body.find("\n[") if file.name == "arm.toml" else body.find("home")
        for k, letter in enumerate(body):
            if k > at and letter.isdigit() and body[k - 1] in " [":
                places.append(k)
        k = rng.choice(places)
        end = k
        while body[end] in "0123456789.e-":
            end += 1
        mutant = body[:k] + rng.choice(("nan", "inf", "-inf", '"1"', "[]", "{}", "true", "1979-05-27")) + body[end:]

        def read() -> Any:
            file.write_text(mutant)
            return load(file)

        return read

    def approval(self, rng: random.Random) -> Callable[[], Any]:
        hours = rng.choice((np.nan, np.inf, -np.inf, 0.0, -1.0, 24.1, None, "x", [8.0]))
        return lambda: approve(self.plan, self.arm, self.cell, "operator", datetime(2026, 1, 1, tzinfo=UTC), hours)

    def checks(self, rng: random.Random) -> Callable[[], Any]:
        """The individual checks, with a motion whose finite numbers are beyond anything that an arm can do."""
        name = rng.choice(("q", "dq", "ddq"))
        values = {key: np.array(getattr(self.motion, key)) for key in ("t", "q", "dq", "ddq")}
        values[name][rng.randrange(len(self.motion)), rng.randrange(6)] = rng.choice((1e300, -1e300, 1e30, 1e9))
        motion = Trajectory(**values)
        if rng.random() < 0.5:
            return lambda: check_limits(motion, self.arm)
        if rng.random() < 0.5:
            return lambda: check_sent(motion, self.arm)
        return lambda: clear(motion, self.arm, self.cell, clearance=self.clearance)


ENTRIES = (
    ("trajectory", 5), ("limits", 2), ("clear_settings", 2), ("device_stop", 2), ("posture", 3), ("approach", 2), ("sent", 3),
    ("answer", 1), ("reading", 6), ("first_reading", 1), ("plan_file", 1), ("stage", 2), ("arm_file", 1), ("cell_file", 1),
    ("approval", 1), ("checks", 2),
)  # fmt: skip


@pytest.mark.parametrize("count", [500, pytest.param(10_000, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_no_mutant_survives(arm: Arm, cell: Cell, tmp_path: Path, count: int) -> None:
    entries, rng = Entries(arm, cell, tmp_path), random.Random(count)
    names = [name for name, weight in ENTRIES for _ in range(weight)]
    survivors: dict[str, int] = {}
    for k in range(count):
        name = names[k % len(names)]
        call = getattr(entries, name)(rng)
        try:
            call()
        except REFUSALS:
            continue
        survivors[name] = survivors.get(name, 0) + 1
    assert survivors == {}
    assert torque_interval(entries.motion, arm, cell) is not None
