"""The result of a fit: estimates with their uncertainty, the residual, and the outcome as a sentence."""

from __future__ import annotations

import enum
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims import Claim
from calib.verdict import Verdict


class Conditioning(enum.Enum):
    """Verdict on a condition number; the value is the sentence shown to people."""

    GOOD = "good: every combination of parameters was excited"
    USABLE = "usable: the weakest combinations carry several times the uncertainty of the others"
    POOR = "poor: the weakest combinations rest on the prior"
    BAD = "design a new excitation: some combinations of parameters were hardly moved"

    @staticmethod
    def of(number: float) -> Conditioning:
        """< 1e3 good, < 1e4 usable, < 1e5 poor, else (and where it is not finite) bad."""
        for bound, verdict in ((1e3, Conditioning.GOOD), (1e4, Conditioning.USABLE), (1e5, Conditioning.POOR)):
            if number < bound:
                return verdict
        return Conditioning.BAD


@dataclass(frozen=True)
class Estimate:
    """One parameter: value and standard deviation in `unit`, bounds, and the origin of its value.

    identifiable: the data determine it better than the prior, or determine it well. at_bound: the value is one of its bounds.
    data_share: 1 - (std / prior std)^2, the share of the information that comes from the data; 1 without a prior.
    written: the value in the arm folder. prior_std: the tolerance of the nominal value that the arm's file states.
    """

    name: str
    value: float
    std: float
    unit: str
    joint: str | None = None
    nominal: float | None = None
    lower: float = -np.inf
    upper: float = np.inf
    at_bound: bool = False
    identifiable: bool = True
    data_share: float = 1.0
    written: float | None = None
    prior_std: float | None = None

    @property
    def out_of_bounds(self) -> bool:
        """Whether the data alone put the value out of bounds, where no arm can be; it is then not an estimate."""
        return not self.lower <= self.value <= self.upper


@dataclass(frozen=True)
class Gap:
    """RMS torque residual per joint of one log, or of several together, in N m, and in A if the torque constant is known.

    before: nominal arm. after: fitted arm. sliding: fitted arm without the rows around a change of direction, where a sticking joint can
    hold any torque within its dry friction. signal: standard deviation of the torque. rows: filtered rows used.
    noise: standard deviation between the periods of a repeated motion, which no model can explain; None without such a motion.
    """

    logs: tuple[str, ...]
    before: np.ndarray
    after: np.ndarray
    signal: np.ndarray
    rows: np.ndarray
    before_ampere: np.ndarray | None = None
    after_ampere: np.ndarray | None = None
    sliding: np.ndarray | None = None
    noise: np.ndarray | None = None

    @property
    def assessed(self) -> np.ndarray:
        """(n,) the residual that a verdict uses: `sliding`, or `after` if it is unknown."""
        return self.after if self.sliding is None else self.sliding


@dataclass(frozen=True)
class FitResult:
    """Estimates, their covariance (in the order of `estimates`), the residual before and after, and the outcome as a sentence.

    condition: condition number of the base regressor in raw SI units. condition_scaled: of all columns, each divided by its norm.
    findings: sentences about the data and the fit that a reader should know. excluded: (log, joint, reason, seconds).
    load: the estimate of the load, if logs were recorded with one. advice: (motion, parameters that it would make identifiable).
    verdict: on the fitted arm, from the held-out logs or else the training logs. assessment: the same joint by joint.
    claims: the content of `outcome`.
    """

    arm: str
    joint_names: tuple[str, ...]
    estimates: tuple[Estimate, ...]
    covariance: np.ndarray
    training: Gap
    holdout: Gap | None
    condition: float
    condition_scaled: float
    conditioning: Conditioning
    outcome: str
    full: tuple[Estimate, ...] = ()
    findings: tuple[str, ...] = ()
    excluded: tuple[tuple[str, str, str, float], ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    load: dict[str, Any] | None = None
    advice: tuple[tuple[str, tuple[str, ...]], ...] = ()
    verdict: Verdict = Verdict.NOTHING
    assessment: dict[str, Any] = field(default_factory=dict)
    claims: tuple[Claim, ...] = ()

    def estimate(self, name: str) -> Estimate:
        """The estimate of that name, base or full; KeyError if there is none."""
        for e in (*self.estimates, *self.full):
            if e.name == name:
                return e
        raise KeyError(name)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, lists and strings for JSON; non-finite bounds become null."""
        table = _plain(asdict(self))
        del table["assessment"]
        return {
            "schema": "fit/1", **table, "conditioning": self.conditioning.name.lower(), "conditioning_sentence": self.conditioning.value,
            **_plain(self.assessment), "verdict": self.verdict.value, "claims": [_plain(claim.as_dict()) for claim in self.claims],
        }  # fmt: skip

    def write(self, path: Path) -> None:
        """Write result.json to `path`."""
        path.write_text(json.dumps(self.as_dict(), indent=1) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
