"""Measured figures as files: results/NAME.json, written by the command that measured, read by README and docs.

A figure is a row of the benchmarks: `what`, `value`, and optionally `unit`, `bar`, `note`. A file also holds the commit, the date, the
command line, the machine's load and a digest of the code that was measured, so that a page can be built from it and an outdated figure
is found.
"""

from __future__ import annotations

import ast
import hashlib
import io
import json
import os
import platform
import re
import statistics
import tempfile
import time
import tokenize
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.imports import ROOT, files, git
from benchmarks.wording import structure

FOLDER = ROOT / "results"
SCHEMA = "results/1"
SHOWN = 3
CODE = ("calib", "safety", "drivers", "logs", "sim")
KEYS = ("what", "value", "unit", "bar", "note")
NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,63}")


def write(
    name: str,
    rows: Sequence[Mapping[str, Any]],
    *,
    command: str,
    measures: Sequence[str] = CODE,
    load_before: float | None = None,
    folder: Path | None = None,
) -> Path:
    """Write results/NAME.json and return its path.

    name: of the figure set, lower case. rows: dicts with what (unique in the file) and value (text or number), and optionally unit, bar,
    note. command: what a reader types to measure again. measures: the paths, from the checkout's root, and the modules with
    all that they import (`calib.commands.diagnose`), whose change outdates the figures.
    load_before: the 1 min load average when the measurement began; the one at its end is added. ValueError names a row that is wrong.
    """
    if not NAME.fullmatch(name):
        raise ValueError(f"results name {name!r}: needs lower-case letters, digits, - and _")
    folder = folder or FOLDER
    kept = [_checked(row) for row in rows]
    doubles = {row["what"] for row in kept if sum(r["what"] == row["what"] for r in kept) > 1}
    if doubles:
        raise ValueError(
            f"results {name}: more than one row is called {sorted(doubles)[0]!r}; a page could not name one of them"
        )
    content = {
        "schema": SCHEMA,
        "name": name,
        "command": command,
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "commit": git("rev-parse", "--short=12", "HEAD"),
        "uncommitted": bool(
            git("status", "--porcelain", "--untracked-files=no", "--", *(f for path in measures for f in files(path)))
        ),
        "machine": {
            "platform": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
            "cores": os.cpu_count(),
            "load_before": load_before,
            "load_after": round(os.getloadavg()[0], 2),
            "reference_ms": round(1000 * reference_time()),
        },
        "measures": {path: digest(path) for path in measures},
        "rows": kept,
    }
    folder.mkdir(exist_ok=True)
    place = folder / f"{name}.json"
    place.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return place


def reference_time() -> float:
    """Processor time of a fixed calculation, s, median of five: a shared computer may be half as fast an hour later."""

    def once() -> float:
        numbers, began = np.random.default_rng(0).random(1_000_000), time.process_time()
        sum(i * i for i in range(1_000_000))
        np.sort(numbers)
        return time.process_time() - began

    return statistics.median(once() for _ in range(5))


def _checked(row: Mapping[str, Any]) -> dict[str, Any]:
    kept = {key: row[key] for key in KEYS if row.get(key) not in (None, "")}
    if not isinstance(kept.get("what"), str) or not isinstance(kept.get("value"), str | int | float):
        raise ValueError(f"results row {dict(row)!r}: needs `what` as text and `value` as text or a number")
    if re.search(r"\bnan\b", str(kept["value"]), re.IGNORECASE):
        raise ValueError(f"results row {kept['what']!r}: its value is NaN; say in words why there is none")
    return {key: _without_places(value) if isinstance(value, str) else value for key, value in kept.items()}


def _without_places(text: str) -> str:
    """Without the folders of one run on one machine."""
    return re.sub(rf"{re.escape(tempfile.gettempdir())}/[^/\s]+/", "", text)


def digest(path: str) -> str:
    """Of the files of a path or module (`benchmarks.imports.files`) and their content; it survives a rebase, which a commit's name does not."""
    found = hashlib.sha256()
    for file in files(path):
        place = ROOT / file
        if place.suffix in (".py", ".toml", ".xml", ".urdf") and place.is_file():
            found.update(file.encode() + b"\0" + _of_file(file, place.read_bytes()) + b"\0")
    return found.hexdigest()[:16]


@cache
def _of_file(file: str, content: bytes) -> bytes:
    return code(content) if file.endswith(".py") else content


def code(source: bytes) -> bytes:
    """Python source without comments, docstrings and empty lines, none of which changes a figure; as it is where it cannot be read."""
    try:
        tree, tokens = ast.parse(source), list(tokenize.tokenize(io.BytesIO(source).readline))
    except (SyntaxError, ValueError, tokenize.TokenError):
        return source
    lines: list[bytes] = source.splitlines()
    for token in tokens:
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1].decode()[:column].encode()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
            and ast.get_docstring(node) is not None
        ):
            first, last = node.body[0].lineno - 1, int(node.body[0].end_lineno or 0)
            if not lines[first][: node.body[0].col_offset].strip():  # a line of its own
                lines[first:last] = [b""] * (last - first)
    return b"\n".join(line.rstrip() for line in lines if line.strip())


@dataclass(frozen=True)
class Results:
    """One results file."""

    name: str
    command: str
    date: str
    commit: str
    uncommitted: bool
    machine: Mapping[str, Any]
    measures: Mapping[str, str]
    rows: tuple[Mapping[str, Any], ...]

    def outdated(self) -> list[str]:
        """The measured paths and modules whose code has changed since, or is no longer there, with the first of the files that did."""
        out = []
        for path, was in self.measures.items():
            try:
                if digest(path) == was:
                    continue
                names = self.changed(path)
            except ValueError:
                names = []
            more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
            out.append(f"{path} ({', '.join(names[:SHOWN])}{more})" if names not in ([], [path]) else path)
        return out

    def reworded(self) -> bool:
        """Whether docstrings and messages (`structure`) are all that has changed in the measured code since the commit."""
        files = [self.changed(path) for path, was in self.measures.items() if digest(path) != was]
        try:
            return all(
                names and all(_structure(self.then(f)) == _structure((ROOT / f).read_bytes()) for f in names) for names in files
            )
        except (OSError, ValueError):
            return False

    def then(self, file: str) -> bytes:
        """A file as it was at the commit."""
        return _shown(self.commit, file)

    def changed(self, path: str) -> list[str]:
        """The files of a path or module that differ from those of the commit; none where the commit is not known here."""
        return [
            file
            for file in git("diff", "--name-only", self.commit, "--", *files(path)).splitlines()
            if _code(self.then(file)) != _code((ROOT / file).read_bytes().strip())
        ]


# many results share a commit and most of their files
_code, _structure = cache(code), cache(structure)


@cache
def _shown(commit: str, file: str) -> bytes:
    return git("show", f"{commit}:{file}").encode()


def read(folder: Path | None = None) -> dict[str, Results]:
    """All results files by name; ValueError names a file that is not one."""
    found = {}
    for file in sorted((folder or FOLDER).glob("*.json")):
        content = json.loads(file.read_text(encoding="utf-8"))
        if content.get("schema") != SCHEMA or content.get("name") != file.stem:
            raise ValueError(f"{file.name}: needs schema {SCHEMA!r} and the name {file.stem!r}")
        keys = ("name", "command", "date", "commit", "uncommitted", "machine", "measures")
        found[file.stem] = Results(**{key: content[key] for key in keys}, rows=tuple(_checked(r) for r in content["rows"]))
    return found
