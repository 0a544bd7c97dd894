"""One compiled monitor cycle: the rules in order, until one is broken; `safety.monitor_rules` names them."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from typing import Any

import numba

from safety import lies, rows, rules
from safety.rows import NONE, Of


def compiled(key: str) -> Callable[..., Any]:
    """The cycle. key: the source of all that it calls, as Numba's cache tracks changes of this file but not of its imports."""

    @numba.njit(cache=True)
    def cycle(r, x, path, window, speeds, span, out):  # type: ignore[no-untyped-def]
        """(rule, joint) of the first broken rule, rule as an index into `safety.monitor_rules.RULES`; rule -1 if none."""
        key  # noqa: B018 - the closure is part of the cache's key
        if x[Of.ANY_CONSTANT] > 0:
            rules.take_torque(r)
        for rule in range(17):
            joint = NONE
            if rule == 0:
                joint = rules.finite(r, x, out)
            elif rule == 1:
                joint = rules.device_time(r, x, out)
            elif rule == 2:
                joint = rules.age(r, x, out)
            elif rule == 3:
                joint = rules.temperature(r, x, out)
            elif rule == 4:
                joint = rules.jump(r, x, out)
            elif rule == 5:
                joint = rules.position(r, x, out)
            elif rule == 6:
                joint = rules.speed(r, x, out)
            elif rule == 7:
                joint = rules.following_error(r, x, path, out)
            elif rule == 8:
                joint = lies.frozen_position(r, x, out)
            elif rule == 9:
                joint = lies.mean_speed(r, x, window, speeds, out)
            elif rule == 10 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
                joint = rules.torque(r, x, out)
            elif rule == 11 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
                joint = rules.sudden_torque(r, x, out)
            elif rule == 12:
                joint = lies.turned(r, x, span, out)
            elif rule == 13:
                joint = lies.frozen_torque(r, x, len(span), out)
            elif rule == 14:
                joint = lies.swing(r, x, out)
            elif rule == 15:
                joint = lies.clock(r, x, out)
            elif rule == 16 and x[Of.EXPECTED] > 0 and x[Of.ANY_TAU] > 0:
                joint = rules.lost_load(r, x, out)
            if joint != NONE:
                return rule, joint
        return -1, NONE

    return cycle


cycle = compiled(hashlib.sha256("".join(inspect.getsource(module) for module in (rows, rules, lies)).encode()).hexdigest())
