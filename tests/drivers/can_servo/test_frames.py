"""The integer codecs agree with the DBC files, which any CAN tool can open."""

from __future__ import annotations

import math

import cantools
import numpy as np
import pytest

from drivers.can_servo import frames
from drivers.can_servo.scaling import Field
from sim.errors import DeviceError
from sim.resources import shipped_configs

COUNTS = [pytest.param(2000, id="2000"), pytest.param(100_000, id="100000", marks=pytest.mark.slow)]
MIT = {"damiao": (12.5, 30.0, 10.0), "cubemars": (12.5, 8.0, 144.0)}
RS03 = (12.57, 20.0, 60.0, 5000.0, 100.0)


def dbc(name):
    return cantools.database.load_file(shipped_configs() / "can" / f"{name}.dbc", strict=True)


def mit_fields(q_max, dq_max, tau_max):
    return (
        Field("Position", -q_max, q_max, 16, "rad"),
        Field("Velocity", -dq_max, dq_max, 12, "rad/s"),
        Field("Kp", 0.0, 500.0, 12, "N*m/rad"),
        Field("Kd", 0.0, 5.0, 12, "N*m*s/rad"),
        Field("Torque", -tau_max, tau_max, 12, "N*m"),
    )


def drawn(fields, count, seed):
    """Random values over each whole range, including both ends."""
    low, high = np.array([[f.low, f.high] for f in fields]).T
    x = np.random.default_rng(seed).uniform(low, high, (count, len(fields)))
    x[0], x[1] = low, high
    return x.tolist()


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("family", MIT)
def test_mit_frames_equal_the_dbc(family, count):
    fields = mit_fields(*MIT[family])
    command, feedback = dbc(family).get_message_by_name("MitCommand"), dbc(family).get_message_by_name("Feedback")
    q, dq, _, _, tau = fields
    for x in drawn(fields, count, seed=1):
        data = frames.mit_command(*(f.raw(v) for f, v in zip(fields, x, strict=True)))
        assert data == command.encode({f.name: v for f, v in zip(fields, x, strict=True)})
    for data in np.random.default_rng(2).integers(0, 256, (count, 8), dtype=np.uint8):
        decoded = feedback.decode(data.tobytes(), decode_choices=False)
        raw = frames.mit_state(data.tobytes())
        values = [f.value(r) for f, r in zip((q, dq, tau), raw, strict=True)]
        assert values == pytest.approx([decoded["Position"], decoded["Velocity"], decoded["Torque"]], abs=1e-12)


@pytest.mark.parametrize("count", COUNTS)
def test_robstride_frames_equal_the_dbc(count):
    q_max, dq_max, tau_max, kp_max, kd_max = RS03
    fields = (
        Field("Position", -q_max, q_max, 16, "rad"), Field("Velocity", -dq_max, dq_max, 16, "rad/s"),
        Field("Kp", 0.0, kp_max, 16, "N*m/rad"), Field("Kd", 0.0, kd_max, 16, "N*m*s/rad"),
    )  # fmt: skip
    torque = Field("Torque", -tau_max, tau_max, 16, "N*m")
    command, feedback = dbc("robstride").get_message_by_name("MotionCommand"), dbc("robstride").get_message_by_name("Feedback")
    for x in drawn(fields, count, seed=3):
        data = frames.four_words(*(f.raw(v) for f, v in zip(fields, x, strict=True)))
        assert data == command.encode({f.name: v for f, v in zip(fields, x, strict=True)})
    for data in np.random.default_rng(4).integers(0, 256, (count, 8), dtype=np.uint8):
        decoded = feedback.decode(data.tobytes())
        a, b, c, d = frames.unpack_four_words(data.tobytes())
        values = [fields[0].value(a), fields[1].value(b), torque.value(c), d / 10]
        assert values == pytest.approx([decoded[k] for k in ("Position", "Velocity", "Torque", "Temperature")], abs=1e-9)


