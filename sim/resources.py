"""Configuration folders: the user's own first, then those shipped with the package."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path


def shipped_configs() -> Path:
    """The configs folder of the installed wheel, or of the checkout."""
    here = Path(__file__).resolve().parent
    installed = here / "configs"
    return installed if installed.is_dir() else here.parent / "configs"


def config_folders(own: Path | None, kind: str) -> list[Path]:
    """Folders searched for `kind` (arms, cells, can): `own` (--configs) or ./configs, then the shipped ones."""
    folders = [(own or Path("configs")) / kind, shipped_configs() / kind]
    return [f for i, f in enumerate(folders) if f.is_dir() and f.resolve() not in [g.resolve() for g in folders[:i]]]


def nearest(word: str, known: Iterable[str]) -> str:
    """Hint for an error message: the nearest known word, and all known words."""
    known = list(known)
    return f"{did_you_mean(word, known)}known: {', '.join(known) if known else 'none'}"


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """The question "did you mean ...?" with the nearest known word, or nothing if none is near.

    Case is ignored, and the beginning of a long word counts like the whole of it: `stribek` is nearest `stribeck_friction`.
    """

    def likeness(candidate: str) -> float:
        a, b = word.lower(), candidate.lower()
        return max(difflib.SequenceMatcher(None, a, part).ratio() for part in (b, b[: len(a)], b[: len(a) + 1]))

    best = max(known, key=likeness, default="")
    return f"did you mean {best!r}? " if best and likeness(best) >= 0.6 else ""
