"""Free and loaded recordings of one real UR10e, watched with the arm identified from some of them, and as other arms."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from calib.identification.calibrated import write_calibrated
from calib.identification.identify import identify
from calib.watch.events import WatchEvent
from calib.watch.picture import Picture
from calib.watch.source import from_log
from calib.watch.watcher import Watcher
from logs import read_log
from sim.arm import load_arm
from sim.arm_folder import write_arm

FITTED = ("excitation_20s_8h", "excitation_20s_10h", "excitation_30s_12h", "excitation_40s_12h")
FREE = (
    "excitation_free_b",
    "excitation_20s_5h",
    "excitation_50s_12h",
    "ptp_10_points",
    "single_joint_2",
    "single_joint_5",
    "static_hold_3",
)
LOADED = ("excitation_load_b",)


def row(what: str, value: Any, bar: str, note: str) -> dict[str, Any]:
    return {"what": what, "value": value, "unit": "", "bar": bar, "note": note}


def listed(events: list[WatchEvent]) -> str:
    """Time, kind and joint of each event."""
    return ", ".join(f"{e.t:.1f} s {e.kind.value}" + (f" {e.joint}" if e.joint else "") for e in events)


def real(folder: Path) -> list[dict[str, Any]]:
    """Watch the recordings with the arm identified from FITTED, and two of them with the models of other arms."""
    out = []
    with tempfile.TemporaryDirectory() as scratch:
        arm = _identified(folder, Path(scratch) / "arm")
        for name in (*FITTED, *FREE, *LOADED):
            events, picture = _watched(folder / f"{name}.csv", arm)
            about = [e for e in events if e.about == "arm"]
            bar = "1 payload" if name in LOADED else "0"
            out.append(row(f"real UR10e, {name}: events about the arm", listed(about) or 0, bar, picture.sentence))
        for other in ("ur16e", "ur20", "ur5e", "ur3e"):
            # with the right arm's torque constants: without them its currents are refused
            wrong = replace(load_arm(other), torque_constant=load_arm("ur10e").torque_constant)
            write_arm(Path(scratch) / other, wrong)
            for name in ("excitation_free_b", "excitation_30s_12h"):
                events, picture = _watched(folder / f"{name}.csv", str(Path(scratch) / other))
                what = f"real UR10e, {name}, watched as {other}: events about the arm"
                out.append(row(what, sum(e.about == "arm" for e in events), "0", picture.sentence))
    return out


def _identified(folder: Path, out: Path) -> str:
    nominal = load_arm("ur10e")
    logs = [read_log(folder / f"{name}.csv", nominal.joint_names, accept_partial=True) for name in FITTED]
    write_calibrated(out, nominal, identify(nominal, logs).arm)
    return str(out)


def _watched(path: Path, arm: str) -> tuple[list[WatchEvent], Picture]:
    source = from_log(path, arm, accept_partial=True)
    watcher = Watcher(source.arm, source.rate, gravity=source.gravity)
    return [e for s in source.states for e in watcher.add(s)], watcher.picture()
