"""Cell files for an emulated UR10e."""

from __future__ import annotations

import json
from pathlib import Path

HOME = [0.0, -1.4, 1.3, -1.4, -1.2, 0.3]


def ur_cell(path: Path, host: str, assume: list[str] | None = None, **tables: dict[str, object]) -> Path:
    """Write a cell with the emulated UR10e at `host` to path. tables: further TOML tables by name (options, motion, ...)."""
    lines = ['schema = "cell/1"', f'name = "{path.stem}"', 'arm = "ur10e"', 'driver = "ur_rtde"', f"home = {HOME}"]
    lines += [f"assume = {json.dumps(assume)}"] if assume else []
    tables["options"] = {"host": host} | tables.get("options", {})
    for name, table in tables.items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in table.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
