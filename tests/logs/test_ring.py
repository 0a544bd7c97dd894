"""The ring keeps every message that it accepts, counts those that it refuses, and never returns part of a message."""

import os
import random

import pytest

from logs.ring import Ring, forget, left_behind, shared_memory


def taken(ring):
    message = ring.look()
    if message is not None:
        ring.let_go()
    return message


@pytest.fixture
def ends():
    fd, name = shared_memory(Ring.size(8, 64))
    yield Ring(fd, 8, 64), Ring(fd, 8, 64)
    os.close(fd)
    forget(name)


def test_messages_come_out_as_they_went_in(ends):
    put, take = ends
    rng = random.Random(1)
    for _ in range(500):
        sent = [rng.randbytes(rng.randrange(0, 60)) for _ in range(rng.randrange(0, 4))]
        assert all(put.put(data) for data in sent)
        assert [taken(take) for _ in sent] == sent
        assert taken(take) is None
    assert put.lost == 0


def test_a_message_longer_than_a_slot_takes_several(ends):
    put, take = ends
    text = bytes(range(200))
    assert put.put(text)
    assert put.put(b"x")
    assert taken(take) == text
    assert taken(take) == b"x"
    assert not put.put(bytes(8 * 64))


def test_a_full_ring_refuses_and_counts(ends):
    put, take = ends
    assert [put.put(bytes([k])) for k in range(10)] == [True] * 8 + [False] * 2
    assert (put.lost, take.lost) == (2, 2)
    assert taken(take) == b"\x00"
    assert put.put(b"again")
    assert [taken(take) for _ in range(8)] == [bytes([k]) for k in range(1, 8)] + [b"again"]


def test_a_slot_that_is_not_wholly_written_is_not_taken(ends):
    put, take = ends
    put.put(b"abcdef")
    at = put._memory.find(b"abcdef")
    put._memory[at] ^= 1
    assert taken(take) is None
    put._memory[at] ^= 1
    assert taken(take) == b"abcdef"


def test_the_first_text_stays(ends):
    put, take = ends
    assert take.note("end") is None
    put.set_note("end", "")
    put.set_note("end", "later")
    assert take.note("end") == ""
    put.set_note("failure", "Ä" * 2000)
    assert take.note("failure").startswith("ÄÄÄ")


def test_what_was_not_let_go_is_still_there(ends):
    put, take = ends
    put.put(b"a")
    assert take.look() == take.look() == b"a"
    take.let_go()
    assert take.look() is None


def test_the_memory_outlives_its_processes_under_a_name_that_no_file_can_forge(tmp_path):
    fd, name = shared_memory(Ring.size(8, 64))
    Ring(fd, 8, 64).put(b"left behind")
    os.close(fd)
    assert left_behind(name).look() == b"left behind"
    for forged in ("", "../" + name, str(tmp_path), name + "/", name.upper(), "arm-calib-" + "0" * 32):
        assert left_behind(forged) is None
        forget(forged)
    assert left_behind(name) is not None
    forget(name)
    assert left_behind(name) is None
