"""Everything that is printed: answers go to standard output, progress and warnings to standard error.

With `--json`, standard output is one JSON document and nothing else, so that `calib ... --json | jq` always works.
"""

from __future__ import annotations

import dataclasses
import enum
import json
import math
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.text import Text

from calib.claims import capital
from calib.terminal import text_table
from sim.files import printable

if TYPE_CHECKING:
    from drivers.driver import Driver
    from sim.cell import Cell

# --quiet: no tables, sentences or progress, only warnings, errors, questions, and JSON if requested
QUIET: ContextVar[bool] = ContextVar("quiet", default=False)
GUIDED: ContextVar[bool] = ContextVar("guided", default=False)  # `calib go` runs the command, and then the next one
WIDE = 110  # columns; in a narrower terminal the bar leaves its place to the text
_BARS: list[Progress] = []  # the bars that `progress` draws now
# JSON escapes C0 by itself; C1, bidirectional marks and lone surrogates would reach a terminal
_STEERING = re.compile("[\x7f-\x9f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ud800-\udfff\ufeff]")


def conclusion(first: str, more: Iterable[str]) -> None:
    """Print what a run found: `more` sentences as a list, then `first`, which answers the question, as the last line."""
    for sentence in more:
        say(f"- {capital(sentence).rstrip('.')}.")
    say(f"{capital(first)}.")


def say(sentence: str) -> None:
    """Print a sentence on standard output; brackets and file names are printed as they are.

    On a terminal it is wrapped between words, with its own indentation. Text to be copied is printed by `copyable`.
    """
    if not QUIET.get():
        _print(_out(), _wrapped(sentence, _out()))


def copyable(line: str) -> None:
    """Print a line to be copied, such as a command or a path, on standard output; it is never wrapped."""
    if not QUIET.get():
        _print(_out(), printable(line))


def next_step(words: Sequence[str | Path]) -> None:
    """Print the command to type next, to be copied."""
    if not GUIDED.get():
        copyable(f"next: {command_line(words)}")


def command_line(words: Sequence[str | Path]) -> str:
    """A command of this program, quoted for a shell; names in capitals, which the person fills in, stay unchanged."""
    return shlex.join(["calib", *map(str, words)])


def warn(sentence: str) -> None:
    """Print a warning on standard error, so that it never mixes with an answer; a closed standard error is not a failure."""
    with suppress(OSError):
        _print(_err(), _wrapped(f"calib: {sentence}", _err()))


def warn_assumed(cell: Cell) -> None:
    """Print what a cell file assumes, at the start of every command that talks to its device."""
    for name, sentence in cell.assumed.items():
        warn(f"{cell.name} assumes {name}: {sentence}")


def warn_control(cell: Cell, driver: Driver) -> None:
    """Print what taking control does to a device, before control is taken."""
    if driver.control:
        warn(f"takes control of {cell.name}: {driver.control}")


def warn_watched(cell: Cell, alone: str) -> None:
    """Print whether a separate process monitors the arm; alone: why there is none, empty if there is one."""
    if alone:
        warn(
            f"{cell.name} has no monitor process: {alone}; if the control process hangs, only the device's own watchdog remains"
        )
    else:
        warn(f"{cell.name} has a monitor process: it stops the arm if the control process hangs or breaks a rule")


def ask(question: str) -> str:
    """Ask a question on standard error, so that it never mixes with an answer, and return what is typed; "" if nobody answers."""
    console, words = _err(), question.rstrip(" ")
    text = _wrapped(words, console) + question[len(words) :]
    with _without_bar():
        console.print(text, markup=False, highlight=False, soft_wrap=True, end="")
        try:
            return sys.stdin.readline().rstrip("\n")
        except KeyboardInterrupt:
            console.print()  # start a new line
            raise


def table(headers: Sequence[str], rows: Iterable[Sequence[Any]], title: str | None = None) -> None:
    """Print a table: numbers right-aligned with four digits, text left-aligned, nothing cut off, no wider than the terminal."""
    if QUIET.get():
        return
    body = [list(row) for row in rows]
    numeric = [
        any(_is_number(row[k]) for row in body) and all(_is_number(row[k]) or row[k] in (None, "") for row in body)
        for k in range(len(headers))
    ]
    out = _out()
    shown = [[cell(value) for value in row] for row in body]
    if title:
        _print(out, Text(printable(title), style="italic"))
    for line, heading in text_table.lines([printable(h) for h in headers], shown, numeric, out.width):
        _print(out, Text(line, style="bold" if heading else ""))


