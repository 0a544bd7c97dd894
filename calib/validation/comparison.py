"""Comparison of two runs: which parameters changed by more than their uncertainty, and how the residual changed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.past_runs import Run
from sim.errors import ConfigError

RESULTS = ("diagnosis.json", "result.json")


@dataclass(frozen=True)
class Number:
    """A parameter as one run estimated it; std is 0 if the run gave none."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class RunNumbers:
    """Results of a run: parameters by (name, joint), and residual RMS by joint, comparable for equal `kind` and `unit`."""

    run: Run
    numbers: dict[tuple[str, str], Number]
    gap: dict[str, float]
    unit: str
    kind: str


@dataclass(frozen=True)
class Change:
    """One parameter in both runs; `sigmas` is |b - a| / sqrt(std_a^2 + std_b^2), NaN without a std or a second value."""

    name: str
    joint: str
    a: Number | None
    b: Number | None

    @property
    def sigmas(self) -> float:
        if self.a is None or self.b is None:
            return float("nan")
        spread = float(np.hypot(self.a.std, self.b.std))
        return abs(self.b.value - self.a.value) / spread if spread > 0 else float("nan")


def found(run: Run) -> RunNumbers:
    """Results of a run of `identify` or `diagnose`; ConfigError names the file that is missing or invalid."""
    file = next((run.folder / name for name in RESULTS if (run.folder / name).is_file()), None)
    if file is None:
        raise ConfigError(
            f"{run.folder}: has neither {' nor '.join(RESULTS)}; compare runs of calib identify or calib diagnose"
        )
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        return _diagnosis(run, data) if data["schema"] == "diagnosis/1" else _fit(run, data)
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(
            f"{file}: not a result of this program ({error!r}); repeat the run with calib runs --again"
        ) from error


def compare(a: RunNumbers, b: RunNumbers) -> list[Change]:
    """Every parameter of either run, largest changes first; those in only one run come last."""
    keys = list(dict.fromkeys([*a.numbers, *b.numbers]))
    changes = [Change(name, joint, a.numbers.get((name, joint)), b.numbers.get((name, joint))) for name, joint in keys]
    return sorted(changes, key=lambda c: (not c.sigmas >= 0, -c.sigmas if c.sigmas >= 0 else 0.0))


def sentence(a: RunNumbers, b: RunNumbers, changes: list[Change]) -> str:
    """The comparison in one sentence; a parameter has changed if it differs by more than three standard deviations."""
    moved = [c for c in changes if c.sigmas > 3]
    both = [c for c in changes if c.a is not None and c.b is not None]
    shared = [j for j in a.gap if j in b.gap] if (a.unit, a.kind) == (b.unit, b.kind) else []
    parts = [
        f"{len(moved)} of {len(both)} shared parameters changed by more than three standard deviations"
        if both
        else "The runs share no parameter"
    ]
    if shared:
        ratio = np.linalg.norm([b.gap[j] for j in shared]) / max(float(np.linalg.norm([a.gap[j] for j in shared])), 1e-300)
        first = a.run.folder if a.run.folder.name == b.run.folder.name else a.run.folder.name
        parts.append(f"the residual RMS is {ratio:.2f} times that of {first}")
    if a.run.arm != b.run.arm:
        parts.append(f"the runs are of different arms, {a.run.arm} and {b.run.arm}")
    return "; ".join(parts)


def _diagnosis(run: Run, data: dict[str, Any]) -> RunNumbers:
    numbers = {
        (f"{e['effect']} {name}", e["joint"] or ""): Number(float(p["value"]), float(p["std"] or 0.0), str(p["unit"]))
        for e in data["effects"]
        for name, p in e["parameters"].items()
    }
    gap = data["gap"]
    return RunNumbers(run, numbers, _of_moving(gap["joints"], gap["after"]), str(gap["unit"]), "diagnosis")


def _fit(run: Run, data: dict[str, Any]) -> RunNumbers:
    numbers = {
        (str(e["name"]), str(e["joint"] or "")): Number(float(e["value"]), float(e["std"] or 0.0), str(e["unit"]))
        for e in data["estimates"]
        if e["identifiable"]
    }
    gap = data["holdout"] or data["training"]
    return RunNumbers(
        run,
        numbers,
        _of_moving(data["joint_names"], gap["after"]),
        "N*m",
        f"fit, filtered at {data['settings']['cutoff_hz']:.3g} Hz",
    )


def _of_moving(joints: Sequence[str], left: Sequence[float | None]) -> dict[str, float]:
    """Residual by joint, of those that moved; it is unknown for the others."""
    return {joint: float(x) for joint, x in zip(joints, left, strict=True) if x is not None}
