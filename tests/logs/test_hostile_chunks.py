"""A small file cannot exhaust memory or time, even if it unpacks to a large size or holds very many messages."""

from __future__ import annotations

import random
import struct
import subprocess
import sys

import lz4.frame
import pytest
import zstandard

from logs.mcap_records import MAGIC, MAX_RECORD
from tests.logs.test_hostile import CHANNEL, END, GOOD_BODY, HEADER, SCHEMA, chunk, message, whole

CHILD = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
from logs import read_log
from sim.errors import BadLog
for partial in (False, True):
    try:
        print(len(read_log(sys.argv[1], accept_partial=partial)))
    except BadLog as error:
        print(error)
status = Path("/proc/self/status").read_text()
print(int(status.partition("VmHWM:")[2].split()[0]))
"""


def in_a_cage(path):
    """Output of strict and partial reading in a process with 3 GB of address space and 20 s of CPU, and its peak memory, kB.

    The peak is the kernel's VmHWM, which is reset when the program starts. A process inherits ru_maxrss from its parent, so
    that would be the peak of the whole test run.
    """
    done = subprocess.run([sys.executable, "-c", CHILD, str(path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    *printed, peak = done.stdout.splitlines()
    return printed, int(peak)


def zstd_zeros(size):
    compressor = zstandard.ZstdCompressor(level=3).compressobj()
    block = bytes(1 << 20)
    return b"".join([compressor.compress(block) for _ in range(size >> 20)] + [compressor.flush()])


@pytest.mark.parametrize("declared", [100, MAX_RECORD])
@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_decompression_bomb_is_bounded(tmp_path, compression, declared):
    packed = zstd_zeros(1 << 30) if compression == "zstd" else lz4.frame.compress(bytes(1 << 28))
    (tmp_path / "a.mcap").write_bytes(whole(chunk(b"", compression, packed, size=declared, crc=0)))
    printed, peak = in_a_cage(tmp_path / "a.mcap")
    assert all("chunk at byte" in line or "no message on" in line or "unpacks to more" in line for line in printed)
    assert peak < 400_000


def test_many_chunks_that_unpack_to_much(tmp_path):
    packed = zstandard.compress(bytes(MAX_RECORD))
    data = MAGIC + HEADER + chunk(b"", "zstd", packed, size=MAX_RECORD, crc=0) * 200 + END
    (tmp_path / "a.mcap").write_bytes(data)
    printed, peak = in_a_cage(tmp_path / "a.mcap")
    assert "no complete record at byte 0" in printed[0]
    assert "unpacks to more than" in printed[1]
    assert peak < 900_000


@pytest.mark.parametrize("count", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("known", [True, False])
def test_very_many_empty_messages(tmp_path, known, count):
    records = SCHEMA + CHANNEL * known + message() * count
    stream = chunk(records, "zstd", zstandard.compress(records))
    (tmp_path / "a.mcap").write_bytes(whole(stream))
    printed, peak = in_a_cage(tmp_path / "a.mcap")
    assert len(printed) == 2
    assert peak < 900_000


def test_very_many_messages_that_each_need_the_slow_path_stay_in_bounds(tmp_path):
    rng = random.Random(1)
    records = [SCHEMA, CHANNEL]
    for k in range(10_000):
        body = bytearray(GOOD_BODY)
        body[4:8] = struct.pack("<i", k)
        body[16:17] = bytes([rng.randrange(256)])  # zero byte that ends the frame name: wrong in nearly all messages
        records.append(message(bytes(body)))
    data = b"".join(records)
    (tmp_path / "a.mcap").write_bytes(whole(chunk(data, "zstd", zstandard.compress(data))))
    printed, _ = in_a_cage(tmp_path / "a.mcap")
    assert "a string does not end with a zero byte" in printed[0]
