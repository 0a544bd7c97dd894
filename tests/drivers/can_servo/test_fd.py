"""CAN FD: the same drives with a data bit rate, in memory and over the bytes of an adapter; several makers on one bus."""

from __future__ import annotations

import dataclasses

import can
import numpy as np
import pytest

from drivers.can_servo.bus_budget import frame_time
from drivers.can_servo.driver import CanServo
from drivers.can_servo.link import Link
from sim.can_wiring import can_options
from sim.clock import MonotonicClock
from sim.errors import ConfigError, DeviceError
from tests.drivers.can_servo.conftest import cell_of
from tests.drivers.can_servo.test_wire import started, swing, wire_cell

FAST = 5_000_000


def test_fd_frames_are_shorter_by_what_the_data_gain():
    assert frame_time(False, 8, 1_000_000, None) == pytest.approx((111e-6, 135e-6))
    shortest, longest = frame_time(False, 8, 1_000_000, FAST)
    assert shortest == pytest.approx(30e-6 + 96 / FAST)
    assert 50e-6 < longest < 60e-6


def test_an_fd_arm_swings_and_its_frames_are_fd(bench):
    b = bench(options={"data_bitrate": FAST, "rate": 500.0})
    b.driver.connect()
    assert b.driver.budget.load_worst < 0.4
    b.stream(60)
    assert all(m.is_fd and m.bitrate_switch for _, m in b.bus.received)
    assert b.driver.read().q == pytest.approx(b.bus.body.plant.read().q, abs=5e-3)


def test_a_classical_drive_on_an_fd_bus_says_so_in_its_servo(bench):
    servos = [dict(s) for s in cell_of("damiao").table.options["servos"]]
    servos[2]["fd"] = False
    b = bench(options={"data_bitrate": FAST, "servos": servos})
    assert [s.fd for s in b.bus.servos] == [True, True, False, True, True, True]
    b.driver.connect()
    b.stream(20)
    kinds = {(m.arbitration_id, m.is_fd) for _, m in b.bus.received if m.arbitration_id < 16}
    assert kinds == {(node, node != 3) for node in range(1, 7)}


def test_fd_drives_on_a_classical_bus_are_guessed_from_the_errors(bench):
    b = bench()
    for servo in b.bus.servos:
        servo.fd = True
    with pytest.raises(DeviceError, match=r"no answer .* 3 error frames instead .a drive that speaks CAN FD"):
        b.driver.connect()


def test_fd_needs_an_interface_and_a_drive_that_know_it(servo6, tmp_path):
    cell = wire_cell("socketcand", tmp_path)
    emulator, cell = started(cell, servo6)
    options = can_options(cell, servo6).model_copy(update={"data_bitrate": FAST})
    with pytest.raises(DeviceError, match="does not carry CAN FD"):
        Link.open(options, MonotonicClock())
    emulator.stop()
    cell = cell_of("robstride", options={"data_bitrate": FAST})
    for servo in cell.table.options["servos"]:
        servo["fd"] = True
    with pytest.raises(ConfigError, match=r"fd = true; that needs data_bitrate .* this one is robstride"):
        can_options(cell, servo6)


def test_candle_light_adapters(servo6, monkeypatch, tmp_path):
    """python-can's gs_usb takes the adapter's number as an integer.

    Linux has its own driver for these adapters, which the refusal names.
    """
    options = can_options(wire_cell("virtual", tmp_path), servo6).model_copy(update={"interface": "gs_usb", "channel": "1"})
    opened = {}

    def bus(**arguments):
        opened.update(arguments)
        raise ImportError("No module named 'usb'")

    monkeypatch.setattr(can, "Bus", bus)
    with pytest.raises(
        DeviceError, match=r'interface = "socketcan", channel = "can0"; elsewhere install "python-can\[gs_usb\]"'
    ):
        Link.open(options, MonotonicClock())
    assert (opened["interface"], opened["index"], opened["bitrate"]) == ("gs_usb", 1, 1_000_000)
    with pytest.raises(
        ConfigError, match=r"python-can has no interface of that name.*Candle-light adapters: on Linux the kernel drives"
    ):
        Link.open(options.model_copy(update={"interface": "candle"}), MonotonicClock())


@pytest.mark.parametrize("interface", ["slcan", "virtual"])
def test_fd_over_the_wire(interface, tmp_path, servo6):
    cell = wire_cell(interface, tmp_path)
    cell = dataclasses.replace(
        cell, table=cell.table.model_copy(update={"options": {**cell.table.options, "data_bitrate": FAST}})
    )
    emulator, cell = started(cell, servo6)
    driver = CanServo.from_cell(cell, servo6)
    rest = np.array(cell.table.rest)
    try:
        driver.connect()
        assert driver.link.bus.protocol is can.CanProtocol.CAN_FD
        swing(driver, rest, 51)
        assert all(m.is_fd for _, m in emulator.bus.received)
    finally:
        driver.release()
        emulator.stop()


def test_three_makers_on_one_bus(bench):
    b = bench("mixed")
    info = b.driver.connect()
    assert info.model == "6 damiao and odrive and robstride drives"
    b.stream(100)
    assert b.driver.read().q == pytest.approx(b.bus.body.plant.read().q, abs=0.01)
    b.bus.inject("silent:wrist_2_joint")
    with pytest.raises(DeviceError, match=r"wrist_2_joint.*silent"):
        b.stream(20)


def test_a_servo_without_any_protocol_is_named(servo6):
    cell = cell_of("damiao")
    options = {k: v for k, v in cell.table.options.items() if k != "protocol"}
    with pytest.raises(ConfigError, match="servo of shoulder_pan_joint has no protocol"):
        can_options(dataclasses.replace(cell, table=cell.table.model_copy(update={"options": options})), servo6)
