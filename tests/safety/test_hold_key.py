"""The dead-man key on a pseudo-terminal: held, released, the terminal closed, no terminal at all."""

from __future__ import annotations

import os
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest

from safety.hold_key import HoldKey
from sim.errors import ConfigError, SafetyStop


class Typist:
    """Types `key` repeatedly on the other side of the terminal while `held`."""

    def __init__(self, master: int) -> None:
        self.master, self.key, self.held, self.over = master, b" ", True, False
        self._thread = threading.Thread(target=self._type, daemon=True)
        self._thread.start()

    def _type(self) -> None:
        while not self.over:
            if self.held:
                os.write(self.master, self.key)
            time.sleep(0.01)

    def go(self) -> None:
        self.over = True
        self._thread.join()


@pytest.fixture
def terminal() -> Iterator[tuple[Typist, IO[bytes]]]:
    master, slave = os.openpty()
    typist = Typist(master)
    with os.fdopen(slave, "rb", buffering=0) as stream:
        yield typist, stream
    typist.go()
    os.close(master)


def until(fact: Callable[[], bool], limit: float = 20.0) -> None:
    end = time.monotonic() + limit
    while not fact():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_without_a_stream_it_never_asks() -> None:
    with HoldKey() as key:
        assert key.reason() is None


def test_released_means_stop_and_the_terminal_is_as_before(terminal: tuple[Typist, IO[bytes]]) -> None:
    typist, stream = terminal
    before = termios.tcgetattr(stream.fileno())
    with HoldKey(stream) as key:
        assert termios.tcgetattr(stream.fileno()) != before
        assert key.reason() is None
        time.sleep(0.1)
        typist.held = False
        until(lambda: key.reason() is not None)
        assert key.reason() == "the space bar was released"
        typist.held = True
        time.sleep(0.1)
        assert key.reason() is not None
    assert termios.tcgetattr(stream.fileno()) == before


def test_other_keys_do_not_hold(terminal: tuple[Typist, IO[bytes]]) -> None:
    typist, stream = terminal
    with HoldKey(stream) as key:
        typist.key = b"x"
        until(lambda: key.reason() is not None)


def test_a_terminal_that_closes_is_a_released_key() -> None:
    master, slave = os.openpty()
    typist = Typist(master)
    with os.fdopen(slave, "rb", buffering=0) as stream, HoldKey(stream) as key:
        typist.go()
        os.close(master)
        until(lambda: key.reason() is not None)


def test_a_terminal_that_closes_before_the_key_is_pressed_moves_nothing() -> None:
    master, slave = os.openpty()
    timer = threading.Timer(0.3, os.close, (master,))
    with os.fdopen(slave, "rb", buffering=0) as stream:
        timer.start()
        with pytest.raises(SafetyStop, match="nothing was moved"), HoldKey(stream):
            pytest.fail("the key was never pressed")
    timer.join()


def test_without_a_terminal_it_is_refused() -> None:
    read, write = os.pipe()
    os.close(write)
    with os.fdopen(read, "rb", buffering=0) as stream, pytest.raises(ConfigError, match="needs a terminal"), HoldKey(stream):
        pytest.fail("a pipe has no space bar")


def test_another_key_before_it_does_not_begin() -> None:
    master, slave = os.openpty()
    typed: list[bytes] = []

    def type_both() -> None:
        for key in (b"x", b" "):
            time.sleep(0.2)
            typed.append(key)
            os.write(master, key)

    typist = threading.Thread(target=type_both)
    with os.fdopen(slave, "rb", buffering=0) as stream:
        typist.start()
        with HoldKey(stream) as key:
            assert typed == [b"x", b" "]
            assert key.reason() is None
    typist.join()
    os.close(master)


def test_a_terminal_that_cannot_be_read_any_more_is_a_released_key(terminal: tuple[Typist, IO[bytes]], tmp_path: Path) -> None:
    """Like a process that lost its terminal: there is always something to read, and every read fails."""
    _, stream = terminal
    folder = os.open(tmp_path, os.O_RDONLY)
    with HoldKey(stream) as key:
        os.dup2(folder, stream.fileno())
        until(lambda: key.reason() is not None)
    os.close(folder)
