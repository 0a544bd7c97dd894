"""Storage for work done in slices: findings stay in a file under build/, and the next run continues from them."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "build"


class Kept:
    """Findings by name, one JSON line each in `file` (None: not stored), that belong to `of`: code, seed, other inputs.

    Findings of any other `of` stay in the file and are not returned.
    """

    def __init__(self, file: Path | None, of: str) -> None:
        self._file, self._of = file, of
        self.found: dict[str, Any] = {}
        for line in file.read_text(encoding="utf-8").splitlines() if file and file.is_file() else []:
            with suppress(json.JSONDecodeError):  # skip a line that was cut off
                entry = json.loads(line)
                if entry["of"] == of:
                    self.found[entry["what"]] = entry["found"]

    def keep(self, what: str, found: Any) -> None:
        """Store one finding, on disk at once."""
        if what in self.found:
            return
        self.found[what] = found
        if self._file:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with self._file.open("a+b") as out:
                whole = out.tell() == 0 or (out.seek(-1, 2) and out.read(1) == b"\n")
                out.write(b"" if whole else b"\n")
                out.write((json.dumps({"of": self._of, "what": what, "found": found}) + "\n").encode())
