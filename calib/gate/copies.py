"""No sample counts twice: a recording given twice, or one that repeats its own samples exactly, as no sensor does."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from calib.gate.check import Cause, GateCheck
from calib.gate.readings import name_of
from logs.log import Log

TWICE = "recordings"  # name of the check that each is given once
ALIKE = 0.9
SHORTEST = 2.0  # s of repeated motion, with every reading equal to the last bit
TRIED = 20  # samples in motion for which a copy is looked for


def twice(logs: Sequence[Log]) -> GateCheck:
    """No recording, nor a part of one, is given twice: its rows would count twice, and it cannot check itself."""
    for log in logs:
        lag = _copied(log)
        if lag:
            return _of_one_file(log, _span(log, 0, lag), _span(log, lag, min(2 * lag, len(log))), len(logs) > 1)
    for a, b in itertools.combinations(logs, 2):
        if len(a) and len(b) and same_samples(a, b):
            if a.path is not None and a.path == b.path and a.t[-1] < b.t[0]:  # pieces of one file
                return _of_one_file(a, _span(a, 0, len(a)), _span(b, 0, len(b)), True)
            cause = Cause(
                f"{name_of(a)} and {name_of(b)} are the same recording: give it once, and another motion to check with"
            )
            return GateCheck(TWICE, False, f"{name_of(a)} and {name_of(b)} hold the same samples", (cause,), of_all=True)
    detail = f"{len(logs)} recordings, each once" if len(logs) > 1 else "one recording"
    return GateCheck(TWICE, True, detail, of_all=len(logs) > 1)


def _of_one_file(log: Log, first: str, again: str, of_all: bool) -> GateCheck:
    detail = (
        f"{name_of(log)}: the samples from {first} appear again from {again}, and no sensor reads a motion twice exactly alike"
    )
    cause = Cause("one recording was copied several times into one file: give it once")
    return GateCheck(TWICE, False, detail, (cause,), of_all=of_all)


def _span(log: Log, first: int, stop: int) -> str:
    return f"{log.t[first]:.1f} to {log.t[stop - 1]:.1f} s"


def _copied(log: Log) -> int:
    """Number of samples after which the readings repeat to the last bit, for at least SHORTEST s of motion; 0 where they do not."""
    load = np.where(np.isfinite(log.tau), log.tau, log.current)
    x = np.nan_to_num(np.concatenate([log.q, load], axis=1))
    moves = np.r_[False, (np.diff(log.q, axis=0) != 0).any(axis=1)]
    least = SHORTEST / log.period if len(log) > 1 and log.period > 0 else len(log)
    moving = np.flatnonzero(moves[: len(moves) // 2 + 1])
    tried = moving[np.linspace(0, len(moving) - 1, min(TRIED, len(moving))).astype(int)]
    for k in tried:
        for lag in np.flatnonzero((x[k + 1 :] == x[k]).all(axis=1)) + 1:
            some = tried[tried < len(x) - lag]
            if (x[some + lag] == x[some]).all(axis=1).mean() < 0.5:  # coarsely quantised readings are often equal by chance
                continue
            both = moves[lag:] & moves[:-lag]
            if both.sum() >= least and (x[lag:] == x[:-lag])[both].all(axis=1).mean() >= ALIKE:
                return int(lag)
    return 0


def same_samples(a: Log, b: Log) -> bool:
    """Whether most samples of the shorter log, position and load, are also in the longer one, exact or rounded."""
    short, long = (a, b) if len(a) <= len(b) else (b, a)
    if short.n != long.n:
        return False
    pick = np.linspace(0, len(short) - 1, min(200, len(short))).astype(int)
    moved = np.abs(np.diff(short.q, axis=0)).max(axis=1, initial=0.0)
    pick = pick[np.r_[moved, 0.0][pick] > 0]
    if len(pick) < 20:
        return False
    load = [np.where(np.isfinite(x.tau), x.tau, x.current) for x in (short, long)]
    q_all = np.concatenate([np.nan_to_num(long.q), np.nan_to_num(load[1])], axis=1)
    scale = np.maximum(q_all.std(axis=0), 1e-9)
    found = 0
    for done, k in enumerate(pick):
        if found + len(pick) - done < ALIKE * len(pick):
            return False
        one = np.concatenate([np.nan_to_num(short.q[k]), np.nan_to_num(load[0][k])])
        found += bool((np.abs(q_all - one) < 1e-3 * scale).all(axis=1).any())
    return found >= ALIKE * len(pick)
