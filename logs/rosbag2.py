"""rosbag2 folders: metadata.yaml beside one or more MCAP files (rosbag2_storage_mcap); logs.bags reads those in SQLite."""

from __future__ import annotations

import re
from pathlib import Path

from logs.damage import Damage

MAX_PARTS = 1000


def bag_parts(folder: Path, damage: Damage) -> list[Path]:
    """The MCAP files of the bag in the order of recording: rosbag2 numbers them name_0.mcap, name_1.mcap, ..."""
    parts = sorted(folder.glob("*.mcap"), key=_order)
    if not parts:
        raise damage.refuse("folder", "it holds no .mcap file and no .db3 file", "give a rosbag2 folder")
    if len(parts) > MAX_PARTS:
        raise damage.refuse("folder", f"{len(parts)} parts, at most {MAX_PARTS} are read", "give one recording")
    if len(parts) > 1 and not (folder / "metadata.yaml").is_file():
        raise damage.refuse(
            "folder", f"{len(parts)} MCAP files and no metadata.yaml: not one recording in parts", "name one of the files"
        )
    return parts


def _order(part: Path) -> tuple[str, int]:
    match = re.fullmatch(r"(.*?)_(\d+)", part.stem)
    return (match[1], int(match[2])) if match else (part.stem, -1)
