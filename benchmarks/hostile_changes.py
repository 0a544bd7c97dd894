"""Hostile changes to inputs of commands: to the bytes of a file, the readings of a recording, or the arguments.

A changed byte of an MCAP file is nearly always rejected by its checksum. A changed reading reaches the computation.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from benchmarks.hostile import mutated
from benchmarks.results import ROOT
from logs import read_log
from logs.convert import write_log
from logs.log import Log

SAMPLES = ROOT / "logs" / "samples"
Case = tuple[Path, list[str]]  # file that is read, and the words after `calib`
Mutant = Callable[[random.Random], list[str]]  # writes the next mutant; the words after `calib`
NUMBERS = (
    "-3",
    "0",
    "-0",
    "1e-300",
    "1e300",
    "nan",
    "inf",
    "-inf",
    "1e999",
    "9" * 400,
    "0x10",
    "1_0",
    "1,2",
    " 5 ",
    "1e",
    "\u0663",
)
NAMES = (
    "",
    " ",
    "-",
    "--",
    "...",
    "../x",
    "nowhere",
    "/dev/null",
    "~",
    "a" * 300,
    "a,b",
    "=",
    "a=",
    "=a",
    ":",
    "a:b=c",
    "\u202e",
    "\x1b[2J",
    "\n",
    "%s",
    "{}",
)
READINGS = ("q", "dq", "tau", "current", "q_cmd", "temperature")
WILD = (np.nan, np.inf, -np.inf, 0.0, 1e-300, 1e9, -1e9, 1e300, 65535.0, 1.7e308)


@cache
def log_of(name: str) -> Log:
    return read_log(SAMPLES / name)


def bytes_of(make: Callable[[Path], Case]) -> Callable[[Path], Mutant]:
    """The command on a file with changed bytes."""

    def begin(folder: Path) -> Mutant:
        file, words = make(folder)
        data = file.read_bytes()

        def mutant(rng: random.Random) -> list[str]:
            file.write_bytes(mutated(data, rng))
            return words

        return mutant

    return begin


def readings_of(name: str, *words: str) -> Callable[[Path], Mutant]:
    """The command on a recording that is a sound file but has changed readings or time stamps."""

    def begin(folder: Path) -> Mutant:
        source, file = log_of(name), folder / "log.mcap"
        given = placed(words, folder, file)

        def mutant(rng: random.Random) -> list[str]:
            file.unlink(missing_ok=True)
            log = source
            for _ in range(rng.choice((1, 1, 2, 3))):
                log = changed(log, rng)
            write_log(log, file, "clean", {"arm": name.partition("_")[0], "motion": "excitation"})
            return given

        return mutant

    return begin


def changed(log: Log, rng: random.Random) -> Log:
    """The recording with one random change: fewer samples, a stretched clock, or other readings of one or all joints.

    Time stamps still increase.
    """
    at, to = sorted(rng.randrange(len(log)) for _ in range(2))
    at, to = (at, to + 1) if rng.random() < 0.7 else (0, len(log))
    what = rng.randrange(6)
    if what == 0:  # fewer samples
        return log.part(slice(at, max(to, at + 1)))
    if what == 1:  # a stretched clock
        step = np.diff(log.t, prepend=log.t[0])
        step[at:to] *= rng.choice((1e-3, 0.5, 3.0, 1e3))
        return replace(log, t=np.cumsum(step), t_host=np.full(len(log), np.nan))
    channel, joints = rng.choice(READINGS), rng.choice((slice(None), rng.randrange(log.n)))
    x = np.array(getattr(log, channel))
    if what == 2:
        x[at:to, joints] = rng.choice(WILD)
    elif what == 3:
        x[at:to, joints] *= rng.choice((-1.0, 0.0, 1e-12, 57.3, 1e3, 1e12))
    elif what == 4:
        x[at:to, joints] = x[at, joints]
    else:
        x[at:to, joints] += rng.choice((1e-6, 1.0, 1e6)) * np.random.default_rng(rng.randrange(2**32)).normal(
            size=x[at:to, joints].shape
        )
    return replace(log, **{channel: x})


def words_of(make: Callable[[Path], Path] | None, *words: str) -> Callable[[Path], Mutant]:
    """The command with one or two of its arguments changed.

    Numbers are written as #1.5 and names as @ur10e; LOG, OUT, FOLDER and DB stand for paths.
    """

    def begin(folder: Path) -> Mutant:
        file = make(folder) if make else folder / "none"
        at = [k for k, word in enumerate(words) if word[0] in "#@"]

        def mutant(rng: random.Random) -> list[str]:
            out = placed([word[1:] if word[0] in "#@" else word for word in words], folder, file)
            for k in rng.sample(at, min(len(at), rng.choice((1, 1, 2)))):
                own = out[k]
                harm = rng.choice((*(NUMBERS if words[k][0] == "#" else NAMES), rng.choice(NUMBERS + NAMES)))
                cut = rng.randrange(len(own) + 1)
                out[k] = rng.choice((harm, own[:cut] + harm + own[cut:]))
            return out

        return mutant

    return begin


def placed(words: Sequence[str], folder: Path, file: Path) -> list[str]:
    """The words with LOG, OUT, FOLDER and DB replaced by paths."""
    places = {"LOG": str(file), "OUT": str(folder / "out"), "FOLDER": str(folder), "DB": str(folder / "trend.sqlite")}
    return [places.get(word, word) for word in words]
