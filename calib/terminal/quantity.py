"""A number as it is shown: rounded to its uncertainty."""

from __future__ import annotations

import math


def rounded(value: float, std: float | None, unit: str = "") -> str:
    """`value ± std unit`, both to the second digit of the standard deviation; four digits of the value where there is none."""
    unit = "" if unit == "1" else unit.replace("*", " ")
    if not math.isfinite(value):
        return "–"
    if std is None or not (math.isfinite(std) and std > 0):
        return f"{value:.4g} {unit}".strip()
    digits = 1 - math.floor(math.log10(std))
    if digits < 0:
        value, std = round(value, digits), round(std, digits)
    shown = min(max(digits, 0), 12)
    # -0.0 is no number that a person would write
    return f"{value + 0.0 if round(value, shown) else 0.0:.{shown}f} ± {std:.{shown}f} {unit}".strip()


def significant(value: float, digits: int = 2) -> str:
    """`value` to so many digits; a number of hundreds or thousands as a person writes it: 230, and not 2.3e+02."""
    short = float(f"{value:.{digits}g}")
    return f"{short:.0f}" if 10**digits <= abs(short) < 1e6 else f"{value:.{digits}g}"
