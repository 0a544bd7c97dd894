"""Foreign frames on the bus neither crash a protocol nor keep a braking frame from the drives."""

from __future__ import annotations

import contextlib
import math
from types import SimpleNamespace
from typing import Any

import can
import numpy as np
import pytest

from drivers.can_servo.bring_up import PROTOCOLS
from drivers.can_servo.damiao import READ, REGISTERS, Damiao
from drivers.can_servo.drive import DriveReading, NoAnswer
from drivers.can_servo.frames import register
from drivers.can_servo.odrive import ADDRESS, CLOSED_LOOP, ESTIMATES, HEARTBEAT, TEMPERATURE, TORQUES, TX_SDO, VERSION, ODrive
from drivers.can_servo.service import Service
from drivers.can_servo.stream import Stream
from sim.can_wiring import CanOptions, RangeTable, ServoTable
from sim.errors import DeviceError

RANGES = RangeTable(q=12.5, dq=30.0, tau=10.0)


def options(protocol: str, **more: Any) -> CanOptions:
    table = {"interface": "virtual", "channel": "x", "protocol": protocol, "rate": 100.0, "brakes": False, "servos": []}
    return CanOptions(**(table | more))


def drive(protocol: str) -> Any:
    servo = ServoTable(joint="j", protocol=protocol, node=1, feedback=0x11, kp=10.0, kd=1.0, ranges=RANGES)
    return PROTOCOLS[protocol](servo, options(protocol))


@pytest.mark.parametrize("protocol", sorted(PROTOCOLS))
def test_a_remote_frame_is_no_answer_of_any_protocol(protocol: str) -> None:
    kind = PROTOCOLS[protocol]
    for extended in (False, True):
        for identifier in (0x1, 0x11, 0x7FF, 1 << 8 | 0xFD, 1 << 8 | 0xFE):
            for length in (0, 6, 8):
                frame = can.Message(
                    arbitration_id=identifier, is_extended_id=extended, is_remote_frame=True, dlc=length, check=False
                )
                assert kind.key_of(frame) is None
                assert kind.answering(frame) is None


@pytest.mark.parametrize(
    "foreign",
    [
        [can.Message(arbitration_id=0x5, is_extended_id=False, data=bytes(8))] * 20,
        [can.Message(arbitration_id=0x1, is_extended_id=False, data=bytes(8))],
        [can.Message(arbitration_id=0x11, is_extended_id=False, is_remote_frame=True, dlc=8)] * 3,
    ],
    ids=["babbling node", "second host", "remote frames"],
)
def test_an_arm_that_is_held_gets_its_frame_whatever_is_on_the_bus(foreign: list[can.Message]) -> None:
    now, sent, waiting = [0.0], list[can.Message](), list[can.Message]()
    link = SimpleNamespace(receive=lambda until: waiting.pop(0) if waiting else None, where="x", failed="", send=sent.extend)
    clock = SimpleNamespace(now=lambda: now[0], sleep_until=lambda t: None)
    still: Any = type("Still", (), {"__call__": lambda s, q, dq, t: np.zeros(1), "hold": lambda s, q: np.zeros(1)})()
    stream = Stream("arm", [drive("damiao")], link, clock, options("damiao"), still)  # type: ignore[arg-type]
    stream._target.follow(np.zeros(1), np.array([0.5]), np.zeros(1), 0.0)
    stream.on = True
    for _ in range(50):
        waiting.extend(foreign)
        with contextlib.suppress(DeviceError):
            stream.hold()
        now[0] += 0.01
    assert len(sent) == 50


BY_OFF = "answers only the order off, .* then add --supported"


