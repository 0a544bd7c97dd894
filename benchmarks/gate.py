"""The data gate alone: 500 wrong recordings, and its cost on two minutes of log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.known_truth import fourier_motion, recorded, varied
from benchmarks.wrong_data import COUNT, Case, arm, cases, changes, family, named_first, within
from calib.gate import gate
from calib.gate.commands import family as every_arm

LONG, RATE = 120.0, 500.0  # s, Hz
OF_TWO_MINUTES = ("ur10e", "servo6")
COMBINED = 20  # combinations of three corruptions


def run(count: int = COUNT) -> list[dict[str, Any]]:
    """Wrong recordings accepted as good, share with the right cause first, and processor time: what, value, unit, bar, note."""
    passed, misnamed = [], []
    everything = cases(count)
    for case in everything:
        found = gate(case.arm, case.logs, family=family)
        if found.refusal is None:
            passed.append(case.name)
        elif not named_first(case, found):
            misnamed.append(f"{case.name}: {found.causes[0].sentence if found.causes else 'no cause'}")
    share = 100 * (1 - (len(passed) + len(misnamed)) / len(everything))
    good, bad = timed()
    sizes = f"{int(LONG * RATE)} samples of {' and '.join(OF_TWO_MINUTES)}"
    return [
        {"what": f"wrong recordings accepted as good, of {len(everything)}", "value": len(passed), "bar": "0", "note": "; ".join(passed[:3])},
        {"what": "cause named first", "value": round(share, 1), "unit": "%", "bar": ">= 90", "note": "; ".join(misnamed[:3])},
        {"what": "processor time, two minutes of a good log, most", "value": round(max(good), 3), "unit": "s", "bar": "< 0.5", "note": sizes},
        {"what": "processor time, two minutes of a wrong log, median", "value": round(float(np.median([s for s, _ in bad])), 3), "unit": "s",
         "bar": "< 0.5", "note": f"{len(bad)} of them"},
        {"what": "processor time, two minutes of a wrong log, most", "value": round(max(bad)[0], 3), "unit": "s", "bar": "< 0.5",
         "note": max(bad)[1]},
    ]  # fmt: skip


def timed() -> tuple[list[float], list[tuple[float, str]]]:
    """Processor time of the gate on two-minute logs: s of each good one, and (s, name) of each corrupted one.

    Corruptions are applied singly and in combinations of three. Each run loads the other arms afresh.
    """
    rng = np.random.default_rng(0)
    good, bad = [], []
    for name in OF_TWO_MINUTES:
        truth = varied(arm(name), 7, 0.08)
        log = recorded(truth, within(truth, fourier_motion(truth, 107, LONG, RATE)), 7)
        known = changes(arm(name))
        good.append(_seconds(Case("", arm(name), (log,), (), frozenset())))
        ways: list[Sequence[str]] = [(what,) for what in known]
        ways += [tuple(list(known)[k] for k in rng.choice(len(known), 3, replace=False)) for _ in range(COMBINED)]
        for way in ways:
            wrong = log
            for what in way:
                wrong, _ = known[what](wrong, arm(name), rng)
            case = Case(f"{name}: {'; '.join(way)}", arm(name), (wrong,), tuple(way), frozenset())
            bad.append((_seconds(case), case.name))
    return good, bad


def _seconds(case: Case) -> float:
    every_arm.cache_clear()
    begun = time.process_time()
    gate(case.arm, case.logs, family=lambda: every_arm(None))
    return time.process_time() - begun
