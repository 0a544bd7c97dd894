"""Hostile files: each is refused with BadLog or read without wrong values, in bounded memory and time."""

import contextlib
import io
import random
import resource
import struct
import zlib

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from logs import Recorder, read_log
from logs.journal import record_bytes
from logs.mcap_records import MAGIC, MAX_RECORD
from logs.schemas import SCHEMAS
from sim.errors import BadLog
from sim.joint_state import JointState

JOINT_STATE = "sensor_msgs/msg/JointState"


def record(opcode, content, length=None):
    return struct.pack("<BQ", opcode, len(content) if length is None else length) + content


def text(value):
    raw = value.encode()
    return struct.pack("<I", len(raw)) + raw


HEADER = record(1, text("ros2") + text("hostile"))
SCHEMA = record(3, struct.pack("<H", 1) + text(JOINT_STATE) + text("ros2msg") + text(SCHEMAS[JOINT_STATE]))
CHANNEL = record(4, struct.pack("<HH", 1, 1) + text("/joint_states") + text("cdr") + struct.pack("<I", 0))
END = record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def message(body=b"", channel=1):
    return record(5, struct.pack("<HIQQ", channel, 0, 0, 0) + body)


def chunk(records, compression="", packed=None, size=None, crc=None):
    packed = records if packed is None else packed
    size = len(records) if size is None else size
    crc = zlib.crc32(records) if crc is None else crc
    head = struct.pack("<QQQI", 0, 0, size, crc)
    return record(6, head + text(compression) + struct.pack("<Q", len(packed)) + packed)


def whole(*records):
    return MAGIC + HEADER + b"".join(records) + END


GOOD_BODY = (
    b"\x00\x01\x00\x00" + struct.pack("<iI", 5, 0) + b"\x01\x00\x00\x00\x00" + bytes(3)
    + struct.pack("<I", 1) + b"\x02\x00\x00\x00a\x00" + bytes(2) + struct.pack("<I", 1) + struct.pack("<d", 0.5)
    + struct.pack("<I", 0) + struct.pack("<I", 0)
)  # fmt: skip
GOOD = whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY)))


def refused(tmp_path, data, match):
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(BadLog, match=match) as caught:
        read_log(path)
    assert str(path) in str(caught.value)
    with contextlib.suppress(BadLog):
        read_log(path, accept_partial=True)


def test_the_yardstick_is_good(tmp_path):
    (tmp_path / "a.mcap").write_bytes(GOOD)
    log = read_log(tmp_path / "a.mcap")
    assert (log.joint_names, log.q.tolist()) == (("a",), [[0.5]])


