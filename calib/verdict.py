"""Whether a model is good for an arm: residual RMS over the torque's standard deviation, joint by joint, against stated limits.

The residual is that of the sliding joint. Around a reversal the joint sticks, dry friction balances whatever torque there is,
and no model of the motion predicts it. A joint that reverses all the time keeps all of its rows (`calib.measurement.reversals`).

good       every joint at most GOOD_SHARE, or a residual of at most SMALL times its maximum torque
poor       some joint above that
wrong arm  at least half of the joints above both WRONG_SHARE and SMALL: their mean torque alone would predict better
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.claims import Claim

GOOD_SHARE, SMALL, WRONG_SHARE = 0.2, 0.01, 1.0


class Verdict(enum.Enum):
    """The value is the word shown to people."""

    GOOD = "good"
    POOR = "poor"
    WRONG_ARM = "wrong arm"
    NOTHING = "nothing compared"

    @property
    def exit_code(self) -> int:
        """0 good, 1 the answer is no, 2 the data or the arm cannot be used."""
        return {Verdict.GOOD: 0, Verdict.POOR: 1}.get(self, 2)


@dataclass(frozen=True)
class Assessment:
    """left (n,): residual over signal, NaN if a joint did not move. limit (n,): its limit. share: the limit required of every joint.
    wrong (n,): the value of left above which the arm or the model is the wrong one."""

    joint_names: tuple[str, ...]
    left: np.ndarray
    limit: np.ndarray
    share: float
    wrong: np.ndarray

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """The verdict on every joint."""
        return tuple(
            Verdict.NOTHING if np.isnan(x) else Verdict.WRONG_ARM if x > max(wrong, limit)
            else Verdict.POOR if x > limit else Verdict.GOOD
            for x, limit, wrong in zip(self.left, self.limit, self.wrong, strict=True)
        )  # fmt: skip

    @property
    def verdict(self) -> Verdict:
        """The verdict on all joints together."""
        decided = [v for v in self.verdicts if v is not Verdict.NOTHING]
        if not decided:
            return Verdict.NOTHING
        if 2 * decided.count(Verdict.WRONG_ARM) >= len(decided):
            return Verdict.WRONG_ARM
        return Verdict.GOOD if set(decided) == {Verdict.GOOD} else Verdict.POOR

    @property
    def uncompared(self) -> list[str]:
        """Joints without a verdict: they do not move, or have no torque to compare with."""
        return [j for j, v in zip(self.joint_names, self.verdicts, strict=True) if v is Verdict.NOTHING]

    @property
    def worst(self) -> int | None:
        """Index of the joint with the largest left / limit; None if nothing was compared."""
        with np.errstate(invalid="ignore", divide="ignore"):
            over = self.left / self.limit
        return None if np.isnan(over).all() else int(np.nanargmax(over))

    def claim(self, arm: str, where: str) -> Claim:
        """The verdict with the worst joint; where: which logs, in words."""
        k = self.worst
        return Claim(
            "residual",
            {
                "arm": arm, "where": where, "verdict": self.verdict.value,
                "worst": None if k is None else self.joint_names[k],
                "left": None if k is None else float(self.left[k]),
                "limit": None if k is None else float(self.limit[k]),
                "beyond": [j for j, v in zip(self.joint_names, self.verdicts, strict=True) if v in (Verdict.POOR, Verdict.WRONG_ARM)],
                "uncompared": self.uncompared,
            },
        )  # fmt: skip

    def as_dict(self) -> dict[str, Any]:
        """verdict, the limits, and a row for every joint."""
        return {
            "verdict": self.verdict.value,
            "limits": {"good": self.share, "wrong_arm": WRONG_SHARE, "unit": "share of the torque's standard deviation"},
            "joint_verdicts": [
                {"joint": j, "verdict": v.value, "left": None if np.isnan(x) else float(x), "limit": float(limit)}
                for j, v, x, limit in zip(self.joint_names, self.verdicts, self.left, self.limit, strict=True)
            ],
        }


def assess(
    joint_names: tuple[str, ...], residual: np.ndarray, signal: np.ndarray, tau_max: np.ndarray, most: float | None = None
) -> Assessment:  # fmt: skip
    """Assess a residual; residual, signal, tau_max (n,) N m. With `most`, that share is the limit of every joint, however small its torque."""
    with np.errstate(invalid="ignore", divide="ignore"):
        left = np.where(signal > 0, residual / signal, np.nan)
        small = SMALL * np.where(np.isfinite(tau_max), tau_max, 0.0) / np.where(signal > 0, signal, np.nan)
    share = GOOD_SHARE if most is None else most
    limit = np.full(len(left), share) if most is not None else np.fmax(share, small)
    return Assessment(tuple(joint_names), left, limit, share, np.fmax(WRONG_SHARE, small))
