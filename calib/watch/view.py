"""What a watcher believes, on one screen: payload, friction of every joint against what it was, consistency, and the last events."""

from __future__ import annotations

import sys
import time
from collections import deque
from contextlib import suppress
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from calib.terminal.console import Terminal
from calib.watch.events import WatchEvent
from calib.watch.picture import Picture
from calib.watch.watcher import Watcher
from logs.recording import ERROR, WARN
from sim.files import printable

REDRAW = 0.25
KEPT = 6
CONSISTENT = (0.5, 1.6)  # of the normalised innovation squared; tails are heavier than a normal law's, models are not perfect


class WatchView:
    """A context manager; `update` as often as one likes. On a terminal a screen, elsewhere nothing but the events, a line each."""

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
            self._live.stop()

    def event(self, event: WatchEvent) -> None:
        """Something happened."""
        self._events.append(event)
        if self._live is None:
            with suppress(OSError):  # the watch goes on, and events.jsonl holds it
                self._console.print(line(event), markup=False, highlight=False, soft_wrap=True)

    def update(self, share: float, watcher: Watcher) -> None:
        """Draw, unless it was drawn a moment ago."""
        if self._live is None or time.monotonic() < self._due:
            return
        self._due = time.monotonic() + REDRAW
        self._live.update(self.screen(share, watcher.picture(), watcher.arm.joint_names), refresh=True)

    def screen(self, share: float, p: Picture, joints: tuple[str, ...]) -> Group:
        """The screen."""
        grid = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for header in ("joint", "dry N m", "viscous N m s/rad", "residual N m", "°C", "motion s"):
            grid.add_column(header, justify="left" if header == "joint" else "right", no_wrap=True)
        for j, joint in enumerate(joints):
            f = p.friction[j]
            grid.add_row(
                Text(joint), f"{f.coulomb.value:.2f} ± {2 * f.coulomb.std:.2f}", f"{f.viscous.value:.2f} ± {2 * f.viscous.std:.2f}",
                _number(p.residual[j]), _number(f.temperature), f"{p.moved[j]:.0f}",
            )  # fmt: skip
        good = CONSISTENT[0] < p.nis < CONSISTENT[1]
        consistency = (
            "–" if np.isnan(p.nis) else f"{p.nis:.2f}" + ("" if good else f", expected {CONSISTENT[0]:g} to {CONSISTENT[1]:g}")
        )
        done = f"   {share:.0%}" if share else ""
        return Group(
            Text(f"{self._title}   {p.t:.1f} s{done}", style="bold"),
            Text(printable(p.sentence)),
            Text.assemble("consistency (NIS/degrees) ", (consistency, "" if good or np.isnan(p.nis) else "yellow")),
            grid,
            *(
                Text(line(e), style="bold red" if e.level >= ERROR else "yellow" if e.level >= WARN else "")
                for e in self._events
            ),
            Text("Ctrl-C: end the watch; nothing is ever commanded", style="reverse"),
        )


def line(event: WatchEvent) -> str:
    """An event as a person reads it."""
    return f"{event.t:10.3f} s  {printable(event.message)}"


def _number(x: float) -> str:
    return f"{x:.2f}" if np.isfinite(x) else "–"
