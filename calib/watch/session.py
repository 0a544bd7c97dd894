"""One watch from the first reading to the last: every event goes to the log's /events, to events.jsonl and to the caller.

DIR/events.jsonl   one event a line, in order
DIR/watch.mcap     the events on /events, and one reading a second; with `samples` every reading. Watched itself, it counts as the same run
DIR/watch.json     the estimates at the end, which also go into the table of trends
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from calib.terminal.console import plain
from calib.watch.events import CONCERNS, WatchEvent
from calib.watch.live_gate import LiveGate
from calib.watch.picture import Picture
from calib.watch.recorded import WATCHED_RECORDED, WATCHED_RECORDING
from calib.watch.source import Source, until
from calib.watch.trend_table import RECORDED, WATCHED, RunRecord, TrendTable
from calib.watch.watcher import Watcher, rehearse
from logs.recorder import Recorder
from logs.recording import COMPLETED, ERROR, INFO
from sim.errors import BadLog, DeviceError

DECLARED_EVERY = 0.2  # s between two queries of the declared payload


@dataclass(frozen=True)
class Watched:
    """Result of a watch: the events, the last picture, seconds watched, and whether its numbers were kept in the table of trends.

    started is when the readings were recorded or, where `dated` is "watched", only when they were watched. fault is the error of the
    device or the disk that ended the watch. refusal is why the readings cannot be the arm's; nothing is claimed then.
    """

    source: Source
    events: tuple[WatchEvent, ...]
    picture: Picture
    seconds: float
    kept: bool
    started: datetime
    dated: str
    fault: DeviceError | None = None
    refusal: str | None = None

    @property
    def sentence(self) -> str:
        """What was seen, in one sentence."""
        count = len(self.events)
        time = f" in {self.seconds:.1f} s" if np.isfinite(self.seconds) else ""
        return f"{count} event{'' if count == 1 else 's'}{time}; {self.picture.sentence}"

    @property
    def concerns(self) -> tuple[WatchEvent, ...]:
        """The events that need attention."""
        return tuple(e for e in self.events if e.kind in CONCERNS)

    def as_dict(self) -> dict[str, Any]:
        """Schema watch/1."""
        p, arm = self.picture, self.source.arm
        return {
            "schema": "watch/1", "arm": arm.name, "source": self.source.name, "seconds": self.seconds, "samples": p.samples,
            "started": self.started.isoformat(), "dated": self.dated, "fault": None if self.fault is None else str(self.fault),
            "refusal": self.refusal, "fits": p.fits if self.refusal is None else False, "outcome": self.refusal or p.sentence,
            "payload": p.payload if p.settled and self.refusal is None else None, "com": p.com if self.refusal is None else None, "nis": p.nis,
            "faults": p.faults, "trend": self.kept,
            "joints": [
                {
                    "joint": joint, "moved": p.moved[j], "seconds": p.seconds[j], "coulomb": f and f.coulomb, "viscous": f and f.viscous,
                    "residual": p.residual[j], "compared_from": p.compared_from[j], "temperature": p.friction[j].temperature,
                }
                for j, joint in enumerate(arm.joint_names)
                for f in [p.measured(j)]
            ],
            "events": [e.as_dict() for e in self.events],
        }  # fmt: skip


def watch(
    source: Source,
    folder: Path,
    *,
    seconds: float | None = None,
    samples: bool = False,
    database: Path | None = None,
    on_event: Callable[[WatchEvent], None] = lambda event: None,
    on_picture: Callable[[float, Watcher], None] = lambda share, watcher: None,
    now: Callable[[], datetime] = lambda: datetime.now(UTC),
) -> Watched:
    """Watch to the end of the log, or for `seconds` on the device's clock; on_picture gets the share done.

    A device failure ends the watch as well: the result then holds what was seen so far, and the fault.

    BadLog where live readings cannot be the arm's (calib.watch.live_gate). What was read so far stays in the folder, and watch.json
    states the reason.
    """
    started = source.recorded or now()
    dated = WATCHED if source.recording and source.recorded is None else RECORDED
    recording = source.recording or f"{source.name} {started.isoformat()}"
    if database is not None and database.exists():
        with TrendTable(database):  # a file that is not a table is refused before anything is watched
            pass
    rehearse(source.arm, source.rate)
    watcher = Watcher(source.arm, source.rate, source.declared_now(), source.gravity)
    gate = LiveGate(source.arm, source.name, source.rate, source.gravity) if source.gated else None
    refusal: str | None = None
    fault: DeviceError | None = None
    note: tuple[int, str, str] | None = None
    events: list[WatchEvent] = []
    metadata = {
        "arm": source.arm.name,
        "arm_sha256": source.arm.sha256,
        "source": source.name,
        "rate": source.rate,
        WATCHED_RECORDING: recording,
        WATCHED_RECORDED: started.isoformat() if dated == RECORDED else "",
        **source.facts,
    }
    first = last = last_declared = written = np.nan
    with (
        (folder / "events.jsonl").open("w", encoding="utf-8") as lines,
        Recorder(folder / "watch.mcap", source.arm.joint_names, metadata) as recorder,
    ):
        try:
            for state in until(source.states, seconds):
                if np.isfinite(state.t_device):  # a reading without a time cannot be recorded
                    first, last = (state.t_device if np.isnan(first) else first), state.t_device
                    if samples or not last - written < 1.0:
                        written = last
                        recorder.write(replace(state, t_device=source.t_origin + last))
                if not last - last_declared < DECLARED_EVERY:
                    last_declared, watcher.declared = last, source.declared_now()
                for event in watcher.add(state):
                    events.append(event)
                    recorder.event(event.level, event.kind.value, event.message, source.t_origin + event.t)
                    lines.write(json.dumps(plain(event.as_dict()), allow_nan=False) + "\n")
                    lines.flush()
                    on_event(event)
                on_picture((last - first) / source.duration if source.duration else 0.0, watcher)
                refusal = gate.add(state) if gate is not None else None
                if refusal is not None:
                    break
        except KeyboardInterrupt:
            note = INFO, "watch", "ended by the operator"
        except DeviceError as error:
            fault, note = error, (ERROR, "device", str(error))
        if gate is not None and (refusal := refusal or gate.end()) is not None:
            note = ERROR, "gate", refusal
        try:
            if note is not None:
                recorder.event(*note, source.t_origin + (last if np.isfinite(last) else 0.0))
            recorder.close(COMPLETED if fault is None else f"{type(fault).__name__}: {fault}")
        except DeviceError as error:  # the recording itself has failed
            fault = fault or error
            with suppress(DeviceError):
                recorder.close(str(fault))
    picture = watcher.picture()
    kept = refusal is None and bool(picture.fits) and picture.settled and database is not None
    if kept and database is not None:
        with TrendTable(database) as table:
            cell, serial = (str(source.facts.get(key, "")) for key in ("cell", "serial"))
            table.add(RunRecord.of(source.arm, source.name, started, picture, recording, dated, cell, serial))
    found = Watched(source, tuple(events), picture, float(last - first), kept, started, dated, fault, refusal)
    (folder / "watch.json").write_text(json.dumps(plain(found.as_dict()), indent=2, allow_nan=False) + "\n", encoding="utf-8")
    if refusal is not None:
        raise BadLog(refusal)
    return found