def cell(value: Any) -> str:
    """A value as a table shows it: four significant digits, an en dash for nothing."""
    value = _own(value)
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else printable(value)


def print_json(data: Any) -> None:
    """`data` as one strict JSON document: arrays as lists, NaN and infinities as null, paths as text."""
    text = json.dumps(plain(data), indent=2, ensure_ascii=False, allow_nan=False)
    sys.stdout.write(_STEERING.sub(lambda found: f"\\u{ord(found[0]):04x}", text) + "\n")


def plain(data: Any) -> Any:
    """`data` in the types that JSON and TOML have; TypeError names a type that has no such form."""
    data = _own(data)
    if data is None or (isinstance(data, bool | str | int) and not isinstance(data, enum.Enum)):
        return data
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, PurePath):
        return str(data)
    if isinstance(data, enum.Enum):
        return plain(data.value)
    if isinstance(data, dict):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple | set | frozenset):
        return [plain(value) for value in data]
    if dataclasses.is_dataclass(data) and not isinstance(data, type):
        return {f.name: plain(getattr(data, f.name)) for f in dataclasses.fields(data)}
    raise TypeError(f"{type(data).__name__} has no JSON form")


@contextmanager
def progress(description: str, total: float | None = None) -> Iterator[Callable[..., None]]:
    """Progress on standard error while the block runs; call the yielded `advance(step=1, text=None, alone=False)` as work gets done.

    The text is shown after the description, or alone.

    On a terminal a bar that vanishes at the end; elsewhere one plain line at the start, so that log files stay readable.
    """
    console, description = _err(), printable(description)
    if QUIET.get():
        yield lambda step=1, text=None, alone=False: None
        return
    if not console.is_terminal:
        with suppress(OSError):
            console.print(f"{description} ...", markup=False, highlight=False, soft_wrap=True)
        yield lambda step=1, text=None, alone=False: None
        return
    bar_width = 30 if console.width >= WIDE else 8
    columns = [SpinnerColumn(), TextColumn("{task.description}", markup=False), BarColumn(bar_width=bar_width)]
    if total is not None:
        columns.append(MofNCompleteColumn())
    with Progress(*columns, TimeElapsedColumn(), console=console, transient=True) as bar:
        _BARS.append(bar)
        task = bar.add_task(description, total=total)

        def advance(step: float = 1, text: str | None = None, alone: bool = False) -> None:
            words = [*([] if alone and text else [description]), *([printable(text)] if text else [])]
            bar.update(task, advance=step, description=": ".join(words))

        try:
            yield advance
        finally:
            _BARS.remove(bar)


@contextmanager
def _without_bar() -> Iterator[None]:
    """Hide the bar of `progress` while the block runs: its redraws would overwrite a question or half a line."""
    bar = _BARS[-1] if _BARS else None
    if bar is not None:
        bar.stop()
    try:
        yield
    finally:
        if bar is not None:
            bar.start()


def _print(console: Console, text: str | Text) -> None:
    with _without_bar():
        console.print(text, markup=False, highlight=False, soft_wrap=True)


def _is_number(value: Any) -> bool:
    value = _own(value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _own(value: Any) -> Any:
    """NumPy's scalars and arrays as Python's numbers and lists, recognised by their methods, so that `calib --help` need not import NumPy."""
    return value.tolist() if hasattr(value, "tolist") else value


def _wrapped(text: str, console: Console) -> str:
    """`text` in lines that fit a terminal; unchanged elsewhere."""
    return text_table.wrapped(printable(text), console.width) if console.is_terminal else printable(text)


class Terminal(Console):
    """A console that raises BrokenPipeError if its reader has gone; rich itself would end the program."""

    def on_broken_pipe(self) -> None:
        raise


def _out() -> Console:
    """Standard output; wide enough for any table unless it is a terminal, so that a file or a pipe gets whole lines."""
    return Terminal(file=sys.stdout, width=None if sys.stdout.isatty() else 400)


def _err() -> Console:
    return Terminal(file=sys.stderr)