@pytest.mark.parametrize("count", COUNTS)
def test_odrive_frames_equal_the_dbc(count):
    command, estimates = (
        dbc("odrive").get_message_by_name("SetInputPosition"),
        dbc("odrive").get_message_by_name("EncoderEstimates"),
    )
    rng = np.random.default_rng(5)
    for q, dq, tau in zip(rng.normal(0, 20, count).tolist(), *rng.integers(-32768, 32768, (2, count)).tolist(), strict=True):
        data = frames.position_command(q, dq, tau)
        assert data == command.encode({"Position": q, "Velocity": dq * 0.001, "Torque": tau * 0.001}, strict=False)
    for q, dq in rng.normal(0, 20, (count, 2)).astype(np.float32).tolist():
        data = estimates.encode({"Position": q, "Velocity": dq})
        assert frames.two_floats(data) == (q, dq)


@pytest.mark.parametrize("count", COUNTS)
def test_register_and_parameter_frames_equal_the_dbc(count):
    damiao, robstride, odrive = dbc("damiao"), dbc("robstride"), dbc("odrive")
    rng = np.random.default_rng(6)
    for node, order, number, value in zip(
        rng.integers(0, 2048, count).tolist(), rng.integers(0, 256, count).tolist(), rng.integers(0, 256, count).tolist(),
        rng.integers(0, 2**32, count).tolist(), strict=True,
    ):  # fmt: skip
        data = frames.register(node, order, number, value)
        names = {"Node": node, "Order": order, "Register": number, "Value": value}
        assert data == damiao.get_message_by_name("RegisterRequest").encode(names)
        assert frames.register_reply(data) == (node, order, number, value)
        index = node | order << 8
        data = frames.parameter(index, value)
        assert data == robstride.get_message_by_name("ReadParameter").encode({"Index": index, "Value": value})
        assert frames.unpack_parameter(data) == (index, value)
        beat = {"AxisError": value, "AxisState": number, "ProcedureResult": order, "TrajectoryDone": 1}
        assert frames.heartbeat(odrive.get_message_by_name("Heartbeat").encode(beat)) == (value, number, order, 1)


def test_golden_vectors_of_the_vendors():
    """Bytes printed in manuals and drivers, independent of this code."""
    # RobStride RS03 manual, "Read example": loc_kp (0x701E) is requested, the drive answers 30.0
    assert frames.parameter(0x701E) == bytes.fromhex("1E70000000000000")
    index, raw = frames.unpack_parameter(bytes.fromhex("1E7000000000F041"))
    assert (index, frames.as_float(raw)) == (0x701E, 30.0)
    # Damiao and CubeMars: enable, as every driver sends it
    assert frames.special(0xFC) == bytes.fromhex("FFFFFFFFFFFFFFFC")
    # Damiao, openarm_can create_query_param_command(motor 1, TMAX)
    assert frames.register(1, 0x33, 23) == bytes.fromhex("0100331700000000")
    # CubeMars manual: all-zero command is 7FFF 7FF 000 000 7FF because its code truncates; it decodes to half a step below zero
    q, dq, _, _, tau = mit_fields(*MIT["cubemars"])
    raw = (0x7FFF, 0x7FF, 0x7FF)
    assert frames.mit_state(bytes.fromhex("017FFF7FF7FF")) == raw
    for field, r in zip((q, dq, tau), raw, strict=True):
        assert field.value(r) == pytest.approx(-field.factor / 2, rel=1e-9)
        assert field.raw(0.0) - r in (0, 1)


def test_nothing_is_clamped():
    field = Field("torque", -10.0, 10.0, 12, "N*m")
    assert (field.raw(-10.0), field.raw(10.0)) == (0, 4095)
    for x in (math.nextafter(10.0, 11.0), -10.1, math.inf, -math.inf, math.nan):
        with pytest.raises(DeviceError, match=r"cannot be sent"):
            field.raw(x)
    with pytest.raises(DeviceError, match=r"is empty"):
        Field("torque", 0.0, 0.0, 12, "N*m")
    with pytest.raises(DeviceError, match=r"is empty"):
        Field("torque", -math.nan, math.nan, 12, "N*m")


def test_quantisation_is_half_a_step_at_most():
    for field in mit_fields(12.5, 30.0, 10.0):
        x = np.random.default_rng(7).uniform(field.low, field.high, 1000)
        back = np.array([field.value(field.raw(v)) for v in x.tolist()])
        assert np.max(np.abs(back - x)) <= field.factor / 2 * (1 + 1e-9)
