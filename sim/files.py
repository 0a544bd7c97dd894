"""Reading of untrusted files: regular files only, of bounded size; every failure is one sentence.

Names and labels from a file are checked here before they become part of a path, a terminal's output or a page.
"""

from __future__ import annotations

import os
import re
import stat
import tempfile
import tomllib
import unicodedata
from pathlib import Path
from typing import Any, BinaryIO

from sim.errors import CalibError, ConfigError

MAX_TABLE = 1 << 20  # bytes of a TOML file
MAX_PARTS = 16  # of a dotted key: the parser's time grows with their square
MAX_LABEL = 200
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", re.ASCII)
# a word and the dot after it, or any other character; without backtracking
_PART = re.compile(r"(?:[\w-]++|\"(?:[^\"\\\n]|\\.)*+\"?|'[^'\n]*+'?)(?P<dot>[ \t]*+\.[ \t]*+)?|.", re.DOTALL)


def open_regular(file: Path, kind: type[CalibError] = ConfigError, remedy: str = "give another file") -> BinaryIO:
    """A regular file, open for reading; a pipe, a device or a folder is refused without waiting for it."""
    try:
        descriptor = os.open(file, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        raise kind(f"{printable(file)}: cannot be read ({getattr(error, 'strerror', None) or error}); {remedy}") from error
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise kind(f"{printable(file)}: not a regular file; {remedy}")
    return os.fdopen(descriptor, "rb")


def read_bytes(file: Path, most: int, kind: type[CalibError] = ConfigError, remedy: str = "give another file") -> bytes:
    """The content of a regular file of at most `most` bytes."""
    with open_regular(file, kind, remedy) as stream:
        try:
            # read() allocates the requested size at once: request the file's size, and one byte more to detect growth
            data = stream.read(min(most, os.fstat(stream.fileno()).st_size) + 1)
        except OSError as error:
            raise kind(f"{printable(file)}: cannot be read ({error.strerror}); {remedy}") from error
        size = max(os.fstat(stream.fileno()).st_size, len(data))
    if len(data) > most:
        raise kind(f"{printable(file)}: {size} bytes, at most {most} are read here; {remedy}")
    return data


def read_text(file: Path, most: int, remedy: str = "give another file") -> str:
    """`read_bytes` as UTF-8 text."""
    return as_text(read_bytes(file, most, remedy=remedy), file, remedy)


def as_text(data: bytes, file: Path, remedy: str = "give another file") -> str:
    """`data` as UTF-8 text; ConfigError names the first byte that is not."""
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{printable(file)}: not UTF-8 text at byte {error.start}; {remedy}") from error


def toml_table(text: str, file: Path, remedy: str = "correct the file at that place") -> dict[str, Any]:
    """The table in TOML text; ConfigError for bad syntax, integers beyond 64 bits, and nesting deeper than any table here."""
    parts = 0
    for found in _PART.finditer(text):
        parts = parts + 1 if found["dot"] is not None else 0
        if parts >= MAX_PARTS:
            line = text.count("\n", 0, found.start()) + 1
            raise ConfigError(f"{printable(file)}: line {line}: a key of more than {MAX_PARTS} dotted parts; {remedy}")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise ConfigError(f"{printable(file)}: not valid TOML (nested too deeply); {remedy}") from None
    except ValueError as error:  # bad syntax, or more digits than Python converts
        raise ConfigError(f"{printable(file)}: not valid TOML ({str(error).split(';')[0]:.200}); {remedy}") from error
    left: list[Any] = [data]
    while left:
        value = left.pop()
        if isinstance(value, dict | list):
            left.extend(value.values() if isinstance(value, dict) else value)
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ConfigError(f"{printable(file)}: an integer beyond 64 bits; {remedy}")
    return data


def read_toml(file: Path, remedy: str = "correct the file at that place") -> dict[str, Any]:
    """The table in a TOML file of at most MAX_TABLE bytes."""
    return toml_table(read_text(file, MAX_TABLE, remedy=remedy), file, remedy)


def write_atomically(file: Path, text: str) -> None:
    """Write `text` to `file`, whole or not at all: to a file beside it, flushed to disk, then renamed. OSError names `file`."""
    name = None
    try:
        descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        with os.fdopen(descriptor, "w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(name, 0o644)
        os.replace(name, file)
    except BaseException as error:
        if name is not None:
            Path(name).unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise OSError(error.errno, error.strerror, str(file)) from error
        raise


def is_name(text: str) -> bool:
    """Whether `text` may name an arm or a cell: [A-Za-z0-9][A-Za-z0-9_.-]{0,63}; such a name is safe as part of a path."""
    return _NAME.fullmatch(text) is not None


def checked_name(text: str) -> str:
    """`text` if it may name an arm or a cell (`is_name`); ValueError otherwise."""
    if not is_name(text):
        raise ValueError("must be 1 to 64 letters, digits, dots, dashes and underscores, and begin with a letter or digit")
    return text


def checked_label(text: str) -> str:
    """A label shown to people (a joint, an obstacle): 1 to MAX_LABEL printable characters; ValueError otherwise."""
    if not 0 < len(text) <= MAX_LABEL:
        raise ValueError(f"must have 1 to {MAX_LABEL} characters")
    if printable(text) != text or "\n" in text or "\t" in text:
        raise ValueError("must hold no control characters")
    return text


def printable(text: object) -> str:
    """`text` with every character that could steer a terminal (ESC, C1, bidirectional marks, lone surrogates) written as \\x1b and the like.

    Line breaks and tabs stay.
    """
    text = str(text)
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c in "\n\t" or not _steers(c) else c.encode("unicode_escape").decode() for c in text)


def _steers(character: str) -> bool:
    return unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp")
