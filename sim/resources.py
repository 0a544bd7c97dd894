"""Where configuration folders are: one's own first, then those that travel with the package."""

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
    """The part of an error message that helps: the nearest known word, and all of them."""
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}known: {', '.join(known) if known else 'none'}"
