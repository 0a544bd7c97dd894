"""The search for effects, repeated once if the loads that it found show a gap that the nominal loads hid.

Effects between motor and link show in the following error by the sign of the load through the gear. Under a payload or a force
that is missing from the model, that sign is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from calib.diagnosis.hypothesis import CONTACT, Hypothesis
from calib.diagnosis.pairs import paired
from calib.diagnosis.selection import SearchResult, search
from calib.measurement.following import observed
from calib.measurement.observed import CLEAR, Key, Observed, clear
from calib.measurement.preprocessing import Measurement
from logs.log import Log
from sim.arm import Arm
from sim.effects import Stage, effect_named, with_effect


def searched(
    logs: Sequence[Log],
    every: Sequence[Measurement],
    fitted: int,
    start: Arm,
    nominal: Arm,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[list[Measurement], SearchResult]:
    """The recordings with what their following errors show, and the effects of the first `fitted` of them.

    nominal: the arm that `every` was measured with.
    """
    seen = clear([m.followed for m in every])
    found = _found(every[:fitted], Hypothesis.nominal(start, seen), progress)
    under = start
    for item in found.best.accepted:
        if item.effect != CONTACT and effect_named(item.effect).stage <= Stage.JOINT:
            under = with_effect(under, item)
    if under is nominal:
        return list(every), found
    again = [replace(m, followed=observed(log, m, under)) for log, m in zip(logs, every, strict=True)]
    shown = clear([m.followed for m in again])
    if not _new(shown, seen):
        return list(every), found
    return again, _found(again[:fitted], Hypothesis.nominal(start, shown), progress)


def _found(measurements: Sequence[Measurement], hypothesis: Hypothesis, progress: Callable[[str], None]) -> SearchResult:
    return paired(measurements, search(measurements, hypothesis, progress))


def _new(shown: Mapping[Key, Observed], seen: Mapping[Key, Observed]) -> bool:
    """Whether a parameter is shown that was not seen before, or clearly another value of one."""
    return any(key not in seen or abs(now.value - seen[key].value) > CLEAR * seen[key].std for key, now in shown.items())
