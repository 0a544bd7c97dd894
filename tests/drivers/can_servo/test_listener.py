"""A listener reads what the commanding program reads, loses nothing silently, and sends no frame while it listens."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

import can
import numpy as np
import pytest

from drivers.can_servo.bring_up import make_drives
from drivers.can_servo.driver import CanServo
from drivers.can_servo.link import CROWDED, Link
from drivers.can_servo.listener import Listener
from drivers.can_servo.odrive import HEARTBEAT
from sim.cell import Cell
from sim.clock import SimulatedClock
from sim.emulated.can.stepped import SteppedBus
from sim.errors import ConfigError, DeviceError
from sim.joint_state import JointState
from tests.drivers.can_servo.conftest import Bench, cell_of
from tests.drivers.can_servo.test_wire import WATCHDOG, started, swing, wire_cell


class Heard(can.BusABC):
    """A bus that replays recorded frames; sending on it fails the test."""

    def __init__(self, frames: list[can.Message], clock: SimulatedClock) -> None:
        super().__init__(channel="heard")
        self.frames, self.clock = deque(frames), clock

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self.frames:
            return self.frames.popleft()
        self.clock.sleep_until(self.clock.now() + (timeout or 0.0))
        return None

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        raise AssertionError(f"a listener sent {msg}")


def frames_of(bench: Bench, cycles: int) -> tuple[list[can.Message], list[JointState]]:
    """All frames that the driver received while streaming, with their time stamps, and the states that it read."""
    frames: list[can.Message] = []

    class Tapped(SteppedBus):
        def recv(self, timeout: float | None = None) -> can.Message | None:
            message = super().recv(timeout)
            if message is not None:
                message.timestamp = self.clock.now()
                frames.append(message)
            return message

    driver = bench.driver
    driver._open_link = lambda: Link(Tapped(bench.bus, bench.clock), bench.clock, "tapped")
    driver.connect()
    frames.clear()
    states = bench.stream(cycles)
    received = list(frames)
    driver.release()
    return received, states


@pytest.fixture
def listener() -> Iterator[Callable[[Bench, list[can.Message]], Listener]]:
    """Makes listeners for a bench's drives that receive the given frames."""
    made: list[Listener] = []

    def make(bench: Bench, frames: list[can.Message]) -> Listener:
        made.append(hearing(bench, frames))
        return made[-1]

    yield make
    for ear in made:
        ear.link.close()


def hearing(bench: Bench, frames: list[can.Message]) -> Listener:
    options = bench.driver.options
    drives = make_drives(options)
    for drive, known in zip(drives, bench.driver.drives, strict=True):
        drive.set_ranges(known.ranges)
    clock = SimulatedClock()
    return Listener(drives, Link(Heard(frames, clock), clock, "heard"), clock, options.rate)


@pytest.mark.parametrize("protocol", ["damiao", "cubemars", "robstride", "odrive"])
def test_a_listener_reads_what_the_commanding_program_reads(bench, listener, protocol: str) -> None:
    made = bench(protocol)
    frames, states = frames_of(made, 60)
    ear = listener(made, frames)
    started = [ear.read() for _ in range(10)][-1]  # rounds are incomplete while the drives are switched on one by one
    lost = ear.lost
    received = [ear.read() for _ in range(30)]
    first = next(k for k, s in enumerate(states) if np.array_equal(s.tau, started.tau)) + 1
    for mine, own in zip(received, states[first:], strict=False):
        np.testing.assert_array_equal(mine.q, own.q)
        np.testing.assert_array_equal(mine.tau, own.tau)
    t = np.array([s.t_device for s in received])
    np.testing.assert_allclose(np.diff(t), 1 / made.driver.rate, atol=0.3 / made.driver.rate)
    assert ear.lost == lost


def test_a_lost_answer_costs_its_round_and_mixes_no_two(bench, listener) -> None:
    made = bench("robstride")
    frames, states = frames_of(made, 40)
    key = made.driver.drives[2].key
    answers = [k for k, m in enumerate(frames) if made.driver.drives[0].key_of(m) == key]
    del frames[answers[20]]
    ear = listener(made, frames)
    received = [ear.read() for _ in range(30)]
    assert ear.lost >= 1
    rounds = {s.tau.tobytes() for s in states} | {s.q.tobytes() for s in states}
    assert all(s.q.tobytes() in rounds for s in received[5:])
    assert np.max(np.diff([s.t_device for s in received[5:]])) > 1.5 / made.driver.rate


def test_a_drive_without_heartbeat_is_not_taken_for_one_that_is_on(bench, listener) -> None:
    made = bench("odrive")
    frames, _ = frames_of(made, 60)
    ear = listener(made, [m for m in frames if m.arbitration_id != made.driver.drives[2].servo.node << 5 | HEARTBEAT])
    with pytest.raises(DeviceError, match=r"not all drives have sent an answer"):
        ear.read()


