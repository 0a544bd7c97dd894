"""Identity of this software: the released version, and a digest of the source that moves arms."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path


@cache
def software_version() -> str:
    """`0.1.0+3f2a9c1b04de`: package version, then twelve digits of SHA-256 over the source of safety, drivers, logs and sim.

    Two checkouts of one version with different code are distinguished: an approval given for one is not valid for the other.
    """
    return _version("safety", "drivers", "logs", "sim")


@cache
def program_version() -> str:
    """As `software_version`, over all source, calib included: results may differ where this does."""
    return _version("calib", "safety", "drivers", "logs", "sim")


def _version(*packages: str) -> str:
    try:
        release = version("arm-calib")
    except PackageNotFoundError:
        release = "0+checkout"
    root = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256()
    for package in packages:
        for file in sorted((root / package).rglob("*.py")):
            digest.update(file.relative_to(root).as_posix().encode() + b"\0" + file.read_bytes())
    return f"{release}{'.' if '+' in release else '+'}{digest.hexdigest()[:12]}"
