"""The halt key is read on a terminal without Enter, other keys are ignored, and the terminal is restored."""

import io
import os
import pty
import subprocess
import sys
import termios
from collections.abc import Iterator

import pytest

from calib.terminal.halt_key import HaltKey


@pytest.fixture
def terminal() -> Iterator[tuple[int, io.TextIOWrapper]]:
    master, slave = pty.openpty()
    with os.fdopen(slave, "r") as stream:
        yield master, stream
    os.close(master)


def typed(key: HaltKey, master: int, what: bytes) -> str | None:
    """Type `what` and give the listener time to read it."""
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
        assert not key.listening


def test_in_the_background_of_a_terminal_the_run_goes_on_without_the_key() -> None:
    """The system stops a background process that changes its terminal; a recording would wait for ever before its motion."""
    code = (
        "import fcntl, os, sys, termios; from calib.terminal.halt_key import HaltKey\n"
        "fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
        "job = os.fork()\n"
        "if job == 0:\n"
        "    os.setpgid(0, 0)\n"
        "    with HaltKey(sys.stdin) as key: os._exit(10 + key.listening)\n"
        "state = os.waitpid(job, os.WUNTRACED)[1]\n"
        "if os.WIFSTOPPED(state): os.kill(job, 9)\n"
        "sys.exit(os.WEXITSTATUS(state) if os.WIFEXITED(state) else 1)"
    )
    master, slave = pty.openpty()
    try:
        done = subprocess.run([sys.executable, "-c", code], stdin=slave, start_new_session=True, timeout=60)
    finally:
        os.close(master)
        os.close(slave)
    assert done.returncode == 10
