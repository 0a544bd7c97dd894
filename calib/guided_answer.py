"""The answer of a diagnosis as a guided session uses it: what was found, what is undecided, and where the arm is."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from calib.claims.diagnosis_sentences import words
from calib.claims.of_diagnosis import disagrees
from sim.errors import ConfigError

FILE = "diagnosis.json"
REMEDY = "the session cannot continue with it: restore the file, or begin a new session with --new"


def answer(folder: Path) -> dict[str, Any]:
    """The content of diagnosis.json; ConfigError names the first field with a wrong type among those that a session reads."""
    file = folder / FILE
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: cannot be read ({error}); {REMEDY}") from error
    fault = next(_faults(found), None)
    if fault is not None:
        raise ConfigError(f"{file}: not a diagnosis: {fault}; {REMEDY}")
    assert isinstance(found, dict)
    return found


def doubtful(found: dict[str, Any]) -> bool:
    """Whether the model disagrees with the recordings, or the file was edited so that this cannot be determined."""
    try:
        return disagrees(found)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return True


def undecided(found: dict[str, Any]) -> list[str]:
    """`a and b` for the effects that the recordings could not distinguish."""
    return [
        f"{words(effect['effect'], effect.get('joint'))} and {words(rival['effect'], rival.get('joint'))}"
        for effect in found["effects"]
        for rival in effect.get("indistinguishable_from") or []
    ]


def _faults(found: Any) -> Iterator[str]:
    if not isinstance(found, dict):
        yield f"it is {_shown(found)}, not a table"
        return
    for key in ("verdict", "arm_out"):
        if not isinstance(found.get(key), str | None):
            yield f"{key} is {_shown(found[key])}, not a word"
    if not isinstance(found.get("effects"), list):
        yield f"effects is {_shown(found['effects'])}, not a list" if "effects" in found else "effects is missing"
        return
    yield from _not_effects(found["effects"], "effects")
    for k, effect in enumerate(found["effects"]):
        yield from _not_effects(effect.get("indistinguishable_from"), f"effects[{k}].indistinguishable_from")
    yield from _not_tables(found.get("unexplained"), "unexplained")
    yield from _not_tables(found.get("laws"), "laws")


def _not_effects(entries: Any, where: str) -> Iterator[str]:
    """Faults of entries that should be effects, each with its joint."""
    yield from _not_tables(entries, where)
    for k, entry in enumerate(entries or []):
        if not isinstance(entry.get("effect"), str):
            yield (
                f"{where}[{k}].effect is {_shown(entry['effect'])}, not a name"
                if "effect" in entry
                else f"{where}[{k}].effect is missing"
            )
        if not isinstance(entry.get("joint"), str | None):
            yield f"{where}[{k}].joint is {_shown(entry['joint'])}, not a name"


def _not_tables(entries: Any, where: str) -> Iterator[str]:
    if entries is not None and not isinstance(entries, list):
        yield f"{where} is {_shown(entries)}, not a list"
    yield from (f"{where}[{k}] is {_shown(x)}, not a table" for k, x in enumerate(entries or []) if not isinstance(x, dict))


def _shown(value: Any) -> str:
    return f"{value!r:.60}"
