"""Write an arm as a folder: `arm.toml` and a model file with every number at full precision."""

from __future__ import annotations

import os
import re
import tempfile
from pathlib import Path

import tomli_w

from sim.arm import ArmTable


def arm_toml_text(table: ArmTable) -> str:
    """The text of an arm.toml; rows of numbers on one line, every number as repr() has it."""
    data = {key: value for key, value in table.model_dump(by_alias=True, exclude_none=True).items() if value != []}
    text = tomli_w.dumps(data)
    # strings are escaped onto one line, so a bracket before a line break is an array
    return re.sub(
        r"\[\n((?: +[-+.\w]+,\n)+) *\]", lambda found: "[" + ", ".join(found[1].replace(",", " ").split()) + "]", text
    )


def write_atomically(file: Path, text: str) -> None:
    """`text` in `file`, whole or not at all: written beside it, flushed to disk, renamed."""
    descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(name, 0o644)
        os.replace(name, file)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
