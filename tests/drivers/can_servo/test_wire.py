"""The same driver over real bytes: serial adapters on a pseudo-terminal, socketcand over TCP, python-can's virtual bus.

The wall clock runs here; at 25 Hz a loaded computer has 120 ms before three periods are over.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import socket
import time

import can
import numpy as np
import pytest

from drivers.can_servo.driver import CanServo
from drivers.can_servo.lawicel import LawicelBus
from drivers.can_servo.service import Service
from sim.cell import load_cell
from sim.emulated import open_emulator
from sim.errors import DeviceError

WATCHDOG = 0.3


def wire_cell(interface, tmp_path):
    cell = load_cell("emulated-servo6")
    where = {
        "slcan": {"interface": "slcan", "channel": str(tmp_path / "adapter.tty")},
        "damiao": {"interface": "damiao", "channel": str(tmp_path / "box.tty")},
        "socketcand": {"interface": "socketcand", "channel": "can0", "bus": {"host": "127.0.0.1", "port": 0, "tcp_tune": True}},
        "virtual": {"interface": "virtual", "channel": f"servo6-{os.getpid()}-{time.monotonic_ns()}"},
    }[interface]
    options = {**cell.table.options, **where, "rate": 25.0, "watchdog": WATCHDOG}
    return dataclasses.replace(cell, table=cell.table.model_copy(update={"options": options}))


def started(cell, arm):
    """The running emulator, and the cell with the port that it got if port 0 was requested."""
    emulator = open_emulator(cell, arm)
    emulator.start()
    if cell.table.options["interface"] == "socketcand":
        bus = {**cell.table.options["bus"], "port": emulator.port.address[1]}
        cell = dataclasses.replace(cell, table=cell.table.model_copy(update={"options": {**cell.table.options, "bus": bus}}))
    return emulator, cell


@pytest.fixture(params=["slcan", "damiao", "socketcand", "virtual"])
def wire(request, tmp_path, servo6):
    emulator, cell = started(wire_cell(request.param, tmp_path), servo6)
    driver = CanServo.from_cell(cell, servo6)
    yield emulator, driver, np.array(cell.table.rest)
    driver.release()
    emulator.stop()


def swing(driver, rest, cycles, k=0):
    for i in range(k, k + cycles):
        q = rest + 0.1 * (1 - np.cos(2 * np.pi * 0.5 * i / driver.rate)) / 2
        driver.send(q, np.full(6, 0.1 * np.pi * 0.5 * np.sin(2 * np.pi * 0.5 * i / driver.rate)), np.zeros(6))
        state = driver.read()
    return state


def test_the_arm_swings_over_the_wire_and_is_let_go_at_rest(wire):
    emulator, driver, rest = wire
    with driver:
        assert driver.info.serial.startswith("410001, 410002")
        state = swing(driver, rest, 25)
        assert np.max(np.abs(state.q - rest - 0.1)) < 0.05
        swing(driver, rest, 26, k=25)
    assert not emulator.bus.body.live.any()


@pytest.mark.parametrize(("interface", "fault", "message"), [
    ("slcan", "silent:elbow_joint", "elbow_joint.*silent"),
    ("slcan", "bus-off", "bus-off"),
    ("slcan", "tx-full", "queue is full"),
    ("slcan", "unplugged", "unplugged|sending failed"),
    ("damiao", "unplugged", "unplugged|sending failed"),
    ("damiao", "silent:elbow_joint", "elbow_joint.*silent"),
    ("socketcand", "error-frames", "error frames"),
    ("socketcand", "tx-full", "silent"),
])  # fmt: skip
def test_a_fault_on_the_wire_ends_the_motion_and_nothing_old_follows(interface, fault, message, tmp_path, servo6):
    emulator, cell = started(wire_cell(interface, tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    driver.connect()
    try:
        swing(driver, rest, 5)
        emulator.inject(fault)
        with pytest.raises(DeviceError, match=message):
            swing(driver, rest, 60, k=5)
        time.sleep(WATCHDOG + 0.3)
        arrived = emulator.bus.arrived
        emulator.inject("restore")
        time.sleep(0.2)
        if "silent:" not in fault:
            # The host cannot recall what a TCP server has already taken; the drives' watchdogs have made it harmless.
            assert emulator.bus.arrived == arrived or interface == "socketcand"
            assert not emulator.bus.body.live.any()
        with pytest.raises(DeviceError, match=r"latched"):
            driver.send(rest, np.zeros(6), np.zeros(6))
    finally:
        with contextlib.suppress(DeviceError):
            driver.release()
        emulator.stop()


def test_an_arm_away_from_rest_is_held_after_the_motion_has_ended(tmp_path, servo6):
    emulator, cell = started(wire_cell("virtual", tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    driver.connect()
    try:
        swing(driver, rest, 25)
        with pytest.raises(DeviceError, match=r"it is held"):
            driver.close()
        before = emulator.bus.arrived
        time.sleep(2 * WATCHDOG)
        assert emulator.bus.arrived > before
        assert emulator.bus.body.live.all()
    finally:
        with contextlib.suppress(DeviceError):
            driver.release()
        emulator.stop()
    assert not emulator.bus.body.live.any()


def test_a_pause_of_the_program_is_a_stop_and_not_a_fall(tmp_path, servo6):
    emulator, cell = started(wire_cell("virtual", tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    driver.connect()
    try:
        swing(driver, rest, 10)
        time.sleep(3 * WATCHDOG)
        assert emulator.bus.body.live.all()
        held = driver.read()
        assert held.detail == "holding"
        assert np.max(np.abs(held.dq)) < 0.05
        with pytest.raises(DeviceError, match=r"begin where the arm stands"):
            driver.send(held.q + 0.1, np.zeros(6), np.zeros(6))
        driver.send(held.q, np.zeros(6), np.zeros(6))
        assert driver.read().detail == ""
    finally:
        driver.release()
        emulator.stop()


def test_drives_are_looked_at_over_the_wire(tmp_path, servo6):
    emulator, cell = started(wire_cell("slcan", tmp_path), servo6)
    try:
        with Service.from_cell(cell, servo6) as service:
            assert service.look("wrist_3_joint").identity.serial == "410006"
    finally:
        emulator.stop()


def test_an_adapter_that_is_not_there_is_one_sentence(tmp_path, servo6):
    cell = wire_cell("slcan", tmp_path)
    with pytest.raises(DeviceError, match=r"cannot be opened.*plug the adapter in"):
        CanServo.from_cell(cell, servo6).connect()
    options = {**cell.table.options, "channel": str(tmp_path / "emulated-arm.tty")}
    cell = dataclasses.replace(cell, table=cell.table.model_copy(update={"options": options}))
    with pytest.raises(DeviceError, match=r"cannot be opened.*start `calib emulate CELL`"):
        CanServo.from_cell(cell, servo6).connect()


@pytest.fixture
def terminal(tmp_path):
    """A LawicelBus and the other end of its line."""
    master, slave = os.openpty()
    bus = LawicelBus(os.ttyname(slave), bitrate=1_000_000, sleep_after_open=0.0)
    yield bus, master
    bus.shutdown()
    os.close(master)
    os.close(slave)


def test_serial_bytes_are_read_as_they_come(terminal):
    bus, master = terminal
    os.write(master, b"\r\rz\rt01180102030405")
    assert bus.recv(0.05) is None
    os.write(master, b"060708\rT1800FD7F8" + b"00" * 8 + b"\r")
    first, second = bus.recv(1.0), bus.recv(1.0)
    assert (first.arbitration_id, first.is_extended_id, bytes(first.data)) == (0x11, False, bytes(range(1, 9)))
    assert (second.arbitration_id, second.is_extended_id) == (0x1800FD7F, True)


@pytest.mark.parametrize(
    "damaged", [b"t0118010203\r", b"t011901\r", b"tZZZ801\r", b"t01181122334455667788FF\r", b"garbage\r", b"t\r"]
)
def test_damaged_serial_lines_are_no_frames(terminal, damaged):
    bus, master = terminal
    os.write(master, damaged + b"t01110A\r")
    message = bus.recv(1.0)
    assert (message.arbitration_id, bytes(message.data)) == (0x11, b"\x0a")


def test_refusals_and_status_of_the_adapter_are_noticed(terminal):
    bus, master = terminal
    bus.ask_status()
    os.write(master, b"\a\aF20\r")
    assert bus.recv(0.05) is None
    assert bus.refused == 2
    assert bus.state is can.bus.BusState.PASSIVE
    os.write(master, b"FA4\r")
    assert bus.recv(0.05) is None
    assert bus.state is can.bus.BusState.ERROR


def test_a_serial_frame_is_what_the_adapter_expects(terminal):
    bus, master = terminal
    os.set_blocking(master, False)
    time.sleep(0.05)
    os.read(master, 4096)
    bus.send(can.Message(arbitration_id=0x7FF, data=bytes([1, 0, 0x33, 21, 0, 0, 0, 0]), is_extended_id=False))
    bus.send(can.Message(arbitration_id=0x1100FD7F, data=bytes.fromhex("1E70000000000000"), is_extended_id=True))
    time.sleep(0.05)
    assert os.read(master, 4096) == b"t7FF80100331500000000\rT1100FD7F81E70000000000000\r"


def test_a_missing_socketcand_server_is_one_sentence(servo6, tmp_path, caplog, capfd):
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    cell = wire_cell("socketcand", tmp_path)
    bus = {**cell.table.options["bus"], "port": port}
    cell = dataclasses.replace(cell, table=cell.table.model_copy(update={"options": {**cell.table.options, "bus": bus}}))
    with pytest.raises(DeviceError, match=f"no server at 127.0.0.1:{port} .*; start socketcand there"):
        CanServo.from_cell(cell, servo6).connect()
    assert not caplog.records
    assert capfd.readouterr() == ("", "")
