"""Answers go to standard output, everything else to standard error, and JSON is strict."""

import errno
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from calib.commands.check import moving
from calib.terminal import console, options
from sim.cell import load_cell


def test_json_is_strict(capsys: pytest.CaptureFixture[str]) -> None:
    console.print_json(
        {"a": np.array([1.0, np.nan]), "b": Path("x"), "c": np.float32(np.inf), "d": (np.bool_(True), np.int64(3))}
    )
    assert json.loads(capsys.readouterr().out) == {"a": [1.0, None], "b": "x", "c": None, "d": [True, 3]}


def test_what_has_no_json_form_is_named() -> None:
    with pytest.raises(TypeError, match="object has no JSON form"):
        console.plain({"a": object()})


def test_brackets_in_names_are_not_markup(capsys: pytest.CaptureFixture[str]) -> None:
    console.say("joint [red]a[/red] in log [1].mcap")
    console.table(["joint"], [["[bold]b"]])
    out = capsys.readouterr().out
    assert "joint [red]a[/red] in log [1].mcap" in out
    assert "[bold]b" in out


def test_warnings_do_not_mix_with_answers(capsys: pytest.CaptureFixture[str]) -> None:
    console.warn("look here")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "calib: look here\n"


@pytest.mark.parametrize(
    ("alone", "sentence"),
    [
        ("", "mock-ur10e has a monitor process: it stops"),
        ("its bus is one program's", "has no monitor process: its bus is one program's;"),
    ],
)
def test_a_recording_begins_with_whether_a_monitor_process_exists(
    capsys: pytest.CaptureFixture[str], alone: str, sentence: str
) -> None:
    console.warn_watched(load_cell("mock-ur10e"), alone)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert sentence in " ".join(captured.err.split())


def test_table_shows_four_digits_and_a_dash_for_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    console.table(["joint", "rms"], [["a", 0.123456], ["b", float("nan")], ["c", None]])
    lines = capsys.readouterr().out.splitlines()
    assert [line.split() for line in lines] == [["joint", "rms"], ["a", "0.1235"], ["b", "–"], ["c", "–"]]


def test_progress_away_from_a_terminal_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with console.progress("reading", total=3) as advance:
        advance()
        advance(2, "the last")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "reading ...\n"


def test_a_question_and_a_warning_stand_alone_while_there_is_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    terminal = Console(file=screen, width=80, force_terminal=True)
    monkeypatch.setattr(console, "_err", lambda: terminal)
    drawn: list[bool] = []

    class Answer(io.StringIO):
        def readline(self, *_: object) -> str:
            drawn.append(any(bar.live.is_started for bar in console._BARS))
            return "y\n"

    monkeypatch.setattr("sys.stdin", Answer())
    with console.progress("looking"):
        console.warn("look here")
        assert console.ask("Ask them? [y/N] ") == "y"
        assert [bar.live.is_started for bar in console._BARS] == [True]
    assert drawn == [False]
    assert not console._BARS
    lines = screen.getvalue().replace("\x1b[2K", "\r").replace("\n", "\r").split("\r")
    assert "calib: look here" in lines


def test_a_text_stands_alone_on_request_and_fits_80_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = io.StringIO()
    terminal = Console(file=screen, width=80, force_terminal=True)
    monkeypatch.setattr(console, "_err", lambda: terminal)
    text = moving("shoulder_pan_joint by +2 deg")
    with console.progress("asking the device of emulated-ur10e") as advance:
        advance(0, "rate")
        console._BARS[0].refresh()
        advance(0, text, True)
        console._BARS[0].refresh()
    assert "asking the device of emulated-ur10e: rate" in screen.getvalue()
    assert text == "MOVING shoulder_pan_joint by +2 deg; Ctrl-C stops"
    assert text in screen.getvalue()
    assert f"emulated-ur10e: {text}" not in screen.getvalue()
    assert moving("3 slow lines there and back, for the gravity torque") == "MOVING 3 slow lines there and back; Ctrl-C stops"


def test_completion_offers_what_is_shipped() -> None:
    assert "mock-ur10e" in options.cell_names("mock")
    assert options.cell_names("no such") == []


def test_a_terminal_gets_lines_between_words_and_whole_paths() -> None:
    terminal = Console(width=20, force_terminal=True)
    path = "runs/20260102T030405Z-ur10e-demo/report.html"
    assert console._wrapped(f"  the page stands in {path}", terminal).splitlines() == ["  the page stands in", f"  {path}"]
    assert console._wrapped("   two words", terminal) == "   two words"
    assert console._wrapped("a line that is longer than twenty", Console(width=20, force_terminal=False)).count("\n") == 0


def test_what_a_file_says_never_steers_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    bad = "a\x1b[2J\x9b\u202e\x07"
    console.say(bad)
    console.warn(bad)
    console.copyable(bad)
    console.table([bad, "n"], [[bad, 1.0]], bad)
    console.print_json({"name": bad})
    with console.progress(bad) as advance:
        advance(1, bad)
    printed = capsys.readouterr()
    assert not set("\x1b\x9b\u202e\x07") & set(printed.out + printed.err)
    assert (printed.out + printed.err).count("a\\x1b[2J") >= 5
    assert "a\\u001b[2J\\u009b\\u202e\\u0007" in printed.out


def test_a_question_is_wrapped_and_keeps_the_space_before_its_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    out = io.StringIO()
    monkeypatch.setattr(console, "_err", lambda: Console(file=out, width=20, force_terminal=True))
    monkeypatch.setattr("sys.stdin", io.StringIO("yes\n"))
    assert console.ask("Type a word that is longer to let it move: ") == "yes"
    lines = out.getvalue().split("\n")
    assert max(map(len, lines)) <= 21
    assert lines[-1].endswith("move: ")


class Gone(io.StringIO):
    """A stream whose reader has gone or whose terminal was closed."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def write(self, text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize("number", [errno.EPIPE, errno.EIO])
def test_a_warning_that_nobody_can_read_ends_nothing(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(f"sys.{name}", Gone(number))
    console.warn("the arm is held")
    with pytest.raises(OSError, match=os.strerror(number)):  # an answer that cannot be delivered is not a success
        console.say("the answer")
