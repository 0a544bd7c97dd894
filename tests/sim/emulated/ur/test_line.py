from __future__ import annotations

import pytest

from sim.emulated.ur.line import DELAY, DROPPED, Line


def carried(fault: str | None, n: int, dt: float = 0.002) -> list[bytes]:
    line = Line()
    line.fault(fault)
    return [line.carry(bytes([k]), k * dt) for k in range(n)]


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (None, [b"\0", b"\1", b"\2", b"\3"]),
        ("duplicate", [b"\0\0", b"\1\1", b"\2\2", b"\3\3"]),
        ("freeze", [b"\0", b"\0", b"\0", b"\0"]),
        ("reorder", [b"", b"\1\0", b"", b"\3\2"]),
    ],
)
def test_what_arrives(fault: str | None, expected: list[bytes]) -> None:
    assert carried(fault, 4) == expected


def test_drop_loses_its_frames_and_no_more() -> None:
    assert carried("drop", DROPPED + 2) == [b""] * DROPPED + [bytes([DROPPED]), bytes([DROPPED + 1])]


def test_delay_keeps_every_frame_and_the_order() -> None:
    out = carried("delay", 200)
    late = round(DELAY / 0.002)
    assert b"".join(out) == bytes(range(200 - late))
    assert out[:late] == [b""] * late