def test_silence_names_who_answered(bench, listener) -> None:
    made = bench("robstride")
    frames, _ = frames_of(made, 10)
    key = made.driver.drives[2].key
    ear = listener(made, [m for m in frames if made.driver.drives[0].key_of(m) != key])
    with pytest.raises(DeviceError, match=r"not all drives have sent an answer.*start that program first"):
        ear.read()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"interface": "slcan", "channel": "/dev/none"}, "no second one can listen"),
        ({"interface": "virtual", "channel": "nothing"}, "cannot ask a drive for its ranges"),
    ],
)
def test_what_cannot_be_received_is_refused_before_the_bus_is_opened(servo6, options: dict, message: str) -> None:
    cell = cell_of("damiao", options=options)
    with pytest.raises(ConfigError, match=message):
        CanServo.from_cell(cell, servo6).listen()


def test_beside_a_commanding_program_over_socketcand(tmp_path, servo6) -> None:
    emulator, cell = started(wire_cell("socketcand", tmp_path), servo6)
    rest = np.array(cell.table.rest)
    commanding = CanServo.from_cell(cell, servo6)
    own: list[JointState] = []

    def command() -> None:
        own.extend(swing(commanding, rest, 1, k=k) for k in range(45))

    at_work = threading.Thread(target=command)
    try:
        commanding.connect()
        listening = CanServo.from_cell(stating_ranges(cell, commanding), servo6)
        at_work.start()
        listening.listen()
        received = [listening.read() for _ in range(10)]
        with pytest.raises(DeviceError, match="connect first"):
            listening.send(rest, np.zeros(6), np.zeros(6))
        listening.close()
    finally:
        at_work.join()
        commanding.release()
        emulator.stop()
    known = {s.q.tobytes() for s in own}
    assert all(s.q.tobytes() in known for s in received)


def stating_ranges(cell: Cell, driver: CanServo) -> Cell:
    """The cell with the ranges that the drives have reported."""
    servos = [
        {**servo, "ranges": d.ranges.model_dump()} for servo, d in zip(cell.table.options["servos"], driver.drives, strict=True)
    ]
    table = cell.table.model_copy(update={"options": {**cell.table.options, "servos": servos}})
    return dataclasses.replace(cell, table=table)


def test_who_listened_brakes_and_holds_the_arm_in_place_of_a_program_that_is_gone(tmp_path, servo6) -> None:
    emulator, cell = started(wire_cell("socketcand", tmp_path), servo6)
    rest = np.array(cell.table.rest)
    commanding = CanServo.from_cell(cell, servo6)
    at_work = threading.Thread(target=swing, args=(commanding, rest, 20))
    try:
        commanding.connect()
        listening = CanServo.from_cell(stating_ranges(cell, commanding), servo6)
        assert listening.beside() == ""
        assert listening.sole
        at_work.start()
        listening.listen()
        while at_work.is_alive():
            last = listening.read()
        # the program is gone, and so is its holder; without commands the drives would switch off after WATCHDOG
        commanding._holder.release()
        assert commanding.link is not None
        commanding.link.close()
        listening.halt()
        time.sleep(3 * WATCHDOG)
        assert emulator.bus.body.live.all()
        with pytest.raises(DeviceError, match="it is held"):
            listening.close()
        time.sleep(3 * WATCHDOG)
        assert emulator.bus.body.live.all()
        assert np.max(np.abs(emulator.bus.body.plant.read().q - last.q)) < 0.1
        listening.release()
        assert not emulator.bus.body.live.any()
    finally:
        at_work.join()
        emulator.stop()


def test_who_has_heard_nothing_does_not_command(tmp_path, servo6) -> None:
    with pytest.raises(DeviceError, match="no answers of the drives"):
        CanServo.from_cell(wire_cell("socketcand", tmp_path), servo6).halt()


@pytest.mark.parametrize(
    ("interface", "why"), [("slcan", "no second one can listen"), ("virtual", "one process"), ("socketcand", "ranges")]
)
def test_why_a_second_program_cannot_hear_a_bus(tmp_path, servo6, interface: str, why: str) -> None:
    assert why in CanServo.from_cell(wire_cell(interface, tmp_path), servo6).beside()


def test_a_bus_that_never_runs_empty_is_not_read_for_ever() -> None:
    clock = SimulatedClock()

    class Crowded:
        state = can.BusState.ACTIVE

        def recv(self, wait: float) -> can.Message:
            clock.sleep_until(clock.now() + 1e-3)
            return can.Message(arbitration_id=0x7FF, is_extended_id=False)

    link = Link(Crowded(), clock, "crowded")  # type: ignore[arg-type]
    count = 0
    while link.receive(0.5) is not None:
        count += 1
        assert count < 20_000
    assert count >= 500, "what comes in time is read"
    assert clock.now() <= 0.5 + 2 * CROWDED
