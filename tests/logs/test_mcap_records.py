"""Records are found as by the simplest possible loop, whatever the file contains."""

from __future__ import annotations

import random

import numpy as np
import pytest

from logs.mcap_records import CONTENT_LEAST, HEAD, LEAP_PERIOD, SEAL, walk


def plainly(data: bytes) -> tuple[list[int], list[int], int]:
    """Opcodes, starts and end of the records, found one after the other."""
    ops, starts, at = [], [], 0
    while at <= len(data) - HEAD.size:
        op, length = HEAD.unpack_from(data, at)
        if at + HEAD.size + length > len(data) or op == 0 or (length < CONTENT_LEAST and op < SEAL):
            break
        ops.append(op)
        starts.append(at)
        at += HEAD.size + length
    return ops, starts, at


def check(data: bytes) -> int:
    ops, starts, end = walk(data)
    assert (ops.tolist(), starts.tolist(), end) == plainly(data)
    return len(ops)


def records(pattern: list[tuple[int, int]], count: int, rng: random.Random) -> bytearray:
    """`count` records whose opcodes and lengths repeat `pattern`."""
    out = bytearray()
    for k in range(count):
        op, length = pattern[k % len(pattern)]
        out += HEAD.pack(op, length) + rng.randbytes(length)
    return out


@pytest.mark.parametrize("period", range(1, LEAP_PERIOD + 3))
def test_records_that_repeat(period: int) -> None:
    rng = random.Random(period)
    pattern = [(rng.choice((5, SEAL, 6)), rng.randrange(4, 60)) for _ in range(period)]
    assert check(bytes(records(pattern, 5000, rng))) == 5000


@pytest.mark.parametrize("seed", range(60))
def test_records_that_stop_repeating_and_bytes_that_are_wrong(seed: int) -> None:
    rng = random.Random(seed)
    data = bytearray()
    for _ in range(rng.randrange(1, 6)):
        pattern = [
            (rng.choice((3, 5, SEAL)), rng.randrange(0 if rng.random() < 0.2 else 4, 40)) for _ in range(rng.randrange(1, 5))
        ]
        data += records(pattern, rng.randrange(1, 600), rng)
    for _ in range(rng.randrange(3)):
        data[rng.randrange(len(data))] = rng.randrange(256)
    check(bytes(data[: rng.randrange(len(data) + 1)]))


def test_lengths_of_any_size_end_it() -> None:
    rng = random.Random(0)
    for length in (2**63, 2**64 - 1, 2**40, 10**6):
        check(bytes(records([(5, 20), (SEAL, 8)], 1000, rng)) + HEAD.pack(5, length) + bytes(100))
    assert check(b"") == 0
    assert np.array_equal(walk(bytes(8))[0], [])
