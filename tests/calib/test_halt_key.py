"""The key that stops is heard on a terminal without Enter, other keys are not, and the terminal is given back as it was."""

import io
import os
import pty
import termios
from collections.abc import Iterator

import pytest

from calib.halt_key import HaltKey


@pytest.fixture
def terminal() -> Iterator[tuple[int, io.TextIOWrapper]]:
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as stream:
        yield master, stream
    os.close(master)


def typed(key: HaltKey, master: int, what: bytes) -> str | None:
    """Type `what`, and wait until the listener has read it."""
    with key:
        os.write(master, what)
        key._thread.join(0.5)
    return key.reason()


def test_h_stops_without_enter(terminal: tuple[int, io.TextIOWrapper]) -> None:
    master, stream = terminal
    before = termios.tcgetattr(stream.fileno())
    assert typed(HaltKey(stream), master, b"xh") == "the key h"
    assert termios.tcgetattr(stream.fileno()) == before


def test_other_keys_do_not(terminal: tuple[int, io.TextIOWrapper]) -> None:
    master, stream = terminal
    assert typed(HaltKey(stream), master, b"j \n") is None


def test_the_terminal_is_restored_after_an_error(terminal: tuple[int, io.TextIOWrapper]) -> None:
    _, stream = terminal
    before = termios.tcgetattr(stream.fileno())

    def failing() -> None:
        with HaltKey(stream):
            assert termios.tcgetattr(stream.fileno()) != before
            raise RuntimeError

    with pytest.raises(RuntimeError):
        failing()
    assert termios.tcgetattr(stream.fileno()) == before


def test_what_is_no_terminal_is_not_listened_to() -> None:
    with HaltKey(io.StringIO("h")) as key:
        assert key.reason() is None