LENGTHS = [2**63, 2**64 - 1, 2**40, MAX_RECORD + 1]
CASES = {
    "chunk that is not zstd": (whole(chunk(b"x", "zstd")), "chunk at byte"),
    "chunk that is not lz4": (whole(chunk(b"x", "lz4")), "chunk at byte"),
    "unknown compression": (whole(chunk(SCHEMA, "br")), "compression 'br'"),
    "wrong check sum": (whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY), crc=1)), "checksum of the content"),
    "declares too little": (whole(chunk(SCHEMA * 9, "zstd", zstandard.compress(SCHEMA * 9), size=100)), "unpacks to more than"),
    "declares too much": (whole(chunk(SCHEMA, "zstd", zstandard.compress(SCHEMA), size=10**6)), "unpacks to less than"),
    "declares 2^63": (whole(chunk(SCHEMA, "zstd", zstandard.compress(SCHEMA), size=2**63)), "at most 67108864 are read"),
    "chunk ends in a record": (whole(chunk(SCHEMA[:-1])), "no complete record at byte"),
    "chunk in a chunk": (whole(chunk(chunk(SCHEMA))), "is not allowed in a chunk"),
    "chunk with a lying inner length": (whole(record(6, struct.pack("<QQQI", 0, 0, 9, 0) + text("") + struct.pack("<Q", 99))), "reaches beyond"),
    "message without a channel": (whole(chunk(message(GOOD_BODY))), "channel 1, which is not defined"),
    "channel without a schema": (whole(chunk(CHANNEL + message(GOOD_BODY))), "names schema 1, which is not defined before"),
    "two meanings of a channel": (whole(CHANNEL.replace(b"\x01\x00\x01\x00", b"\x01\x00\x00\x00", 1), SCHEMA, CHANNEL), "defined twice"),
    "message too short": (whole(chunk(SCHEMA + CHANNEL + record(5, b"\x01\x00" + bytes(6)))), "too short for its own header"),
    "empty message": (whole(chunk(SCHEMA + CHANNEL + message())), "0 bytes, a message has at least 4"),
    "big array": (whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY[:-20] + b"\xff\xff\xff\x7f" + bytes(16)))), "an array of"),
    "many names": (whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY[:20] + b"\xff\xff\xff\x7f" + bytes(40)))), "joint names, at most"),
    "other encapsulation": (whole(chunk(SCHEMA + CHANNEL + message(b"\x00\x03" + GOOD_BODY[2:]))), "plain CDR"),
    "bytes after the last field": (whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY + bytes(8)))), "follow the last field"),
    "other fields under the name": (
        whole(chunk(record(3, struct.pack("<H", 1) + text(JOINT_STATE) + text("ros2msg") + text("float64 x")) + CHANNEL + message(GOOD_BODY))),
        "has fields other",
    ),
    "not CDR": (whole(chunk(SCHEMA + CHANNEL.replace(b"cdr", b"xml") + message(GOOD_BODY))), "encoding 'xml'"),
    "metadata that lies": (whole(record(12, text("recording") + struct.pack("<I", 99))), "reaches beyond"),
    "metadata that repeats a key": (whole(record(12, text("x") + struct.pack("<I", 20) + 2 * (text("a") + text("b")))), "occurs twice"),
    "state that is none": (whole(record(12, text("recording") + struct.pack("<I", 17) + text("state") + text("good"))), "state 'good'"),
    "zeros": (MAGIC + HEADER + bytes(1000), "no MCAP record here"),
    "no record at all": (MAGIC, "the file is cut"),
    "no footer": (MAGIC + HEADER + SCHEMA, "the file is cut"),
    "magic only at the end": (MAGIC + MAGIC, "cut|at most"),
    "wrong data check sum": (GOOD.replace(END, record(15, b"abcd") + END[13:]), "checksum of the data section"),
    "wrong summary check sum": (GOOD.replace(END, END[:13] + record(2, bytes(16) + b"abcd") + MAGIC), "checksum of the summary"),
    "counts that lie": (GOOD.replace(END, END[:13] + record(11, struct.pack("<Q", 7) + bytes(34)) + END[13:]), "counts 7 messages"),
    "more joint names than any arm": (whole(chunk(SCHEMA + CHANNEL + message(GOOD_BODY.replace(b"a\x00", b"\xff\x00")))), "not UTF-8"),
} | {f"record of {n} bytes": (MAGIC + HEADER + record(6, b"", n) + END, "cut|at most") for n in LENGTHS}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_malformed_file_is_refused(tmp_path, name):
    refused(tmp_path, *CASES[name])


def corpus(folder):
    """Small valid files of every kind, by name."""
    rng = np.random.default_rng(7)
    x = np.cumsum(rng.normal(0, 1e-3, (40, 2)), axis=0)

    def states():
        return [JointState(5 + 0.002 * k, 0.002 * k, x[k], x[k], x[k], x[k], x[k]) for k in range(40)]

    finished = Recorder(folder / "finished.mcap", ("a", "b"), {"arm": "x"})
    for k, state in enumerate(states()):
        finished.write(state, x[k], x[k], x[k])
    finished.event(20, "motion", "starts", 0.01)
    files = {"journal": (folder / "finished.mcap").read_bytes()}
    finished.close()
    files["finished"] = (folder / "finished.mcap").read_bytes()
    head = ",".join(["timestamp", *(f"{stem}_{j}" for stem in ("actual_q", "actual_qd", "actual_current") for j in range(6))])
    rows = [",".join(f"{value:.4f}" for value in [0.01 * k, *np.repeat(x[k], 9)]) for k in range(40)]
    files["csv"] = ("\n".join([head, *rows]) + "\n").encode()
    for name, options in {"plain": {"compression": CompressionType.NONE}, "unchunked": {"use_chunking": False}}.items():
        stream = io.BytesIO()
        writer = Writer(stream, enable_data_crcs=True, **options)
        writer.start("ros2", "corpus")
        channel = writer.register_channel(
            "/joint_states", "cdr", writer.register_schema(JOINT_STATE, "ros2msg", SCHEMAS[JOINT_STATE].encode())
        )
        for k in range(20):
            body = bytearray(GOOD_BODY)
            body[4:12] = struct.pack("<iI", 5, 2_000_000 * k)
            writer.add_message(channel, k, bytes(body), k, k)
        writer.finish()
        files[name] = stream.getvalue()
    return files


