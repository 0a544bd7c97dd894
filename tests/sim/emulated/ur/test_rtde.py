from __future__ import annotations

import struct

import pytest

from sim.emulated.ur.frames import DATA, INPUTS, OUTPUTS, START, VERSION, FrameReader, Malformed, frame
from sim.emulated.ur.robot import Robot
from sim.emulated.ur.rtde import RtdeSession


def ask(session: RtdeSession, kind: int, payload: bytes) -> bytes:
    (reply,) = session.received(frame(kind, payload))
    ((answered, content),) = FrameReader().feed(reply)
    assert answered == kind
    return content


def outputs(frequency: float, names: str) -> bytes:
    return struct.pack(">d", frequency) + names.encode()


def test_only_protocol_version_2_is_supported(robot: Robot) -> None:
    assert ask(RtdeSession(robot), VERSION, b"\x00\x02") == b"\x01"
    assert ask(RtdeSession(robot), VERSION, b"\x00\x01") == b"\x00"


def test_outputs_are_packed_in_the_requested_order(robot: Robot) -> None:
    session = RtdeSession(robot)
    assert ask(session, OUTPUTS, outputs(500, "timestamp,actual_current,")) == b"\x01DOUBLE,VECTOR6D"
    assert session.due(1) is None, "nothing is sent before the start"
    assert ask(session, START, b"") == b"\x01"
    robot.step()
    ((kind, payload),) = FrameReader().feed(session.due(1) or b"")
    assert kind == DATA
    recipe, timestamp, *current = struct.unpack(">B7d", payload)
    assert (recipe, timestamp) == (1, robot.time)
    assert current == pytest.approx([0.05 * x for x in robot.actual_q])


def test_a_client_at_a_lower_rate_gets_every_nth_cycle(robot: Robot) -> None:
    session = RtdeSession(robot)
    ask(session, OUTPUTS, outputs(125, "timestamp"))
    ask(session, START, b"")
    assert [k for k in range(1, 13) if session.due(k)] == [4, 8, 12]


@pytest.mark.parametrize(
    ("version", "name", "found"),
    [
        ((5, 22, 0), "actual_current_as_torque", "NOT_FOUND"),
        ((5, 23, 0), "actual_current_as_torque", "VECTOR6D"),
        ((10, 10, 0), "actual_current_as_torque", "NOT_FOUND"),
        ((10, 11, 0), "actual_current_as_torque", "VECTOR6D"),
        ((3, 10, 0), "payload", "NOT_FOUND"),
        ((3, 11, 0), "payload", "DOUBLE"),
        ((5, 5, 0), "payload", "NOT_FOUND"),
        ((5, 5, 1), "payload", "DOUBLE"),
        ((3, 14, 0), "payload_inertia", "NOT_FOUND"),
        ((5, 25, 1), "no_such_variable", "NOT_FOUND"),
    ],
)
def test_variables_come_with_their_version(robot: Robot, version: tuple[int, int, int], name: str, found: str) -> None:
    robot.version = version
    session = RtdeSession(robot)
    reply = ask(session, OUTPUTS, outputs(125, name))
    assert reply[1:].decode() == found
    assert ask(session, START, b"") == bytes([found != "NOT_FOUND"])


def test_an_input_belongs_to_the_first_client_that_asks(robot: Robot) -> None:
    first, second = RtdeSession(robot), RtdeSession(robot)
    assert ask(first, INPUTS, b"input_int_register_0,") == b"\x01INT32"
    assert ask(first, INPUTS, b"input_int_register_0,input_double_register_0,") == b"\x02INT32,DOUBLE"
    assert ask(second, INPUTS, b"input_int_register_0,") == b"\x00IN_USE"
    first.closed()
    assert ask(second, INPUTS, b"input_int_register_0,") == b"\x01INT32"


def test_an_input_keeps_its_value_when_its_client_leaves(robot: Robot) -> None:
    session = RtdeSession(robot)
    ask(session, INPUTS, b"input_int_register_0,input_double_register_3,")
    ask(session, START, b"")
    assert session.received(frame(DATA, struct.pack(">Bid", 1, 11, 0.25))) == []
    session.closed()
    assert (robot.input_int[0], robot.input_double[3]) == (11, 0.25)


@pytest.mark.parametrize("data", [b"\x00\x02V", b"\x00\x04?\x00", frame(OUTPUTS, b"short"), b"\x00\x00\x00"])
def test_malformed_bytes_end_the_connection(robot: Robot, data: bytes) -> None:
    with pytest.raises(Malformed):
        RtdeSession(robot).received(data)


def test_frames_are_found_in_any_slicing_of_the_stream(robot: Robot) -> None:
    session = RtdeSession(robot)
    stream = frame(VERSION, b"\x00\x02") + frame(OUTPUTS, outputs(500, "timestamp"))
    replies = [reply for k in range(len(stream)) for reply in session.received(stream[k : k + 1])]
    assert len(replies) == 2
