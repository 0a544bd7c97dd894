"""CAN frame encoding and decoding compared with an independent implementation: differences and CPU time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import cantools
import numpy as np

from drivers.can_servo import frames
from drivers.can_servo.scaling import Field
from sim.resources import shipped_configs

FRAMES = 100_000
UNREACHABLE = ("error-frames", "error-passive", "bus-off", "tx-full", "unplugged")  # nothing is sent after these


def codec() -> list[dict[str, Any]]:
    """Command and feedback frames of every family, random over the full range, against cantools on the shipped DBC files."""
    rows = []
    for family, (q_max, dq_max, tau_max) in {"damiao": (12.5, 30.0, 10.0), "cubemars": (12.5, 8.0, 144.0)}.items():
        q, dq, tau = (
            Field("Position", -q_max, q_max, 16, ""),
            Field("Velocity", -dq_max, dq_max, 12, ""),
            Field("Torque", -tau_max, tau_max, 12, ""),
        )
        kp, kd = Field("Kp", 0.0, 500.0, 12, ""), Field("Kd", 0.0, 5.0, 12, "")
        rows += _encoding(family, "MitCommand", (q, dq, kp, kd, tau), frames.mit_command)
        rows += _decoding(family, (q, dq, tau), frames.mit_state)
    q, dq, tau = (
        Field("Position", -12.57, 12.57, 16, ""),
        Field("Velocity", -20.0, 20.0, 16, ""),
        Field("Torque", -60.0, 60.0, 16, ""),
    )
    kp, kd = Field("Kp", 0.0, 5000.0, 16, ""), Field("Kd", 0.0, 100.0, 16, "")
    rows += _encoding("robstride", "MotionCommand", (q, dq, kp, kd), frames.four_words)
    rows += _decoding("robstride", (q, dq, tau), lambda data: frames.unpack_four_words(data)[:3])
    return rows + _odrive()


def _message(family: str, name: str) -> Any:
    return cantools.database.load_file(shipped_configs() / "can" / f"{family}.dbc").get_message_by_name(name)


def _encoding(family: str, name: str, fields: tuple[Field, ...], encode: Callable[..., bytes]) -> list[dict[str, Any]]:
    message = _message(family, name)
    low, high = np.array([[f.low, f.high] for f in fields]).T
    values = np.random.default_rng(0).uniform(low, high, (FRAMES, len(fields))).tolist()
    start = time.process_time()
    ours = [encode(*(f.raw(v) for f, v in zip(fields, x, strict=True))) for x in values]
    own = (time.process_time() - start) / FRAMES
    start = time.process_time()
    theirs = [message.encode({f.name: v for f, v in zip(fields, x, strict=True)}) for x in values]
    peer = (time.process_time() - start) / FRAMES
    return _compared(f"{family} {name} encoded", sum(a != b for a, b in zip(ours, theirs, strict=True)), own, peer)


def _decoding(family: str, fields: tuple[Field, ...], decode: Callable[[bytes], Sequence[int]]) -> list[dict[str, Any]]:
    message = _message(family, "Feedback")
    data = [x.tobytes() for x in np.random.default_rng(1).integers(0, 256, (FRAMES, message.length), dtype=np.uint8)]
    start = time.process_time()
    ours = [[f.value(r) for f, r in zip(fields, decode(x), strict=True)] for x in data]
    own = (time.process_time() - start) / FRAMES
    start = time.process_time()
    theirs = [message.decode(x, decode_choices=False) for x in data]
    peer = (time.process_time() - start) / FRAMES
    reference = np.array([[x[f.name] for f in fields] for x in theirs])
    steps = np.array([f.factor for f in fields])
    return _compared(f"{family} Feedback decoded", int(np.sum(np.abs(np.array(ours) - reference) > 1e-9 * steps)), own, peer)


def _odrive() -> list[dict[str, Any]]:
    message, rng = _message("odrive", "SetInputPosition"), np.random.default_rng(2)
    values = list(zip(rng.normal(0, 20, FRAMES).tolist(), *rng.integers(-32768, 32768, (2, FRAMES)).tolist(), strict=True))
    start = time.process_time()
    ours = [frames.position_command(q, dq, tau) for q, dq, tau in values]
    own = (time.process_time() - start) / FRAMES
    start = time.process_time()
    theirs = [message.encode({"Position": q, "Velocity": v * 0.001, "Torque": t * 0.001}, strict=False) for q, v, t in values]
    peer = (time.process_time() - start) / FRAMES
    rows = _compared("odrive SetInputPosition encoded", sum(a != b for a, b in zip(ours, theirs, strict=True)), own, peer)
    message = _message("odrive", "EncoderEstimates")
    data = [x.tobytes() for x in rng.normal(0, 20, (FRAMES, 2)).astype("<f4")]
    start = time.process_time()
    read = [frames.two_floats(x) for x in data]
    own = (time.process_time() - start) / FRAMES
    start = time.process_time()
    reference = [message.decode(x, decode_choices=False) for x in data]
    peer = (time.process_time() - start) / FRAMES
    differ = sum(a != (b["Position"], b["Velocity"]) for a, b in zip(read, reference, strict=True))
    return rows + _compared("odrive EncoderEstimates decoded", differ, own, peer)


def _compared(what: str, differ: int, own: float, peer: float) -> list[dict[str, Any]]:
    return [
        {"what": f"{what}: differences from cantools in {FRAMES} frames", "value": differ, "unit": "", "bar": "0",
         "note": f"{1e6 * own:.1f} us CPU a frame, cantools {1e6 * peer:.1f} us"}
    ]  # fmt: skip
