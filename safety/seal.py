"""A text file whose first line holds the SHA-256 of the rest, so that any changed byte is refused; and the files beside it."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from sim.errors import ConfigError, SafetyStop
from sim.files import as_text, read_bytes


def sealed(body: str) -> bytes:
    """`body` preceded by a line that holds its SHA-256."""
    return f'sha256 = "{hashlib.sha256(body.encode()).hexdigest()}"\n{body}'.encode()


def unsealed(file: Path, raw: bytes, remedy: str = "make it again") -> tuple[str, str]:
    """(text, sha256) of a sealed file; SafetyStop if the seal does not match the content."""
    first, _, rest = raw.partition(b"\n")
    digest = hashlib.sha256(rest).hexdigest()
    if first != f'sha256 = "{digest}"'.encode():
        raise SafetyStop(f"{file}: its content does not match its first line; it was changed after it was written, {remedy}")
    return as_text(rest, file, remedy=remedy), digest


def read_plan_file(file: Path, most: int, remedy: str = "make the plan again with `calib plan`") -> bytes:
    """The content of a file of a plan folder. Links are refused: anybody may own what they point to."""
    if os.path.islink(file):
        raise ConfigError(
            f"{file}: not a regular file; a plan folder holds plan.toml and one .npy per motion, no links; {remedy}"
        )
    return read_bytes(file, most, remedy=remedy)
