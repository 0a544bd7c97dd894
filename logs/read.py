"""Read any supported recording as a Log; its format is recognised by content, not by name."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from logs.bags import ROSBAG1, SQLITE, is_sqlite_bag, read_bag
from logs.damage import Damage
from logs.log import Log
from logs.mcap_log import read_mcap
from logs.mcap_records import MAGIC
from logs.recover import recovered
from logs.rosbag2 import bag_parts
from logs.tables.table import HEAD
from logs.ur_rtde_csv import looks_like_csv, read_csv
from sim.errors import BadLog, EmptyLog
from sim.files import open_regular
from sim.resources import nearest

SUFFIXES = (".mcap", ".csv", ".db3", ".bag")
OWN_HEADS = (".mcap", ".db3", ".bag")  # formats that are known by their first bytes
PARTS = ("*.mcap", "*.db3*", "metadata.yaml")  # of a recording in a folder


def is_log(word: str) -> bool:
    """Whether `word` names a recording, and not an arm or a cell: a file with its suffix, or a folder that holds one.

    The file need not exist. A folder with an arm.toml is an arm, whatever was recorded into it.
    """
    if os.path.isdir(word):  # as Path.is_dir, but False for a name that no file can have
        folder = Path(word)
        return not (folder / "arm.toml").is_file() and any(True for part in PARTS for _ in folder.glob(part))
    return Path(word).suffix.lower() in SUFFIXES


def read_log(path: str | Path, joint_names: Sequence[str] | None = None, *, accept_partial: bool = False) -> Log:
    """Return the recording at `path`: our MCAP, a ROS 2 bag (MCAP or SQLite, file or folder), a ROS 1 bag, or ur_rtde CSV.

    Joints are matched by name: `joint_names` asks for these joints in this order; without it the order is the recording's.
    BadLog for damage, an end that was neither clean nor a kill, time that runs backwards, and values that no arm has. With
    `accept_partial` the damaged parts are left out and `Log.findings` states what is missing.
    """
    path = Path(path)
    damage = Damage(path, accept_partial)
    wanted = tuple(joint_names) if joint_names is not None else None
    if wanted is not None and (not wanted or len(set(wanted)) != len(wanted)):
        raise ValueError(f"joint_names must be different names, got {wanted}")
    if is_sqlite_bag(path):
        return read_bag(path, wanted, damage)
    if path.is_dir():
        return read_mcap(bag_parts(path, damage), wanted, damage)
    with open_regular(path, BadLog, "give a recording: .mcap, .csv or a rosbag2 folder") as file:
        head = file.read(HEAD)
    if len(head) < HEAD and not head.strip():
        size = f"{len(head)} bytes" + (", all of them blank" if head else "")
        raise EmptyLog(f"{path}: file: it is empty ({size}): nothing was recorded or copied; copy it or record it again")
    if head.startswith(MAGIC):
        recovered(path)
        return read_mcap([path], wanted, damage)
    if looks_like_csv(head):
        return _reordered(read_csv(path, accept_partial), wanted, damage)
    if head.startswith((SQLITE, ROSBAG1)):
        return read_bag(path, wanted, damage)
    if head.startswith(b"\x1f\x8b"):
        raise damage.refuse("byte 0", "compressed with gzip", f"unpack it first: gunzip --keep {path.name}")
    if path.suffix.lower() in OWN_HEADS:
        raise damage.refuse(
            "byte 0", f"not a {path.suffix} file, whatever its name: it begins as no recording does",
            "copy it again from where it was recorded, or give the right file",
        )  # fmt: skip
    raise damage.refuse(
        "byte 0", "unrecognised format",
        "supported: MCAP with ROS 2 messages, ROS bags and ur_rtde CSV (timestamp,actual_q_0,...); convert other CSV, NPZ, MAT and Parquet "
        "files with `calib import`, which asks what their columns mean",
    )  # fmt: skip


def _reordered(log: Log, wanted: tuple[str, ...] | None, damage: Damage) -> Log:
    """The log with its columns in the wanted order."""
    if wanted is None or wanted == log.joint_names:
        return log
    missing = [name for name in wanted if name not in log.joint_names]
    if missing:
        raise damage.refuse("joints", f"the recording has no {missing[0]!r}", nearest(missing[0], log.joint_names))
    return log.with_joints(wanted)