WORDS = [bytes(4), b"\xff" * 4, b"\xff" * 8, bytes(8), b"\x7f", b"\x80", struct.pack("<Q", 1 << 40), struct.pack("<d", float("nan")),
         struct.pack("<d", 1e300), b"nan", b"inf", b"1e999", b"\n", b",", b"-", b"9"]  # fmt: skip


def mutated(data, rng):
    """The file with one to three changes: a flipped bit, bytes replaced, removed, doubled or copied, or the end cut off."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        at = rng.randrange(len(out))
        kind = rng.randrange(7)
        if kind <= 1:
            out[at] ^= 1 << rng.randrange(8)
        elif kind == 2:
            word = rng.choice(WORDS)
            out[at : at + len(word)] = word
        elif kind == 3:
            del out[at : at + rng.choice((1, 2, 8, 31, 400))]
        elif kind == 4:
            out[at:at] = out[at : at + rng.choice((1, 9, 60, 400))]
        elif kind == 5:
            del out[at:]
        else:
            other = rng.randrange(len(out))
            out[at : at + 8] = out[other : other + 8]
        if not out:
            return bytes(out)
    return bytes(out)


def csv_as_python_reads_it(data):
    """(N, 12) positions and currents, read by the simplest possible parser."""
    rows = data.removeprefix(b"\xef\xbb\xbf").decode("utf-8", errors="replace").replace('"', "").splitlines()
    names = [name.strip() for name in rows[0].split(",")]
    places = [names.index(f"{stem}_{j}") for stem in ("actual_q", "actual_current") for j in range(6)]
    return np.array([[float(row.split(",")[place]) for place in places] for row in rows[1:]])


def check_accepted(name, data, log, known, partial):
    """Check the log of a mutated file: its values are those of the valid file, or of the mutated text for CSV.

    After a partial read only finite and bounded positions are required, except for a journal."""
    assert np.isfinite(log.q).all()
    assert np.abs(log.q).max() <= 1e4
    if name == "csv":
        if not partial:
            np.testing.assert_array_equal(np.column_stack([log.q, log.current]), csv_as_python_reads_it(data))
    elif name == "journal" or not partial:
        assert len(log) == len(known) or (name == "journal" and len(log) < len(known))
        for channel in ("q", "t", "tau", "current"):
            np.testing.assert_array_equal(getattr(log, channel), getattr(known, channel)[: len(log)])


@pytest.mark.parametrize("count", [600, pytest.param(100_000, marks=pytest.mark.slow)])
def test_no_mutation_crashes_hangs_or_changes_values(tmp_path, count):
    files = corpus(tmp_path)
    path = tmp_path / "mutant"
    sound = {}
    for name, data in files.items():
        path.write_bytes(data)
        sound[name] = read_log(path, accept_partial=True)
    rng = random.Random(count)
    accepted = 0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(count):
        name = rng.choice(list(files))
        data = mutated(files[name], rng)
        path.write_bytes(data)
        for partial in (False, True):
            with contextlib.suppress(BadLog):
                check_accepted(name, data, read_log(path, accept_partial=partial), sound[name], partial)
                accepted += 1
    # kB; no address-space limit here, which other threads of the test run would share
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1_000_000
    assert accepted > count / 50


def test_the_records_are_written_as_the_library_writes_them():
    from mcap.records import Header

    assert record_bytes(Header(profile="ros2", library="hostile")) == HEADER
