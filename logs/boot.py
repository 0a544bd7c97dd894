"""Which start of which computer this is: a lock or a piece of shared memory means something only there."""

from __future__ import annotations

from pathlib import Path


def boot() -> str:
    """A random number that the kernel draws at each start; "" where there is none."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return ""
