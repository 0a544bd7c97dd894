"""Which boot of which computer this is: a lock or shared memory is meaningful only within it."""

from __future__ import annotations

from pathlib import Path


def boot() -> str:
    """Return the random number that the kernel draws at each boot; "" where there is none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""
