"""`calib servo scan` on six mixed drives behind an emulated serial CAN FD adapter: the whole command, from start to exit.

Two makers (Damiao, RobStride), five drives switched on and one off, one with CAN FD. The emulated drives share this computer
with the command.
"""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.imports import commands
from sim.arm import load_arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.can import CanEmulator

MEASURES = ("benchmarks.servo_scan", *commands("servo"))
FAST = 5_000_000
ROBSTRIDES, FD = (2, 3), 1
RANGES = {"q": 12.57, "dq": 20.0, "tau": 60.0}
EXPECTED = {
    (1, "damiao", False),
    (2, "damiao", True),
    (3, "robstride", False),
    (4, "robstride", False),
    (5, "damiao", False),
    (6, "damiao", False),
}


def _cell(channel: Path) -> Cell:
    cell = load_cell("emulated-servo6")
    servos = []
    for j, servo in enumerate(cell.table.options["servos"]):
        robstride = {"protocol": "robstride", "ranges": RANGES} if j in ROBSTRIDES else {"fd": j == FD}
        servos.append({**servo, **robstride})
    options = {**cell.table.options, "channel": str(channel), "data_bitrate": FAST, "servos": servos}
    return dataclasses.replace(cell, table=cell.table.model_copy(update={"options": options}))


def run(repeats: int = 5) -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    times, wrong = [], 0
    with tempfile.TemporaryDirectory() as folder:
        channel = Path(folder) / "adapter.tty"
        for _ in range(repeats):
            emulator = open_emulator(_cell(channel), load_arm("servo6"))
            assert isinstance(emulator, CanEmulator)
            for servo in emulator.bus.servos[:5]:
                servo.switch(True)
            emulator.start()
            words = ["servo", "scan", "--interface", "slcan", "--channel", str(channel), "--data-bitrate", str(FAST), "--json"]
            began = time.perf_counter()
            done = subprocess.run([sys.executable, "-m", "calib.main", *words], capture_output=True, text=True, check=False)
            times.append(time.perf_counter() - began)
            on = sum(servo.on for servo in emulator.bus.servos)
            emulator.stop()
            drives = json.loads(done.stdout)["drives"] if done.returncode == 0 else []
            wrong += {(d["node"], d["protocol"], d["fd"]) for d in drives} != EXPECTED or len(drives) != 6 or on != 5
    note = "six drives of two makers, one with CAN FD, one off; slcan bytes"
    return [
        {
            "what": "servo scan: the whole command, worst",
            "value": round(max(times), 1),
            "unit": "s",
            "bar": "<= 10",
            "note": note,
        },
        {
            "what": "servo scan: scans with a wrong list, or a drive switched",
            "value": f"{wrong} of {repeats}",
            "unit": "",
            "bar": "0",
        },
    ]


if __name__ == "__main__":
    for row in run():
        print(row)
