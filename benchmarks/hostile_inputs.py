"""Inputs that `benchmarks.hostile_commands` mutates, for every command: sound files of each kind, readings, arguments."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import scipy.io
import tomli_w
from pyarrow import parquet
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

from benchmarks.hostile import ARM, sound
from benchmarks.hostile_changes import SAMPLES, Case, Mutant, bytes_of, log_of, placed, readings_of, words_of
from benchmarks.wrong_data import base
from logs.convert import write_log
from sim.resources import shipped_configs


def _sample(name: str) -> Callable[[Path], Path]:
    return lambda folder: Path(shutil.copy(SAMPLES / name, folder / ("log" + Path(name).suffix)))


MCAP, CSV = _sample("servo6_excitation.mcap"), _sample("ur10e_ur_rtde.csv")


def _beside(*words: str) -> Callable[[Path], Mutant]:
    """A command on a sound recording, GOOD, and on a second one with changed readings."""

    def begin(folder: Path) -> Mutant:
        of, log = base(f"{ARM} 2")
        write_log(log, folder / "good.mcap", "clean", {"arm": of.name, "motion": "excitation"})
        return readings_of(
            "servo6_excitation.mcap", *(str(folder / "good.mcap") if word == "GOOD" else word for word in words)
        )(folder)

    return begin


def _short(folder: Path) -> Path:
    """The first 1.5 s of a recording: read and checked in full, but too short for the search that would follow."""
    lines = (SAMPLES / "ur10e_ur_rtde.csv").read_text().splitlines(keepends=True)
    (folder / "log.csv").write_text("".join(lines[:150]))
    return folder / "log.csv"


def _table(kind: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        a = np.genfromtxt(SAMPLES / "ur10e_ur_rtde.csv", delimiter=",", names=True)
        columns = {name: np.asarray(a[name]) for name in a.dtype.names or ()}
        file = folder / f"table.{kind}"
        if kind == "npz":
            np.savez(file, **columns)  # type: ignore[arg-type]
        elif kind == "parquet":
            parquet.write_table(pyarrow.table(columns), file)
        else:
            scipy.io.savemat(file, columns)
        return file

    return write


def _bag(folder: Path) -> Path:
    """A ROS 2 bag in SQLite; the mutants change its database."""
    log, kinds = log_of("servo6_excitation.mcap"), get_typestore(Stores.ROS2_JAZZY)
    kind = kinds.types["sensor_msgs/msg/JointState"]
    of_time, of_header = kinds.types["builtin_interfaces/msg/Time"], kinds.types["std_msgs/msg/Header"]
    with rosbag2.Writer(folder / "bag", version=8, storage_plugin=rosbag2.StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/joint_states", kind.__msgtype__, typestore=kinds)
        for k in range(300):
            stamp = 10**9 + round(log.t[k] * 1e9)
            header = of_header(of_time(stamp // 10**9, stamp % 10**9), "")
            message = kind(header, list(log.joint_names), log.q[k], log.dq[k], log.tau[k])
            writer.write(topic, stamp, kinds.serialize_cdr(message, kind.__msgtype__))
    return next((folder / "bag").glob("*.db3"))


def _session(folder: Path) -> Case:
    done = {"name": "record", "arguments": ["record"], "folder": "x", "exit_code": 0, "sentence": "done", "seconds": 1.0}
    table = {
        "schema": "session/1",
        "cell": "mock-ur10e",
        "cell_sha256": "of another cell",
        "arm_sha256": "of another arm",
        "arm": "ur10e",
        "quick": True,
        "rounds": 2,
    }
    (folder / "session.toml").write_text(tomli_w.dumps(table | {"done": [done]}))
    return folder / "session.toml", ["go", "mock-ur10e", "--session", str(folder)]


def _map(folder: Path) -> Case:
    """A column map beside a table."""
    file = _table("npz")(folder)
    table = {"joints": ["a"], "time": {"column": "timestamp"}, "q": {"columns": ["actual_q_0"], "unit": "rad"}}
    (folder / "map.toml").write_text(tomli_w.dumps(table))
    return folder / "map.toml", ["import", str(file), "--map", str(folder / "map.toml"), "--out", str(folder / "out")]


def _arm(kind: str, *words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file, _ = sound(kind, folder)
        return file, [words[0], str(file if kind == "arm.urdf" else file.parent), *words[1:], "--out", str(folder / "out")]

    return make


def _new(folder: Path) -> Case:
    file, _ = sound("arm.urdf", folder)
    limits = [w for x in ("ddq_max=5", "jerk_max=100") for w in ("--limit", x)]
    return file, ["arm", "new", str(file), *limits, "--numbers", "cad", "--out", str(folder / "out")]


def _cell(*words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file = Path(shutil.copy(shipped_configs() / "cells" / "mock-ur10e.toml", folder / "cell.toml"))
        return file, [str(file) if word == "CELL" else word for word in words]

    return make


def _plan(folder: Path) -> Case:
    file, _ = sound("plan.toml", folder)
    cell = (shipped_configs() / "cells" / "mock-ur10e.toml").read_text().replace("ur10e", ARM)
    (folder / "cell.toml").write_text(cell)
    return file, ["record", str(folder / "cell.toml"), str(file.parent), "--yes", "--out", str(folder / "out")]


def _run(*words: str) -> Callable[[Path], Case]:
    def make(folder: Path) -> Case:
        file, _ = sound("run.toml", folder)
        return file, [*words, str(folder)]

    return make


def _log(write: Callable[[Path], Path], *words: str) -> Callable[[Path], Case]:
    """A command on a recording; LOG and OUT stand for their paths."""

    def make(folder: Path) -> Case:
        file = write(folder)
        return file, placed(words, folder, file)

    return make


# command and kind of input -> function that writes its mutants into a folder
CASES: dict[str, Callable[[Path], Mutant]] = {
    "identify, mcap": bytes_of(_log(MCAP, "identify", ARM, "LOG", "--out", "OUT")),
    "identify, csv": bytes_of(_log(CSV, "identify", "ur10e", "LOG", "--accept-partial", "--out", "OUT")),
    "identify, readings": readings_of("servo6_excitation.mcap", "identify", ARM, "LOG", "--out", "OUT"),
    "identify, held out": _beside("identify", ARM, "GOOD", "--holdout", "LOG", "--out", "OUT"),
    "identify, loaded": _beside("identify", ARM, "GOOD", "--loaded", "LOG", "--known-mass", "1", "--out", "OUT"),
    "diagnose, held out": _beside("diagnose", ARM, "GOOD", "--holdout", "LOG", "--out", "OUT"),
    "identify, words": words_of(
        _short, "identify", "@ur10e", "@LOG", "--cutoff", "#8", "--max-error", "#0.3", "--assume", "@as-recorded", "--configs", "@FOLDER",
        "--accept-partial", "--out", "OUT"),
    "polish, mcap": bytes_of(_log(MCAP, "polish", ARM, "LOG", "--holdout", "LOG", "--accept-partial", "--out", "OUT")),
    "polish, readings": readings_of("servo6_excitation.mcap", "polish", ARM, "LOG", "--holdout", "LOG", "--out", "OUT"),
    "validate, mcap": bytes_of(_log(MCAP, "validate", ARM, "LOG", "--no-forward", "--accept-partial", "--out", "OUT")),
    "validate, csv": bytes_of(_log(CSV, "validate", "ur10e", "LOG", "--no-forward", "--out", "OUT")),
    "validate, readings": readings_of("servo6_excitation.mcap", "validate", ARM, "LOG", "--out", "OUT"),
    "validate, words": words_of(
        _short, "validate", "@ur10e", "LOG", "--no-forward", "--cutoff", "#8", "--max-error", "#0.3", "--assume", "@as-recorded", "--out", "OUT"),
    "diagnose, csv": bytes_of(_log(_short, "diagnose", "ur10e", "LOG", "--accept-partial", "--out", "OUT")),
    "diagnose, readings": readings_of("servo6_excitation.mcap", "diagnose", ARM, "LOG", "--out", "OUT"),
    "diagnose, words": words_of(
        _short, "diagnose", "@ur10e", "@LOG", "--assume", "@swap:all:elbow_joint,wrist_1_joint", "--configs", "@FOLDER",
        "--out", "OUT"),
    "watch, mcap": bytes_of(_log(MCAP, "watch", "LOG", "--arm", ARM, "--database", "DB", "--accept-partial", "--out", "OUT")),
    "watch, readings": readings_of("servo6_excitation.mcap", "watch", "LOG", "--arm", ARM, "--database", "DB", "--out", "OUT"),
    "watch, words": words_of(
        _short, "watch", "@LOG", "--arm", "@ur10e", "--database", "DB", "--assume", "@q=deg", "--accept-partial", "--out", "OUT"),
    "fleet, mcap": bytes_of(_log(MCAP, "fleet", "FOLDER", "--workers", "0", "--no-diagnose", "--out", "OUT")),
    "fleet, readings": readings_of("servo6_excitation.mcap", "fleet", "FOLDER", "--workers", "0", "--no-diagnose", "--out", "OUT"),
    "fleet, words": words_of(_short, "fleet", "FOLDER", "--workers", "0", "--no-diagnose", "--session", "#1", "--configs", "@FOLDER", "--out", "OUT"),
    "import, mcap": bytes_of(_log(MCAP, "import", "LOG", "--out", "OUT")),
    "import, csv": bytes_of(_log(CSV, "import", "LOG", "--arm", "ur10e", "--out", "OUT")),
    "import, npz": bytes_of(_log(_table("npz"), "import", "LOG", "--arm", "ur10e", "--yes", "--out", "OUT")),
    "import, mat": bytes_of(_log(_table("mat"), "import", "LOG", "--arm", "ur10e", "--yes", "--out", "OUT")),
    "import, parquet": bytes_of(_log(_table("parquet"), "import", "LOG", "--arm", "ur10e", "--yes", "--out", "OUT")),
    "import, sqlite bag": bytes_of(_log(_bag, "import", "LOG", "--arm", ARM, "--out", "OUT")),
    "import, map": bytes_of(_map),
    "import, readings": readings_of("ur10e_ur_rtde.csv", "import", "LOG", "--arm", "ur10e", "--report", "--out", "OUT"),
    "import, words": words_of(
        _table("npz"), "import", "LOG", "--arm", "@ur10e", "--column", "@time=timestamp:s", "--column", "@q=actual_q_0,actual_q_1:rad",
        "--rate", "#500", "--joints", "@a,b", "--episode", "#0", "--assume", "@t=ms", "--yes", "--out", "OUT"),
    "replay, mcap": bytes_of(_log(MCAP, "replay", "LOG", "--arm", ARM, "--speed", "1000")),
    "replay, words": words_of(MCAP, "replay", "LOG", "--arm", "@servo6", "--speed", "#1000"),
    "export, arm.toml": bytes_of(_arm("arm.toml", "export")),
    "export, model.xml": bytes_of(_arm("model.xml", "export")),
    "export, urdf": bytes_of(_arm("arm.urdf", "export")),
    "export, words": words_of(None, "export", "@servo6", "--format", "@urdf", "--configs", "@FOLDER", "--out", "OUT"),
    "plan, arm.toml": bytes_of(_arm("arm.toml", "plan", "--period", "0.1")),
    "plan, cell.toml": bytes_of(_cell("plan", "ur10e", "--cell", "CELL", "--period", "0.1", "--out", "never-written")),
    "plan, words": words_of(
        None, "plan", "@servo6", "--cell", "@mock-servo6", "--quick", "--period", "#0.1", "--periods", "#1", "--harmonics", "#5", "--home", "@0,0,0,0,0,0",
        "--starts", "#0", "--seed", "#1", "--out", "OUT"),
    "arm new, urdf": bytes_of(_new),
    "arm new, words": words_of(
        lambda folder: sound("arm.urdf", folder)[0], "arm", "new", "LOG", "--name", "@one", "--limit", "@ddq_max=5", "--limit", "@tau_max=1,2",
        "--joints", "@*", "--lock", "@elbow_joint=1", "--tool", "@tool", "--numbers", "@cad", "--out", "OUT"),
    "arm drive, words": words_of(
        None, "arm", "drive", "@one", "--load", "@0.49,0.1", "--limit", "@q_max=1", "--limit", "@tau_max=1", "--out", "OUT"),
    "check, cell.toml": bytes_of(_cell("check", "CELL", "--seconds", "0.1")),
    "check, words": words_of(None, "check", "@mock-ur10e", "--seconds", "#0.1", "--configs", "@FOLDER"),
    "record, plan.toml": bytes_of(_plan),
    "record, words": words_of(None, "record", "@mock-ur10e", "@latest", "--operator", "@me", "--configs", "@FOLDER", "--out", "OUT"),
    "go, session.toml": bytes_of(_session),
    "go, words": words_of(None, "go", "@nowhere", "--session", "@none", "--rounds", "#2", "--configs", "@FOLDER"),
    "runs, run.toml": bytes_of(_run("runs")),
    "runs, words": words_of(None, "runs", "@latest", "--runs", "@runs"),
    "report, run.toml": bytes_of(_run("report")),
    "report, words": words_of(None, "report", "@latest", "@other", "--runs", "@runs", "--out", "OUT"),
    "effects, words": words_of(None, "effects", "@backlash"),
    "help, words": words_of(None, "help", "@plan"),
    "demo, words": words_of(None, "demo", "nowhere", "--seed", "#1", "--out", "OUT"),
    "emulate, words": words_of(None, "emulate", "@nowhere", "--fault", "@stop@1", "--seconds", "#0.1", "--configs", "@FOLDER"),
    "capture, words": words_of(None, "capture", "@mock-ur10e", "--seconds", "#0.1", "--configs", "@FOLDER", "--out", "OUT"),
    "servo, words": words_of(None, "servo", "look", "@mock-ur10e", "--configs", "@FOLDER"),
    "no command": words_of(None, "@identfy", "@ur10e", "@log.mcap"),
}  # fmt: skip
