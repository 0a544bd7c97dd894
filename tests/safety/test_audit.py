"""The audit trail can only grow: changed bytes and removed or inserted lines are found; concurrent writers form one chain."""

from __future__ import annotations

import fcntl
import hashlib
import multiprocessing
import threading
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from safety.audit import LONGEST, record, verify
from sim.errors import ConfigError, SafetyStop

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)


@pytest.fixture
def trail(tmp_path: Path) -> Path:
    file = tmp_path / "deep" / "audit.jsonl"
    for k in range(3):
        record(file, "run begins", NOON, operator='Zoë "x", "sha256": "', k=k)
    return file


def test_lines_read_back_in_order(trail: Path) -> None:
    entries = verify(trail)
    assert [(e["number"], e["facts"]["k"], e["event"]) for e in entries] == [(k + 1, k, "run begins") for k in range(3)]
    assert entries[0]["at"] == "2026-11-21T12:00:00.000+00:00"
    assert entries[0]["facts"]["operator"].startswith("Zoë")
    assert verify(trail.parent / "none.jsonl") == []


def test_an_empty_file_is_an_empty_trail(tmp_path: Path) -> None:
    (tmp_path / "audit.jsonl").touch()
    assert verify(tmp_path / "audit.jsonl") == []
    record(tmp_path / "audit.jsonl", "run begins")
    assert len(verify(tmp_path / "audit.jsonl")) == 1


def test_every_change_of_one_byte_is_found(trail: Path) -> None:
    good = trail.read_bytes()
    for place in range(len(good)):
        for bit in (0, 5):
            bad = bytearray(good)
            bad[place] ^= 1 << bit
            trail.write_bytes(bad)
            with pytest.raises(SafetyStop, match="changed"):
                verify(trail)


@pytest.mark.parametrize("damage", ["first line gone", "line gone", "line twice", "lines swapped", "cut", "line inserted"])
def test_lines_cannot_be_taken_out_or_put_in(trail: Path, damage: str) -> None:
    a, b, c, _ = trail.read_bytes().split(b"\n")
    lines = {
        "first line gone": [b, c, b""],
        "line gone": [a, c, b""],
        "line twice": [a, b, b, c, b""],
        "lines swapped": [b, a, c, b""],
        "cut": [a, b, c[:-5]],
        "line inserted": [a, b'{"x": 1}', b, c, b""],
    }[damage]
    trail.write_bytes(b"\n".join(lines))
    with pytest.raises(SafetyStop, match="changed"):
        verify(trail)
    if damage == "cut":
        with pytest.raises(SafetyStop, match="not complete"):
            record(trail, "run begins")


def test_nothing_is_added_to_a_trail_whose_end_was_changed(trail: Path) -> None:
    raw = trail.read_bytes()
    trail.write_bytes(raw[:-4] + b'x"}\n')
    with pytest.raises(SafetyStop, match="its hash does not match"):
        record(trail, "run begins")


@pytest.mark.parametrize(
    "body",
    [
        b"nonsense}",
        b'{"number": 2}',
        b'{"number": "2", "at": "", "event": "", "facts": {}, "previous": ""}',
        b'{"number": 2, "at": "", "event": "", "facts": [], "previous": ""}',
        b'{"number": ' + b"9" * 5000 + b"}",
        b'{"facts": ' + b"[" * 20_000 + b"}",
        b'{"\xff": 1}',
    ],
)
def test_a_forged_line_that_is_no_entry_is_named(trail: Path, body: bytes) -> None:
    """Anyone who can write the file can also compute a matching hash."""
    a, *_ = trail.read_bytes().splitlines(keepends=True)
    trail.write_bytes(a + body[:-1] + b', "sha256": "' + hashlib.sha256(body).hexdigest().encode() + b'"}\n')
    with pytest.raises(SafetyStop, match=r"audit\.jsonl:2: is not an entry with number, at, event, facts, previous"):
        verify(trail)
    with pytest.raises(SafetyStop, match="its last line: is not an entry"):
        record(trail, "run begins")


def test_a_line_is_added_without_reading_those_before_the_last(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    for k in range(40):
        record(file, "run begins", facts=["x" * 9000] * (k % 11), k=k)
    assert [entry["facts"]["k"] for entry in verify(file)] == list(range(40))
    whole = file.read_bytes()
    file.write_bytes(b"?" * (len(whole) - LONGEST - 2) + whole[-LONGEST - 2 :])
    record(file, "run completed")
    with pytest.raises(SafetyStop, match=":1: its hash does not match"):
        verify(file)


@pytest.mark.parametrize("facts", [{"reasons": ["x" * (LONGEST // 20)] * 21}, {"reason": "\U0001f916" * 10_000}])
def test_facts_that_would_make_a_line_too_long_are_cut(trail: Path, facts: dict[str, object]) -> None:
    record(trail, "run stopped", **facts)
    record(trail, "run begins")
    cut = verify(trail)[-2]["facts"]["cut"]
    assert cut.endswith(" bytes)")
    assert len(max(trail.read_bytes().split(b"\n"), key=len)) <= LONGEST


def test_a_line_longer_than_any_that_is_written_is_refused(trail: Path) -> None:
    whole = trail.read_bytes()
    trail.write_bytes(whole[:-2] + b" " * LONGEST + whole[-2:])
    with pytest.raises(SafetyStop, match=":3:"):
        verify(trail)


def test_a_trail_that_cannot_be_written_lets_nothing_move(tmp_path: Path) -> None:
    (tmp_path / "audit.jsonl").mkdir()
    with pytest.raises(ConfigError, match="nothing moves without its record"):
        record(tmp_path / "audit.jsonl", "run begins")


def _write(file: Path, who: int) -> None:
    for k in range(20):
        record(file, "run begins", who=who, k=k)


def test_writers_at_the_same_time_make_one_chain(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    context = multiprocessing.get_context("fork")
    writers = [context.Process(target=_write, args=(file, who)) for who in range(3)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    entries = verify(file)
    assert len(entries) == 60
    for who in range(3):
        assert [e["facts"]["k"] for e in entries if e["facts"]["who"] == who] == list(range(20))


def test_a_line_that_is_being_written_is_waited_for(trail: Path) -> None:
    whole = trail.read_bytes()
    half = len(whole) - 40
    trail.write_bytes(whole[:half])
    read: list[list[dict[str, Any]]] = []
    with trail.open("ab") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        reader = threading.Thread(target=lambda: read.append(verify(trail)), daemon=True)
        reader.start()
        reader.join(0.05)  # a reader that does not wait has returned by then
        stream.write(whole[half:])
    reader.join(10.0)
    assert [len(entries) for entries in read] == [3]


def test_a_stop_for_a_number_that_is_none_is_in_the_trail(tmp_path: Path) -> None:
    file = tmp_path / "audit.jsonl"
    record(file, "stop", stop={"value": float("nan"), "limits": [1.0, float("inf")], "joint": None}, reason="x" * 200_000)
    (entry,) = verify(file)
    assert entry["facts"]["stop"] == {"value": "nan", "limits": [1.0, "inf"], "joint": None}
    assert entry["facts"]["reason"].endswith("(200000 characters)")
    record(file, "run begins")
    assert len(verify(file)) == 2
