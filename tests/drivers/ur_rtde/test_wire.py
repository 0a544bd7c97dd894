from __future__ import annotations

import random
import struct

import pytest

from drivers.ur_rtde.wire import BrokenStream, Recipe, Splitter, request

RECIPE = Recipe(1, ("timestamp", "actual_q", "robot_mode"), ("DOUBLE", "VECTOR6D", "INT32"))
PAYLOAD = struct.pack(">B7di", 1, 3.5, *range(6), 7)


def test_a_frame_in_any_slicing_gives_the_same_frames() -> None:
    stream = request("U", PAYLOAD) + request("M", b"text") + request("U", PAYLOAD)
    for cut in range(len(stream)):
        splitter = Splitter()
        frames = splitter.feed(stream[:cut]) + splitter.feed(stream[cut:])
        assert frames == [("U", PAYLOAD), ("M", b"text"), ("U", PAYLOAD)]


def test_values_by_name() -> None:
    assert RECIPE.unpack(PAYLOAD) == {"timestamp": (3.5,), "actual_q": (0.0, 1.0, 2.0, 3.0, 4.0, 5.0), "robot_mode": (7,)}


@pytest.mark.parametrize(
    "payload", [b"", PAYLOAD[:-1], PAYLOAD + b"\x00", b"\x02" + PAYLOAD[1:]], ids=["empty", "short", "long", "other recipe"]
)
def test_a_payload_that_is_not_the_recipe_is_refused(payload: bytes) -> None:
    with pytest.raises(BrokenStream):
        RECIPE.unpack(payload)


@pytest.mark.parametrize(
    "types", [("DOUBLE",), ("DOUBLE", "VECTOR6D", "STRING"), ("DOUBLE", "NOT_FOUND", "INT32"), ("DOUBLE", "DOUBLE", "INT32")]
)
def test_a_recipe_of_unknown_types_is_refused(types: tuple[str, ...]) -> None:
    with pytest.raises(BrokenStream):
        Recipe(1, RECIPE.names, types)


@pytest.mark.parametrize("size", [0, 2, 4097, 65535])
def test_a_size_that_no_frame_has_is_refused(size: int) -> None:
    with pytest.raises(BrokenStream, match=str(size)):
        Splitter().feed(struct.pack(">HB", size, ord("U")))


def test_whatever_the_bytes_the_answer_is_frames_or_a_refusal() -> None:
    rng = random.Random(1)
    stream = request("U", PAYLOAD) * 20
    refused = 0
    for _ in range(3000):
        data = bytearray(stream)
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        splitter = Splitter()
        try:
            for k in range(0, len(data), 97):
                for kind, payload in splitter.feed(bytes(data[k : k + 97])):
                    if kind == "U":
                        RECIPE.unpack(payload)
        except BrokenStream:
            refused += 1
    assert refused > 0
