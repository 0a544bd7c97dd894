"""What a recording carries so that it can be used elsewhere: the arm as URDF; arm folder, cell and plan as attachments."""

from __future__ import annotations

import base64
import hashlib
import json
import mimetypes
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.records import Attachment

from logs.damage import Damage
from logs.mcap_records import MAGIC
from logs.mcap_stream import McapStream
from logs.schemas import RECORDING
from sim.errors import BadLog, CalibError
from sim.files import MAX_TABLE, open_regular, read_bytes

if TYPE_CHECKING:
    from sim.arm import Arm
    from sim.cell import Cell

ARM_FOLDER, CELL_FILE, PLAN_FILE = "arm", "cell.toml", "plan.toml"
MOST = 16 << 20  # bytes of an arm's meshes; above this they are left out
_PART = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_ .+-]{0,99}", re.ASCII)
_DEEP = 6


@dataclass(frozen=True)
class About:
    """urdf: the arm for viewers, "" where there is none; files: name in the recording -> content."""

    urdf: str = ""
    files: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def frame(self) -> str:
        """The arm's base link, which `sim.urdf` writes first; "" without a URDF. It is the `frame_id` of the messages."""
        found = re.search(r'<link name="([^"<>&]+)"', self.urdf)
        return found[1] if found else ""

    def attached(self, now: int) -> list[Attachment]:
        """The files as MCAP attachments with the time `now` (ns since 1970)."""
        return [
            Attachment(create_time=now, log_time=now, name=name, media_type=_media(name), data=data)
            for name, data in self.files.items()
        ]

    def shared(self) -> int:
        """Return a descriptor from which another process can read this; the caller closes it."""
        text = json.dumps([self.urdf, {name: base64.b64encode(data).decode() for name, data in self.files.items()}])
        fd = os.memfd_create("arm-calib-about", os.MFD_CLOEXEC)
        with os.fdopen(os.dup(fd), "wb") as stream:
            stream.write(text.encode())
        return fd

    @staticmethod
    def received(fd: int) -> About:
        """Return the About behind a descriptor from `shared`, and close the descriptor."""
        with os.fdopen(fd, "rb") as stream:
            stream.seek(0)
            urdf, files = json.loads(stream.read())
        return About(urdf, {name: base64.b64decode(data) for name, data in files.items()})


def about_recording(arm: Arm, cell: Cell | None = None, plan: Path | None = None) -> About:
    """Return what a recording of this arm carries; arm and cell files that changed since they were read are left out."""
    from sim.urdf import viewer_text

    files = _arm_files(arm)
    if cell is not None:
        raw = _content(cell.path, MAX_TABLE)
        if raw is not None and hashlib.sha256(raw).hexdigest() == cell.sha256:
            files[CELL_FILE] = raw
    sealed = None if plan is None else _content(plan / PLAN_FILE, MAX_TABLE)
    if sealed is not None:
        files[PLAN_FILE] = sealed
    return About(viewer_text(arm), files)


def attachments(path: Path) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return the attachments of an MCAP file and its metadata record `recording`; both empty for other kinds of file.

    For a folder, those of its only MCAP file: a bag in several parts is not one of our recordings.
    """
    if path.is_dir():
        parts = list(path.glob("*.mcap"))
        return attachments(parts[0]) if len(parts) == 1 else ({}, {})
    with open_regular(path, BadLog, "give a recording") as file:
        if file.read(len(MAGIC)) != MAGIC:
            return {}, {}
        file.seek(0)
        stream = McapStream(file, os.fstat(file.fileno()).st_size, Damage(path, accept_partial=True), attachments={})
        for _ in stream.batches():
            pass
    return {name: item.data for name, item in (stream.attachments or {}).items()}, stream.metadata.get(RECORDING, {})


def _arm_files(arm: Arm) -> dict[str, bytes]:
    from sim.model_text import asset_files

    folder = arm.model_path.parent
    table = _content(folder / "arm.toml", MAX_TABLE)
    model = arm.model_text.encode()
    if table is None or hashlib.sha256(table + model).hexdigest() != arm.sha256:
        return {}
    files = {f"{ARM_FOLDER}/arm.toml": table, f"{ARM_FOLDER}/{arm.model_path.name}": model}
    meshes: dict[str, bytes | None] = {}
    room = MOST
    for name, source in asset_files(arm.model_text, folder).items():
        data = _content(source, room)
        meshes[f"{ARM_FOLDER}/{name}"] = data
        room -= len(data or b"")
    whole = all(data is not None and is_inside(name) for name, data in meshes.items())
    return files | {name: data for name, data in meshes.items() if data is not None} if whole else files


def _content(file: Path, most: int) -> bytes | None:
    try:
        return read_bytes(file, max(most, 0))
    except CalibError:
        return None


def is_inside(name: str) -> bool:
    """Whether an attachment's name is a plain path below the arm's folder; nothing else is ever written as a file."""
    parts = name.split("/")
    return parts[0] == ARM_FOLDER and 2 <= len(parts) <= _DEEP and all(_PART.fullmatch(part) for part in parts[1:])


def _media(name: str) -> str:
    known = {".toml": "application/toml", ".xml": "application/xml", ".stl": "model/stl", ".obj": "model/obj"}
    return known.get(Path(name).suffix.lower()) or mimetypes.guess_type(name)[0] or "application/octet-stream"
