"""What guard and monitor process show each other arrives complete, also in another process."""

from __future__ import annotations

import multiprocessing
from multiprocessing.connection import Connection

import numpy as np

from safety.signs import ENDED, TEXT, TURN_AT, Signs

CONTEXT = multiprocessing.get_context("spawn")


def test_before_anything_was_shown() -> None:
    signs = Signs(3, CONTEXT)
    assert signs.last().k == ENDED
    assert signs.looked_at == -np.inf
    assert signs.tripped is None
    assert signs.halt is None


def test_the_outcome_of_the_stop_is_the_devices_refusal_or_empty() -> None:
    signs, other = Signs(3, CONTEXT), Signs(3, CONTEXT)
    signs.halted("the port is closed")
    other.halted()
    assert (signs.halt, other.halt) == ("the port is closed", "")
    copy = Signs.__new__(Signs)
    copy.__setstate__(signs.__getstate__())
    assert copy.halt == "the port is closed"


def _echo(signs: Signs, talk: Connection) -> None:
    sign = signs.last()
    signs.looked(sign.at)
    signs.trip(f"leg {sign.leg}, sample {sign.k}, {sign.q.tolist()}")
    talk.close()


def test_another_process_sees_what_was_shown_and_answers() -> None:
    signs, (ours, theirs) = Signs(3, CONTEXT), CONTEXT.Pipe()
    signs.sent(1.5, 2, 7, np.array([0.1, 0.2, 0.3]))
    process = CONTEXT.Process(target=_echo, args=(signs, theirs))
    process.start()
    theirs.close()
    process.join()
    ours.close()
    assert signs.looked_at == 1.5
    assert signs.tripped == "leg 2, sample 7, [0.1, 0.2, 0.3]"


def test_a_copy_for_another_process_shares_the_memory() -> None:
    signs = Signs(2, CONTEXT)
    copy = Signs.__new__(Signs)
    copy.__setstate__(signs.__getstate__())
    copy.sent(2.0, 1, 5, np.ones(2))
    assert signs.last().k == 5


def test_the_first_reason_stays_and_is_cut_to_the_place_that_there_is() -> None:
    signs = Signs(2, CONTEXT)
    signs.trip("x" * 1000)
    signs.trip("another")
    assert signs.tripped == "x" * (TEXT - 1)


def test_a_sign_that_is_only_half_written_is_of_no_time() -> None:
    signs = Signs(2, CONTEXT)
    signs.sent(1.0, 0, 3, np.ones(2))
    signs._numbers[TURN_AT] += 1
    sign = signs.last()
    assert sign.at == -np.inf
    assert np.isnan(sign.q).all()
    assert sign.k < ENDED
