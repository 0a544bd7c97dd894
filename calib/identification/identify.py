"""Logs of an arm -> the calibrated arm and its assessment: the whole identification, in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.claims import in_one_sentence
from calib.gate.commands import require
from calib.identification.advice import advice, sentence
from calib.identification.base_fit import BaseFit, Options, Progress, fitted, measure, silent, survey
from calib.identification.calibrated import calibrated_arm
from calib.identification.claims import ASIDE, assessment_of, claims
from calib.identification.consistency import PossibleArm, possible_arm
from calib.identification.empirical_bayes import drawn_to_nominal
from calib.identification.estimates import base_estimates, full_estimates
from calib.identification.findings import findings
from calib.identification.gaps import gap, noise_between_periods
from calib.identification.known import Known
from calib.identification.law import Laws, fitted_laws, without_laws
from calib.identification.least_squares import Solution
from calib.identification.model import TorqueModel
from calib.identification.prior import full_covariance, full_nominal, nominal_prior
from calib.identification.readings import chosen_reading
from calib.identification.rows import RegressorRows
from calib.identification.sums import plain
from calib.measurement.preprocessing import Measurement
from calib.measurement.reversals import reversal_rows
from calib.regression.normal_equations import wider
from calib.regression.stored import Kept
from calib.result import Conditioning, FitResult, Gap
from logs import Log
from sim.arm import Arm, ArmEffect

# Largest ratio of a joint's residual to that of the fit without laws. On seven real arms and drives: at most 1.04 where laws
# help; 1.05 on a servo (XL330) whose held-out logs are predicted better by the laws' parameters without a law (0.38 of the
# torque std, not 0.44). Three published arms on the mock where laws predict held-out logs worse: 1.31, 2.00 and 2.29. Laws
# without negative damping: 1.12 (Rokae xMate3)
MORE = 1.15


@dataclass(frozen=True)
class Identification:
    """The calibrated arm, its uncertainty, the result, and what a report draws: model, solution, consistent arm, measurements.

    laws: friction laws, whose torque is not in theta.
    """

    arm: Arm
    known: Known
    result: FitResult
    model: TorqueModel
    solution: Solution
    possible: PossibleArm
    measurements: tuple[Measurement, ...]
    holdout: tuple[Measurement, ...]
    laws: tuple[ArmEffect, ...] = ()


def identify(
    arm: Arm,
    logs: Sequence[Log],
    holdout: Sequence[Log] = (),
    options: Options | None = None,
    progress: Progress = silent,
    kept: Kept | None = None,
) -> Identification:
    """Parameters of `arm` from `logs`, checked on `holdout`; the returned arm is physically consistent.

    If the logs last more than SURVEY_SECONDS, a part spread over all of them determines row weights and the slip width of dry
    friction. Every other log is then read once, and only its sums are kept (in `kept`, if given), so that memory does not grow
    with the logs. BadLog and ConfigError for logs that cannot serve, in which a joint hardly moves, or that are not of this arm
    (calib.gate). AnswerIsNo where no physically consistent arm is near the estimates.
    """
    options = options or Options()
    progress("checking", 0.0)
    require(arm, [*(logs[k] for k in survey(logs)), *holdout])
    reading = chosen_reading(arm, [logs[k] for k in survey(logs)], options.cutoff) if options.speed == "best" else None
    if reading is not None:
        arm, options = replace(arm, speed_from=reading.speed), replace(options, cutoff=reading.cutoff)
    fit = fitted(arm, logs, options, progress, kept)
    held = [measure(log, arm, fit.cutoff) for log in holdout]
    model, solution, sums = fit.model, fit.solution, fit.sums
    progress("friction of the joints", 0.0)
    by_command = fit.by_command is not None and fit.by_command.preferred
    several = (
        fitted_laws(model, fit.measurements, nominal_prior(arm, model), solution.sigma)
        if options.laws and not by_command
        else []
    )
    laws = next((x for x in several if _leaves_no_more(arm, fit, x)), None)
    if laws:
        solution = replace(
            solution, theta=laws.theta, covariance=wider(solution.covariance, laws.covariance), tight=laws.covariance
        )
    theta, tight = solution.theta, solution.tight
    if not (laws or solution.regularised):  # the others already use the nominal arm
        theta, tight = drawn_to_nominal(arm, model, theta, tight)
    kept_rows = RegressorRows(model, held, {k: reversal_rows(m, arm) & ~fit.often for k, m in enumerate(held)})
    progress("physically consistent inertias", 0.0)
    pi0 = full_nominal(arm, model)
    possible = possible_arm(model, theta, tight, pi0, options.gamma, options.masses_only)
    calibrated = calibrated_arm(
        arm, model, possible, np.sqrt(np.diag(solution.covariance)), fit.names, laws.effects if laws else ()
    )
    nominal = nominal_prior(arm, model)
    estimates = base_estimates(model, solution, nominal, TorqueModel.of_arm(calibrated).nominal())
    unknown = [k for k, e in enumerate(estimates) if not e.identifiable]
    helpful = advice(
        model, solution, nominal, unknown, np.mean([m.trajectory.q.mean(axis=0) for m in fit.measurements], axis=0)
    )
    training = gap(model, sums.plain, sums.apart, fit.names, possible.theta, noise_between_periods(fit.measurements))
    unseen = None
    if held:
        seen_not = plain(kept_rows), plain(kept_rows, apart=True)
        unseen = gap(model, *seen_not, [m.name for m in held], possible.theta, noise_between_periods(held))
    if laws and laws.effects:
        training = _with_laws(training, model, fit.measurements, laws, possible.theta, fit.often)
        unseen = unseen and _with_laws(unseen, model, held, laws, possible.theta, fit.often)
    excluded = [*fit.excluded, *[(m.name, e) for m in held for e in m.excluded]]
    result = FitResult(
        arm=arm.name,
        joint_names=arm.joint_names,
        estimates=estimates,
        covariance=solution.covariance,
        training=training,
        holdout=unseen,
        condition=solution.condition,
        condition_scaled=solution.condition_scaled,
        conditioning=Conditioning.of(solution.condition),
        outcome="",
        full=full_estimates(model, solution, possible, pi0, full_covariance(arm)),
        findings=(*findings(arm, fit), *(sentence(item) for item in helpful)),
        excluded=tuple((name, e.joint or "all joints", e.reason, e.seconds) for name, e in excluded),
        settings={
            "cutoff_hz": fit.cutoff, "robust": options.robust, "masses_only": options.masses_only, "gamma": options.gamma,
            "slip_width_rad": model.slip_width.tolist(), "rows_per_second": fit.measurements[0].decimator.row_rate,
            "speed_from": arm.speed_from, "motion_hz": None if reading is None else reading.motion,
        },
        advice=tuple((item.motion, item.parameters) for item in helpful),
    )  # fmt: skip
    verdict = assessment_of(arm, result, options.max_error)
    claimed = claims(arm, result, verdict, calibrated, fit.measurements)
    aside = [claim for claim in claimed if claim.name in ASIDE]
    result = replace(
        result, verdict=verdict.verdict, assessment=verdict.as_dict(), claims=claimed,
        outcome=in_one_sentence([claim for claim in claimed if claim.name not in ASIDE]),
        findings=(*(claim.sentence for claim in aside), *result.findings),
    )  # fmt: skip
    slow = fit.weights.noise.drive if fit.weights.slow is None else fit.weights.slow
    intensity = slow**2 / fit.measurements[0].decimator.row_rate
    known = Known(solution.covariance, intensity, "was identified from " + ", ".join(fit.names))
    effects = laws.effects if laws else ()
    return Identification(calibrated, known, result, model, solution, possible, fit.measurements, tuple(held), effects)


def _leaves_no_more(arm: Arm, fit: BaseFit, laws: Laws) -> bool:
    """Whether the laws leave, at every joint in motion, at most MORE times the residual of the fit without them.

    Their own fit also uses rows at rest and near reversals. Where the origin of the arm's numbers is not stated, the laws'
    parameters without a law are never taken.
    """
    if not laws.effects and arm.prior.numbers is None:
        return False
    other = gap(fit.model, fit.sums.plain, fit.sums.apart, (), fit.solution.theta)
    left = gap(fit.model, fit.sums.plain, fit.sums.apart, (), laws.theta)
    if laws.effects:
        left = _with_laws(left, fit.model, fit.measurements, laws, laws.theta, fit.often)
    return not np.any(np.asarray(left.after) > MORE * np.asarray(other.after))


def _with_laws(
    of: Gap, model: TorqueModel, measurements: Sequence[Measurement], laws: Laws, theta: np.ndarray, often: np.ndarray
) -> Gap:
    """The gap after the friction laws' torque is subtracted; the residual of the nominal arm stays unchanged."""
    few = without_laws(measurements, laws.effects, model.arm)
    rows = RegressorRows(model, few, {k: reversal_rows(m, model.arm) & ~often for k, m in enumerate(few)})
    after = gap(model, plain(rows), plain(rows, apart=True), of.logs, theta)
    return replace(of, after=after.after, sliding=after.sliding, after_ampere=after.after_ampere)
