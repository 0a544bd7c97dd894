"""Weighted least squares over all logs of an arm: survey, weights, and the solution before physical consistency."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from calib.identification.calibrated import LINEAR_EFFECTS
from calib.identification.friction import Sweep, as_prior, pre_estimate
from calib.identification.instruments import Instrumental, commanded, instrumental
from calib.identification.least_squares import Solution, estimate
from calib.identification.model import TorqueModel
from calib.identification.portions import LogSums, context_of, joined
from calib.identification.prior import nominal_prior
from calib.identification.row_weights import reference
from calib.identification.rows import RegressorRows
from calib.identification.slip_width import fitted_slip_width
from calib.identification.sums import Reference, Sums
from calib.measurement.exclusions import Exclusion
from calib.measurement.filtering import motion_cutoff
from calib.measurement.periods import averaged
from calib.measurement.preprocessing import Measurement, prepare
from calib.measurement.reversals import reversal_rows, reverses_often
from calib.regression.stored import Kept, digest_of
from logs import Log, Pieces
from sim.arm import Arm
from sim.own_values import values_of
from sim.prediction import torque_path

Progress = Callable[[str, float], None]
SURVEY_SECONDS = 600.0


@dataclass(frozen=True)
class Options:
    """Settings of an identification.

    cutoff       Hz of the common filter; None: from the motion, or lower where that predicts better
    robust       downweight outliers such as reversals
    masses_only  keep every link's inertia about its centre of mass
    slip_width   rad; None: from the data
    gamma        weight of the nominal model in the choice among arms that explain the data equally well
    max_error    of a joint's torque, for a good fit
    laws         fit friction with memory where it predicts better
    speed        choose between differences of the position and the reported speed, or take what the arm states
    """

    cutoff: float | None = None
    robust: bool = True
    masses_only: bool = False
    slip_width: float | np.ndarray | None = None
    gamma: float = 0.5
    max_error: float | None = None
    laws: bool = True
    speed: Literal["best", "as stated"] = "best"


def silent(stage: str, share: float) -> None:
    """Progress that shows nothing."""


@dataclass(frozen=True)
class BaseFit:
    """Model and solution before physical consistency.

    measurements, remarks: of the surveyed logs, the remarks as their readers found them. names, excluded: of all logs. often
    (n,): calib.measurement.reversals.reverses_often. by_command: the instrumental estimate, where the logs hold the commanded
    motion.
    """

    model: TorqueModel
    solution: Solution
    weights: Reference
    sums: Sums
    measurements: tuple[Measurement, ...]
    remarks: tuple[str, ...]
    sweeps: tuple[Sweep, ...]
    often: np.ndarray
    cutoff: float
    names: tuple[str, ...]
    excluded: tuple[tuple[str, Exclusion], ...]
    by_command: Instrumental | None


def fitted(arm: Arm, logs: Sequence[Log], options: Options, progress: Progress = silent, kept: Kept | None = None) -> BaseFit:
    """Weighted least squares over all logs of an arm."""
    surveyed = {k: logs[k] for k in survey(logs)}
    cutoff = options.cutoff or max(motion_cutoff(log) for log in surveyed.values())
    measured: dict[int, Measurement] = {}
    for k, log in surveyed.items():
        progress("reading motion", len(measured) / len(surveyed))
        measured[k] = measure(log, arm, cutoff)
    model = TorqueModel.of_arm(arm)
    few = list(measured.values())
    model = model.with_slip_width(
        fitted_slip_width(model, few) if options.slip_width is None else np.broadcast_to(options.slip_width, arm.n)
    )
    sweeps, taken = pre_estimate(few, model)
    often = reverses_often(few, arm)
    leave_out = {k: taken.get(k, False) | (reversal_rows(m, arm) & ~often) for k, m in enumerate(few)}
    prior, nominal = as_prior(sweeps, model), nominal_prior(arm, model)
    rows = RegressorRows(model, few, leave_out, lambda share: progress("regressor", share))
    weights = reference(rows, prior, nominal, options.robust)
    own = {k: rows.part(i) for i, k in enumerate(measured)}
    context = context_of(arm, cutoff, model.slip_width, often, weights)

    def portion(k: int) -> LogSums:
        progress("sums", k / len(logs))
        if k in own:
            return LogSums.of(own[k], weights, measured[k])
        log = logs[k]
        piece = digest_of(log) if kept else ""
        stored = kept.get(context, piece) if kept else None
        if stored is not None:
            return LogSums.of_arrays(stored)
        m = measure(log, arm, cutoff)
        found = LogSums.of(RegressorRows(model, [m], {0: reversal_rows(m, arm) & ~often}), weights, m)
        if kept:
            kept.put(context, piece, found.arrays())
        return found

    sums, names, excluded = joined(portion(k) for k in range(len(logs)))
    progress("solving", 0.0)
    solution = estimate(model, sums, weights, prior, nominal)
    moved = [commanded(log, m) for log, m in zip(surveyed.values(), few, strict=True)]
    by_command = None
    if not solution.regularised and all(moved):
        progress("instruments", 0.0)
        by_command = instrumental(rows, [m for m in moved if m], weights, prior, solution)
        if by_command and by_command.preferred:
            spread = by_command.covariance
            solution = replace(solution, theta=by_command.theta, covariance=spread, tight=spread)
    remarks = tuple(
        f"{log.path.name if log.path else 'log'}: {sentence}" for log in surveyed.values() for sentence in log.findings
    )
    return BaseFit(
        model, solution, weights, sums, tuple(few), remarks, tuple(sweeps), often, cutoff, names, excluded, by_command
    )


def survey(logs: Sequence[Log]) -> list[int]:
    """Indices of evenly spread logs that in all last at most SURVEY_SECONDS, at least one; all logs if they last no longer."""
    seconds = logs.seconds if isinstance(logs, Pieces) else [float(log.t[-1] - log.t[0]) for log in logs]
    if sum(seconds) <= SURVEY_SECONDS:
        return list(range(len(logs)))
    count = max(1, int(SURVEY_SECONDS / max(seconds)))
    return sorted({int((k + 0.5) * len(logs) / count) for k in range(count)})


def measure(log: Log, arm: Arm, cutoff: float | None = None) -> Measurement:
    """The measurement in a log over the arm's torque gain, minus the torque of those effects of the arm that the fit does not estimate.

    A motion that repeats itself is averaged over its periods.
    """
    m = averaged(prepare(log, arm, cutoff))
    m = replace(m, tau=m.tau / values_of(arm, "torque_gain", "gain", 1.0))
    arm = replace(arm, effects=tuple(e for e in arm.effects if e.effect != "torque_gain"))
    others = [e for e in arm.effects if e.effect not in LINEAR_EFFECTS]
    if not others:
        return m
    linear = [e for e in arm.effects if e.effect in LINEAR_EFFECTS]
    extra = torque_path(arm, m.trajectory).tau - torque_path(arm, m.trajectory, linear).tau
    return replace(m, tau=m.tau - extra)