@pytest.mark.parametrize(
    ("protocol", "refusal"), [("cubemars", BY_OFF), ("old damiao", BY_OFF), ("robstride", "nobody is there")]
)
def test_a_drive_that_answers_the_order_off_alone_is_not_asked_on_an_arm_without_brakes(protocol: str, refusal: str) -> None:
    one = drive(protocol.split()[-1])
    if isinstance(one, Damiao):
        one.answers_refresh = False
    off, asked = one.disable(), list[can.Message]()

    def ask(message: can.Message, reply: Any, what: str) -> Any:
        asked.append(message)
        raise NoAnswer("nobody is there")

    service = Service(options("damiao"), None, None)  # type: ignore[arg-type]
    service.drives, service._enquiry = [one], SimpleNamespace(ask=ask)  # type: ignore[assignment]
    for order in (lambda: service.look("j"), lambda: service.do("j", "off"), lambda: service.do("j", "zero")):
        with pytest.raises(DeviceError, match=refusal):
            order()
    assert not any(m.arbitration_id == off.arbitration_id and m.data == off.data for m in asked)
    with pytest.raises(DeviceError, match=r"nobody is there"):
        service.look("j", supported=True)


@pytest.mark.parametrize(("node", "own"), [(1, True), (2, False), (0x101, False)])
def test_a_register_request_commands_the_drive_that_it_names(node: int, own: bool) -> None:
    request = can.Message(arbitration_id=REGISTERS, is_extended_id=False, data=register(node, READ, 8))
    assert drive("damiao").is_command(request) is own


def after(one: ODrive, command: int, data: bytes, late: float) -> DriveReading:
    """The reading `late` s after a message."""
    for number, content, now in ((command, data, 5.0), (TORQUES, bytes(8), 5.0), (ESTIMATES, bytes(8), 5.0 + late)):
        reading = one.decode(can.Message(arbitration_id=1 << 5 | number, is_extended_id=False, data=content), now)
    assert reading is not None
    return reading


@pytest.mark.parametrize(("late", "on"), [(0.0, True), (0.29, True), (0.31, None), (math.nan, None), (math.inf, None)])
def test_what_a_heartbeat_tells_counts_for_three_of_its_periods(late: float, on: bool | None) -> None:
    one = drive("odrive")
    reading = after(one, HEARTBEAT, bytes((0, 0, 0, 0, CLOSED_LOOP, 0, 0, 0)), late)
    assert reading.on is on
    assert one.says(reading, True) is bool(on)
    assert not one.says(reading, False)


@pytest.mark.parametrize(
    ("pair", "hottest"), [((float("nan"), 95.0), 95.0), ((95.0, float("nan")), 95.0), ((40.0, 30.0), 40.0)]
)
def test_a_temperature_that_is_not_reported_hides_no_other(pair: tuple[float, float], hottest: float) -> None:
    assert after(drive("odrive"), TEMPERATURE, np.array(pair, dtype="<f4").tobytes(), 0.0).temperature == hottest


@pytest.mark.parametrize(("late", "reported"), [(2.9, True), (3.1, False), (math.nan, False)])
def test_a_temperature_counts_for_three_seconds(late: float, reported: bool) -> None:
    assert math.isnan(after(drive("odrive"), TEMPERATURE, bytes(8), late).temperature) is not reported


@pytest.mark.parametrize("length", range(8))
@pytest.mark.parametrize("command", [HEARTBEAT, ESTIMATES, TEMPERATURE, TORQUES, VERSION, ADDRESS, TX_SDO])
def test_a_short_frame_of_an_odrive_is_no_answer(command: int, length: int) -> None:
    one, short = drive("odrive"), can.Message(arbitration_id=1 << 5 | command, is_extended_id=False, data=bytes(length))
    asked = []

    def ask(message: can.Message, reply: Any, what: str) -> Any:
        asked.append(reply(short))
        raise NoAnswer(what)

    assert one.key_of(short) is None
    assert one.answering(short) is None
    assert one.position_in(short) is None
    with pytest.raises(NoAnswer, match="heartbeat"):
        one.identify(ask)
    assert asked == [None] * 3


def test_a_mode_that_cannot_be_read_is_a_problem_and_no_mode() -> None:
    def ask(message: can.Message, reply: Any, what: str) -> Any:
        raise NoAnswer(what)

    problems = drive("damiao").describe(ask).problems
    assert any("its control mode cannot be read" in problem for problem in problems)
    assert not any("None" in problem for problem in problems)
