"""The screen of a watch: payload, friction and residual of every joint, consistency, and the last events."""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Self

import numpy as np
from rich.cells import cell_len
from rich.console import Group
from rich.live import Live
from rich.text import Text

from calib.terminal import text_table
from calib.terminal.console import Terminal
from calib.watch.events import Quantity, WatchEvent
from calib.watch.picture import Picture
from calib.watch.watcher import Watcher
from logs.recording import ERROR, WARN
from sim.files import printable

HEADERS = (
    "joint",
    "dry N m",
    "viscous N m s/rad",
    "residual N m",
    "motion s",
    "°C",
)  # where there is little room, only the first ones are shown
REDRAW = 0.25
KEPT = 6
CONSISTENT = (0.5, 1.6)  # of the normalised innovation squared: tails are heavier than normal, and models are not perfect


class WatchView:
    """A context manager: on a terminal a screen, elsewhere only the events, a line each. `update` may be called at any rate."""

    def __init__(self, title: str) -> None:
        self._title, self._console = title, Terminal(file=sys.stderr)
        self._live: Live | None = None
        self._due = -np.inf
        self._events: deque[WatchEvent] = deque(maxlen=KEPT)

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, transient=True, vertical_overflow="crop")
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._live:
            with suppress(OSError):  # the terminal has gone; the outcome must not be lost
                self._live.stop()

    def event(self, event: WatchEvent) -> None:
        """Show an event."""
        self._events.append(event)
        if self._live is None:
            with suppress(OSError):  # the watch goes on, and events.jsonl holds it
                self._console.print(line(event), markup=False, highlight=False, soft_wrap=True)

    def update(self, share: float, watcher: Watcher) -> None:
        """Draw the screen, at most every `REDRAW` seconds."""
        if self._live is None or time.monotonic() < self._due:
            return
        self._due = time.monotonic() + REDRAW
        with suppress(OSError):
            self._live.update(self.screen(share, watcher.picture(), watcher.arm.joint_names), refresh=True)

    def screen(self, share: float, p: Picture, joints: tuple[str, ...]) -> Group:
        """The screen."""
        rows = [
            [joint, _interval(f.coulomb if f else None), _interval(f.viscous if f else None), _number(p.residual[j]), f"{p.moved[j]:.0f}",
             _number(p.friction[j].temperature)]
            for j, joint in enumerate(joints) for f in [p.measured(j)]
        ]  # fmt: skip
        width = self._console.width
        kept = _columns_within([HEADERS, *rows], width)
        grid = text_table.lines(HEADERS[:kept], [row[:kept] for row in rows], [k > 0 for k in range(kept)], width)
        good = CONSISTENT[0] < p.nis < CONSISTENT[1]
        consistency = (
            "–" if np.isnan(p.nis) else f"{p.nis:.2f}" + ("" if good else f", expected {CONSISTENT[0]:g} to {CONSISTENT[1]:g}")
        )
        at = f"   {p.t:.1f} s" if np.isfinite(p.t) else ""
        done = f"   {share:.0%}" if share else ""
        return Group(
            Text(f"{self._title}{at}{done}", style="bold"),
            Text(printable(p.sentence)),
            Text.assemble("consistency (NIS/degrees) ", (consistency, "" if good or np.isnan(p.nis) else "yellow")),
            *(Text(text, style="bold" if heading else "") for text, heading in grid),
            *(
                Text(line(e), style="bold red" if e.level >= ERROR else "yellow" if e.level >= WARN else "")
                for e in self._events
            ),
            Text("Ctrl-C: end the watch; nothing is ever commanded", style="reverse"),
        )


def line(event: WatchEvent) -> str:
    """An event as a line of text."""
    return f"{event.t:10.3f} s  {printable(event.message)}"


def _columns_within(rows: Sequence[Sequence[str]], width: int) -> int:
    """How many of the first columns fit side by side, at least two: the others are left out, so that no number is cut."""
    ends = np.cumsum([max(cell_len(row[k]) for row in rows) + len(text_table.GAP) for k in range(len(rows[0]))])
    return max(2, int(np.count_nonzero(ends - len(text_table.GAP) <= width)))


def _interval(x: Quantity | None) -> str:
    return "–" if x is None else f"{x.value:.2f} ± {2 * x.std:.2f}"


def _number(x: float) -> str:
    return f"{x:.2f}" if np.isfinite(x) else "–"
