"""Whether reported uncertainties are correct: coverage of 95 % intervals over many seeded arms.

Arms are recorded on the mock, or computed by formula with coloured noise. `python -m benchmarks coverage` takes about ten
minutes, three of them by formula. COVERAGE_RUNS (50) and COVERAGE_FORMULA_RUNS (200) set the numbers of runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.known_truth import fitting_motion, fourier_motion, recorded, recorded_on_mock, varied
from calib.identification.base_fit import BaseFit, Options, fitted
from calib.identification.identify import Identification, identify
from calib.identification.model import TorqueModel
from calib.identification.payload import load_between
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect

NARROW = Options(slip_width=1e-4)
KINDS = ("base", "viscous", "coulomb", "offset")


@dataclass(frozen=True)
class Coverage:
    """Results of many runs: z (runs, p) errors over their reported std, whether each was identifiable, and the column kinds.

    residual: (runs, 2, n) held-out torque residual over peak torque, first of sliding joints only, then with reversals
    included. At a reversal a sticking joint holds any torque within its friction. Empty if there was no held-out log.
    """

    z: np.ndarray
    identifiable: np.ndarray
    kinds: np.ndarray
    residual: np.ndarray

    def within(self, sigmas: float, kind: str | None = None) -> float:
        """Share of identifiable parameters, of one kind or all, whose error is below `sigmas` reported std."""
        chosen = self.identifiable & ((self.kinds == kind) if kind else True)
        return float(np.mean(np.abs(self.z[chosen]) < sigmas))

    def least_of_any(self, sigmas: float) -> float:
        """The same share for the worst single parameter that is identifiable in at least half of the runs."""
        often = self.identifiable.mean(axis=0) >= 0.5
        inside = np.where(self.identifiable, np.abs(self.z) < sigmas, True)
        return float(inside[:, often].mean(axis=0).min())


def on_mock(name: str, runs: int, progress: Callable[[int], None] = lambda run: None) -> Coverage:
    """Arms that differ from the nominal one by `varied`, recorded on the mock: two motions to fit, a third held out."""
    nominal = load_arm(name)
    motions = [fitting_motion(nominal, seed) for seed in (1, 2, 3)]

    def one(seed: int) -> tuple[Identification, Arm, np.ndarray]:
        truth = varied(nominal, 100 + seed)
        logs = [recorded_on_mock(truth, nominal, m, 10 * seed + k) for k, m in enumerate(motions)]
        found = identify(nominal, logs[:2], logs[2:])
        gap = found.result.holdout
        assert gap is not None
        assert gap.sliding is not None
        return found, truth, np.stack([gap.sliding, gap.after]) / np.abs(logs[2].tau).max(axis=0)

    return _collected(one, runs, progress)


def by_formula(name: str, runs: int, memory: float = 0.8, progress: Callable[[int], None] = lambda run: None) -> Coverage:
    """The same with computed torque and AR(1) torque noise of coefficient `memory`, without a held-out log."""
    nominal = load_arm(name)
    motions = [fourier_motion(nominal, seed) for seed in (1, 2)]

    def one(seed: int) -> tuple[BaseFit, Arm, np.ndarray]:
        truth = varied(nominal, 1000 + seed)
        logs = [recorded(truth, m, 10 * seed + k, memory=memory) for k, m in enumerate(motions)]
        return fitted(nominal, logs, NARROW), truth, np.zeros(0)

    return _collected(one, runs, progress)


def of_payload(name: str, runs: int, memory: float = 0.8, progress: Callable[[int], None] = lambda run: None) -> np.ndarray:
    """Errors of mass and centre of mass over their reported std, (runs, 4)."""
    nominal = load_arm(name)
    motions = [fourier_motion(nominal, seed) for seed in (1, 2)]
    out = []
    for seed in range(runs):
        truth, rng = varied(nominal, 2000 + seed), np.random.default_rng(seed)
        mass, com = rng.uniform(0.5, 4.0), rng.uniform(-0.05, 0.05, 3) + np.array([0, 0, 0.1])
        parameters = {"mass": mass, **dict(zip(("com_x", "com_y", "com_z"), com, strict=True))}
        loaded = with_effect(truth, ArmEffect("payload", None, parameters))
        fits = [
            fitted(nominal, [recorded(arm, m, 20 * seed + 5 * side + k, memory=memory) for k, m in enumerate(motions)], NARROW)
            for side, arm in enumerate((truth, loaded))
        ]
        load = load_between(fits[0].model, fits[0].solution, fits[1].solution)
        out.append([(load.mass - mass) / load.mass_std, *((load.com - com) / load.com_std)])
        progress(seed)
    return np.array(out)


def _collected(
    one: Callable[[int], tuple[Identification | BaseFit, Arm, np.ndarray]], runs: int, progress: Callable[[int], None]
) -> Coverage:
    from calib.identification.estimates import base_estimates
    from calib.identification.prior import nominal_prior

    z, known, residual = [], [], []
    for seed in range(runs):
        found, truth, left = one(seed)
        model, solution = found.model, found.solution
        expected = TorqueModel.of_arm(truth).with_slip_width(model.slip_width).nominal()
        z.append((solution.theta - expected) / np.sqrt(np.diag(solution.covariance)))
        known.append([e.identifiable for e in base_estimates(model, solution, nominal_prior(model.arm, model))])
        residual.append(left)
        progress(seed)
    kinds = ["base" if k < len(model.base) else name.split("_")[0] for k, name in enumerate(model.names)]
    return Coverage(np.array(z), np.array(known), np.broadcast_to(np.array(kinds), (runs, model.p)), np.array(residual))


def run() -> list[dict[str, Any]]:
    """Rows of the table."""
    runs, more = int(os.environ.get("COVERAGE_RUNS", "50")), int(os.environ.get("COVERAGE_FORMULA_RUNS", "200"))
    rows = []
    for name in ("ur5e", "servo6"):
        found = on_mock(name, runs)
        where = f"mock {name}, {runs} arms"
        rows += [
            _row(f"{where}: 95 % intervals cover", 100 * found.within(1.96), "%", "90-98"),
            _row(f"{where}: worst parameter within 3 std", 100 * found.least_of_any(3.0), "% of runs", ">= 90"),
            _row(f"{where}: held-out residual of sliding joints, worst joint", worst(found, 0), "% of peak", "< 5"),
            _row(f"{where}: held-out residual, reversals included, worst joint", worst(found, 1), "% of peak", "< 5"),
        ]
    found = by_formula("ur5e", more)
    noise = f"formula ur5e, {more} arms, noise of memory 0.8"
    rows += [_row(f"{noise}: {kind}", 100 * found.within(1.96, kind), "%", "90-98") for kind in KINDS]
    z = of_payload("ur5e", more)
    rows.append(_row(f"{noise}: payload mass", 100 * float(np.mean(np.abs(z[:, 0]) < 1.96)), "%", "90-98"))
    rows.append(_row(f"{noise}: payload centre of mass", 100 * float(np.mean(np.abs(z[:, 1:]) < 1.96)), "%", "90-98"))
    return rows


def worst(found: Coverage, which: int) -> float:
    """Residual of the worst joint, % of peak torque, mean over the runs."""
    return 100 * float(found.residual[:, which].mean(axis=0).max())


def _row(what: str, value: float, unit: str, bar: str) -> dict[str, Any]:
    return {"what": what, "value": f"{value:.1f}", "unit": unit, "bar": bar, "note": ""}
