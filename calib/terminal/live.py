"""The live view of a run on one screen: every joint against its limits, what is recorded, and how to stop.

On a terminal the view is redrawn ten times a second; elsewhere it is one plain line every 5 s. The same view replays a log.
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from calib.terminal.console import Terminal
from sim.arm import Arm
from sim.files import printable

if TYPE_CHECKING:
    from safety.run_progress import RunProgress

BAR = 9
BARRED = 58  # width in characters beside a joint's name with bars and full headers; a narrower terminal shows the numbers only
REDRAW = 0.1
PLAIN = 5.0
_FILL = " ▏▎▍▌▋▊▉█"
_NEAR, _OVER = 0.8, 1.0


@dataclass(frozen=True)
class Snapshot:
    """One moment of a run; arrays (n,) in rad, rad/s, N m, degC, NaN where the device reports nothing.

    stage: which of the staged runs this is ("2 of 3"). speed: its share of the planned speed. elapsed, duration: s of the motion.
    left: s of the whole run. frames, lost: received and lost so far. disk_free: bytes, None if nothing is recorded. note: the last
    event, as a sentence.
    """

    motion: str
    stage: str
    speed: float
    elapsed: float
    duration: float
    q: np.ndarray
    dq: np.ndarray
    tau: np.ndarray
    temperature: np.ndarray
    q_cmd: np.ndarray
    frames: int
    lost: int
    disk_free: float | None = None
    note: str = ""
    left: float | None = None


class LiveView:
    """A context manager around a run; `update` may be called at any rate and draws at a readable one.

    keys: what can be pressed, and what it does; always shown at the bottom of the screen.
    """

    def __init__(
        self, arm: Arm, title: str, keys: Mapping[str, str], following_error_max: float = np.inf, console: Console | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:  # fmt: skip
        self._arm, self._title, self._keys, self._error_max = arm, title, dict(keys), following_error_max
        self._console = console or Terminal(file=sys.stderr)
        self._now, self._due = now, -np.inf
        self._live: Live | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live = Live(console=self._console, auto_refresh=False, transient=True, vertical_overflow="crop")
            self._live.start()
            self._live.update(self._waiting("", 0.0), refresh=True)
        else:
            self._print(f"{self._title}; {self._keys_line()}")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._live:
            with suppress(OSError):  # the terminal may be gone; the outcome of the run must not be lost
                self._live.stop()

    @property
    def due(self) -> bool:
        """Whether the next snapshot would be drawn."""
        return self._now() >= self._due

    def update(self, snapshot: Snapshot, force: bool = False) -> None:
        """Draw the snapshot, unless the last was drawn too recently or `force` is set."""
        now = self._now()
        if now < self._due and not force:
            return
        if self._live:
            self._due = now + REDRAW
            self._live.update(self.screen(snapshot), refresh=True)
        else:
            self._due = now + PLAIN
            self._print(self.line(snapshot))

    def prepare(self, what: str, share: float) -> None:
        """Show what is prepared before anything moves, and the completed share."""
        if self._live and self._now() >= self._due:
            self._due = self._now() + REDRAW
            self._live.update(self._waiting(what, share), refresh=True)

    def _waiting(self, what: str, share: float) -> Group:
        head = Text.assemble((f"{self._title}\n", "bold"), (_bar(share, 24), "cyan"), f"  {what}")
        return Group(head, Text("Nothing moves yet."), Text(self._keys_line(), style="reverse"))

    def line(self, s: Snapshot) -> str:
        """The snapshot as one line: progress, and the joint nearest to each limit."""
        parts = [f"{s.motion} (stage {s.stage}, {s.speed:.0%} speed) {s.elapsed:.1f} of {s.duration:.1f} s"]
        for word, share in (("speed", np.abs(s.dq) / self._arm.dq_max), ("torque", np.abs(s.tau) / self._arm.tau_max)):
            if np.any(np.isfinite(share)):
                parts.append(f"{word} up to {np.nanmax(share):.0%} ({self._arm.joint_names[int(np.nanargmax(share))]})")
        error = np.abs(s.q - s.q_cmd)
        if np.any(np.isfinite(error)):
            parts.append(
                f"following error {1000 * np.nanmax(error):.1f} mrad ({self._arm.joint_names[int(np.nanargmax(error))]})"
            )
        if np.any(np.isfinite(s.temperature)):
            parts.append(f"{np.nanmax(s.temperature):.0f} °C")
        parts.append(f"{s.frames} frames, {s.lost} lost")
        return ", ".join(parts) + (f"; {s.note}" if s.note else "")

    def screen(self, s: Snapshot) -> Group:
        """The snapshot as a screen."""
        share = min(1.0, s.elapsed / s.duration) if s.duration > 0 else 1.0
        head = Text.assemble(
            (f"{self._title}\n", "bold"),
            f"{s.motion}   stage {s.stage}   {s.speed:.0%} speed\n",
            (_bar(share, 24), "cyan"),
            f"  {max(0.0, s.duration - s.elapsed):.0f} s left",
            "" if s.left is None else f" (run {_minutes(s.left)})",
        )
        grid = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0))
        barred = self._console.width >= BARRED + max(map(len, self._arm.joint_names))
        headers = (
            ("position rad", "speed", "torque N m", "°C", "error mrad") if barred else ("rad", "speed", "N m", "°C", "mrad")
        )
        grid.add_column("joint", overflow="ellipsis")  # the only column that may shrink
        for header in headers:
            grid.add_column(header, justify="right", no_wrap=True)
        for j, joint in enumerate(self._arm.joint_names):
            grid.add_row(Text(joint), *self._joint(s, j, barred))
        lost = (f"{s.lost} lost", "bold red") if s.lost else ("none lost", "")
        disk = "" if s.disk_free is None else f"   disk {s.disk_free / 1e9:.1f} GB free"
        foot = Text.assemble(f"{s.frames} frames, ", lost, disk, f"\n{printable(s.note)}" if s.note else "")
        return Group(head, grid, foot, Text(self._keys_line(), style="reverse"))

    def _joint(self, s: Snapshot, j: int, barred: bool) -> list[Text]:
        arm = self._arm
        place = (s.q[j] - arm.q_min[j]) / (arm.q_max[j] - arm.q_min[j])
        mark = int(np.clip(place, 0, 1) * (BAR - 1)) if np.isfinite(place) else None
        rail = "".join("●" if k == mark else "─" for k in range(BAR)) + " " if barred else ""
        edge = abs(2 * place - 1)
        speed, load = abs(s.dq[j]) / arm.dq_max[j], abs(s.tau[j]) / arm.tau_max[j]
        error = abs(s.q[j] - s.q_cmd[j])
        moving, loaded = (f"{_bar(x, 6)} " if barred else "" for x in (speed, load))
        return [
            Text(f"{rail}{s.q[j]:+6.2f}", style=_style(edge, 0.95)),
            Text(f"{moving}{speed:4.0%}", style=_style(speed)) if np.isfinite(speed) else Text("–"),
            Text(f"{loaded}{s.tau[j]:+7.1f}", style=_style(load)) if np.isfinite(s.tau[j]) else Text("–"),
            Text(f"{s.temperature[j]:.0f}" if np.isfinite(s.temperature[j]) else "–"),
            Text(f"{1000 * error:.1f}", style=_style(error / self._error_max)) if np.isfinite(error) else Text("–"),
        ]

    def _keys_line(self) -> str:
        return "   ".join(f"{key}: {what}" for key, what in self._keys.items())

    def _print(self, sentence: str) -> None:
        self._console.print(printable(sentence), markup=False, highlight=False, soft_wrap=True)


def show(view: LiveView, progress: RunProgress, folder: Path) -> None:
    """Show the progress of a run that is recorded into `folder`."""
    cycle, p = progress.cycle, progress
    if cycle is None:
        view.prepare(p.what, p.share)
        return
    if not view.due:
        return
    state = cycle.state
    view.update(
        Snapshot(
            p.what, f"{p.stage} of {p.stages}", p.speed, p.share * p.duration, p.duration, state.q, state.dq, state.tau,
            state.temperature, cycle.q_cmd, p.frames, p.lost, shutil.disk_usage(folder).free, "", p.left,
        )
    )  # fmt: skip


def _minutes(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def _bar(share: float, width: int) -> str:
    """A bar of `width` characters, filled to an eighth of a character."""
    if not np.isfinite(share):
        return " " * width
    eighths = round(min(1.0, max(0.0, float(share))) * width * 8)
    full, rest = divmod(eighths, 8)
    return ("█" * full + (_FILL[rest] if rest else "")).ljust(width)


def _style(share: float, near: float = _NEAR) -> str:
    """Red at or above the limit and for NaN, yellow near it."""
    if not share < _OVER:
        return "bold red"
    return "yellow" if share >= near else ""
