"""kill -9 during recording, of the control program, the recording process or both: which samples are lost?

Half of the kills hit bursts. A run continues where the last one stopped (build/kills.jsonl), for `minutes` at a time, until
`count` kills are done: `make kills`. A busy computer changes only when a kill comes.
"""

from __future__ import annotations

import mmap
import os
import random
import signal
import struct
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.kept import FOLDER, Kept
from benchmarks.logs import motion, row, sample
from benchmarks.results import digest
from logs import RecorderProcess, read_log
from logs.recover import is_recording
from logs.ur_rtde_csv import UR_JOINTS

MEASURES = ("benchmarks.kills",)
VICTIMS = ("recorder", "control", "both")
STEADY = 500.0  # Hz


def victim(path: Path, board: Path, rate: float) -> int:
    """Fork a control program that records until it is killed, at `rate` Hz or, if 0, in bursts of hundreds of samples.

    It writes two numbers to the board: samples handed over so far, and the process id of the recording process.
    """
    child = os.fork()
    if child:
        return child
    try:
        with board.open("r+b") as file, mmap.mmap(file.fileno(), 16) as view:
            recorder, q, k = RecorderProcess(path, UR_JOINTS), motion(10_000), 0
            struct.pack_into("<q", view, 8, recorder._process.pid)
            while True:
                x = q[k % len(q)]
                recorder.write(sample(k, x), x, x, x)
                k += 1
                struct.pack_into("<q", view, 0, k)
                if rate or k % 300 == 0:
                    time.sleep(1 / rate if rate else 0.02)
    finally:
        os._exit(1)


def kill(number: int) -> dict[str, Any]:
    """One kill: victims, samples handed over, samples missing from the file, and whether the file reports its sample count."""
    victims, rate = VICTIMS[number % 3], (0.0, STEADY)[number // 3 % 2]
    with tempfile.TemporaryDirectory(prefix="calib-") as folder:
        board, path = Path(folder) / "board", Path(folder) / "a.mcap"
        board.write_bytes(bytes(16))
        child = victim(path, board, rate)
        with board.open("rb") as file, mmap.mmap(file.fileno(), 16, prot=mmap.PROT_READ) as view:
            while not struct.unpack_from("<q", view)[0]:
                if os.waitpid(child, os.WNOHANG)[0]:
                    raise RuntimeError("the process that records has ended by itself")
                time.sleep(0.002)
            time.sleep(random.Random(number).uniform(0, 0.3))
            if victims != "control":
                os.kill(struct.unpack_from("<q", view, 8)[0], signal.SIGKILL)
            if victims != "recorder":
                os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)  # a control program without its recorder notices and ends
            while is_recording(path):
                time.sleep(0.01)
            handed_over = struct.unpack_from("<q", view)[0]
        log = read_log(path)
    end = log.metadata["end_reason"]
    states_count = end.endswith(f"{len(log):,} samples, at most 1 lost")
    return {
        "victims": victims,
        "rate": rate,
        "handed_over": handed_over,
        "lost": handed_over - len(log),
        "says": states_count,
        "end": end,
    }


def run(minutes: float = 10.0, count: int = 300) -> list[dict[str, Any]]:
    """Run kills for `minutes`; return rows (what, value, unit, bar, note) over all done so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "kills.jsonl", " ".join(digest(path) for path in MEASURES))
    for number in range(count):
        if str(number) not in kept.found and time.monotonic() < end:
            kept.keep(str(number), kill(number))
    found = list(kept.found.values())
    if not found:
        return [row("kills done", 0, bar=str(count))]
    lost = [f["lost"] for f in found]
    worst = [f"{f['lost']} of {f['handed_over']} ({f['victims']} killed: {f['end']})" for f in found if f["lost"] > 1]
    return [
        row("kills done", len(found), bar=str(count), note="of the recorder, the control program, or both; half in bursts"),
        row("samples lost by one of them, most", max(*lost, 0), bar="<= 1", note="; ".join(worst[:3])),
        row("kills that lost any", sum(x > 0 for x in lost)),
        row("recordings that can be read and say how many samples they hold", sum(f["says"] for f in found), bar=str(len(found))),
    ]  # fmt: skip
