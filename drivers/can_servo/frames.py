"""Byte layouts of the servo frames, as fast integer shifts; tests verify that they equal configs/can/*.dbc.

Every function takes and returns raw integers; `scaling.Field` turns them into radians and newton metres.
"""

from __future__ import annotations

import struct

_POSITION_COMMAND = struct.Struct("<fhh")
_TWO_FLOATS = struct.Struct("<ff")
_FOUR_WORDS = struct.Struct(">HHHH")
_PARAMETER = struct.Struct("<HxxI")
_REGISTER = struct.Struct("<HBBI")
_HEARTBEAT = struct.Struct("<IBBBx")


def mit_command(q: int, dq: int, kp: int, kd: int, tau: int) -> bytes:
    """MitCommand of damiao.dbc and cubemars.dbc: q16 dq12 kp12 kd12 tau12, most significant bit first."""
    return (q << 48 | dq << 36 | kp << 24 | kd << 12 | tau).to_bytes(8, "big")


def mit_state(data: bytes) -> tuple[int, int, int]:
    """q16, dq12, tau12 of a Feedback of damiao.dbc and cubemars.dbc; in bytes 1 to 5."""
    word = int.from_bytes(data[1:6], "big")
    return word >> 24, word >> 12 & 0xFFF, word & 0xFFF


def special(order: int) -> bytes:
    """Special of damiao.dbc and cubemars.dbc: seven bytes FF and the order."""
    return b"\xff\xff\xff\xff\xff\xff\xff" + bytes((order,))


def register(node: int, order: int, number: int, value: int = 0) -> bytes:
    """RegisterRequest of damiao.dbc."""
    return _REGISTER.pack(node, order, number, value)


def register_reply(data: bytes) -> tuple[int, int, int, int]:
    """node, order, register number, raw value of a RegisterReply of damiao.dbc."""
    return _REGISTER.unpack(data)


def four_words(a: int, b: int, c: int, d: int) -> bytes:
    """MotionCommand of robstride.dbc: q16 dq16 kp16 kd16."""
    return _FOUR_WORDS.pack(a, b, c, d)


def unpack_four_words(data: bytes) -> tuple[int, int, int, int]:
    """Feedback of robstride.dbc: q16 dq16 tau16 and ten times the temperature."""
    return _FOUR_WORDS.unpack(data)


def parameter(index: int, value: int = 0) -> bytes:
    """ReadParameter and WriteParameter of robstride.dbc."""
    return _PARAMETER.pack(index, value)


def unpack_parameter(data: bytes) -> tuple[int, int]:
    """index and raw value of a ParameterReply of robstride.dbc."""
    return _PARAMETER.unpack(data)


def position_command(revolutions: float, millirev_per_s: int, millinewton_metre: int) -> bytes:
    """SetInputPosition of odrive.dbc; the two feed-forwards in steps of 0.001."""
    return _POSITION_COMMAND.pack(revolutions, millirev_per_s, millinewton_metre)


def two_floats(data: bytes) -> tuple[float, float]:
    """EncoderEstimates, Iq, Temperature and Torques of odrive.dbc."""
    return _TWO_FLOATS.unpack(data)


def heartbeat(data: bytes) -> tuple[int, int, int, int]:
    """error bits, state, procedure result and trajectory flag of a Heartbeat of odrive.dbc."""
    return _HEARTBEAT.unpack(data)


def as_float(raw: int) -> float:
    """The IEEE 754 single whose bits are `raw`."""
    return struct.unpack("<f", raw.to_bytes(4, "little"))[0]  # type: ignore[no-any-return]


def float_bits(value: float) -> int:
    """The bits of an IEEE 754 single."""
    return int.from_bytes(struct.pack("<f", value), "little")
