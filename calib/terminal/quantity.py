"""Numbers as text, rounded to their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable

MOST_DIGITS = 12


def printed_unit(unit: str) -> str:
    """A unit as it is printed; empty for a number without one."""
    return {"1": "", "1/rev": "per turn"}.get(unit, unit.replace("*", " "))


def rounded(value: float, std: float | None, unit: str = "") -> str:
    """`value ± std unit`, both to two significant digits of the standard deviation; four digits of the value without one."""
    unit = printed_unit(unit)
    if not math.isfinite(value):
        return "–"
    if std is None or not (math.isfinite(std) and std > 0):
        return f"{value:.4g} {unit}".strip()
    digits = 1 - math.floor(math.log10(std))
    if digits < 0:
        value, std = round(value, digits), round(std, digits)
    shown = min(max(digits, 0), 12)
    # avoids -0.0
    return f"{value + 0.0 if round(value, shown) else 0.0:.{shown}f} ± {std:.{shown}f} {unit}".strip()


def pair(value: float | None, std: float | None) -> tuple[float | None, float | None]:
    """Value and standard deviation for two columns of a table, both rounded as `rounded` does."""
    if value is None or std is None or not (math.isfinite(value) and math.isfinite(std) and std > 0):
        return value, std
    first, second = rounded(value, std).split(" ± ")
    return float(first), float(second)


def significant(value: float, digits: int = 2) -> str:
    """`value` to `digits` significant digits; large numbers below 1e6 without an exponent: 230, not 2.3e+02."""
    short = float(f"{value:.{digits}g}")
    return f"{short:.0f}" if 10**digits <= abs(short) < 1e6 else f"{value:.{digits}g}"


def share(x: float) -> str | None:
    """As a percentage; None for NaN, which a table shows as a dash."""
    return None if math.isnan(x) else f"{x:.1%}"


def percentages(value: float, limit: float) -> tuple[str, str]:
    """A share and its limit in percent: the share to one decimal, its limit to three digits; more if both would read the same."""
    return _distinct(value, limit, lambda x, more: f"{100 * x:.{1 + more}f}%", lambda x: f"{100 * x:.3g}%")


def significant_beside(value: float, limit: float) -> tuple[str, str]:
    """`significant` for a value and its limit: two digits, or as many as make them differ."""
    return _distinct(value, limit, lambda x, more: significant(x, 2 + more), significant)


def _distinct(value: float, limit: float, text: Callable[[float, int], str], usual: Callable[[float], str]) -> tuple[str, str]:
    """`text` of both with as many digits as make them differ, so that a reader sees which is larger; `usual` for a limit that already differs."""
    if value == limit or text(value, 0) != text(limit, 0):
        return text(value, 0), usual(limit)
    pairs = ((text(value, more), text(limit, more)) for more in range(1, MOST_DIGITS))
    return next(((a, b) for a, b in pairs if a != b), (text(value, 0), usual(limit)))
