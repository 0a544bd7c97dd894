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
