"""Logs of an arm -> the calibrated arm and what it is worth: the whole identification, in the order in which it is done."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.identification.calibrated import calibrated_arm
from calib.identification.consistency import PossibleArm, possible_arm
from calib.identification.estimates import base_estimates, full_estimates
from calib.identification.friction import Sweep, as_prior, pre_estimate
from calib.identification.information import Information
from calib.identification.least_squares import Solution, estimate, reference
from calib.identification.model import SLIP_WIDTHS, TorqueModel
from calib.identification.portions import Kept, Portion, context_of, digest_of, joined
from calib.identification.prior import full_covariance, full_nominal, nominal_prior
from calib.identification.rows import Rows
from calib.identification.sums import plain
from calib.preprocessing import Measurement, motion_cutoff, prepare
from calib.result import Conditioning, FitResult, Gap
from logs import Log, Pieces
from sim.arm import Arm
from sim.prediction import torque_path

Progress = Callable[[str, float], None]
SURVEY_SECONDS = 600.0
LINEAR_EFFECTS = ("coulomb_friction", "viscous_friction", "rotor_inertia", "torque_offset", "presliding_friction")


@dataclass(frozen=True)
class Options:
    """How to identify. cutoff Hz of the common filter (None: from the motion); robust: downweight outliers such as reversals;
    masses_only: keep every link's inertia about its centre of mass; slip_width rad (None: from the data); gamma: weight of the
    nominal model in the choice among arms that explain the data equally well.
    """

    cutoff: float | None = None
    robust: bool = True
    masses_only: bool = False
    slip_width: float | None = None
    gamma: float = 0.5


@dataclass(frozen=True)
class Identification:
    """The calibrated arm, the result that tells of it, and what a report needs to draw: model, theta and measurements."""

    arm: Arm
    result: FitResult
    model: TorqueModel
    solution: Solution
    possible: PossibleArm
    measurements: tuple[Measurement, ...]
    holdout: tuple[Measurement, ...]


def _silent(stage: str, share: float) -> None:
    return None


def identify(
    arm: Arm,
    logs: Sequence[Log],
    holdout: Sequence[Log] = (),
    options: Options | None = None,
    progress: Progress = _silent,
    kept: Kept | None = None,
) -> Identification:
    """Parameters of `arm` from `logs`, checked on `holdout`; the arm that is returned can exist.

    Of more than SURVEY_SECONDS of log, a part that is spread over all of it says how rows are weighed and what its dry friction is
    like; then every log is read once and only its sums stay (in `kept`, if given), so that memory does not grow with the logs.
    BadLog and ConfigError for logs that cannot serve; AnswerIsNo where a joint hardly moves.
    """
    options = options or Options()
    surveyed = {k: logs[k] for k in survey(logs)}
    cutoff = options.cutoff or max(motion_cutoff(log) for log in surveyed.values())
    measured: dict[int, Measurement] = {}
    for k, log in surveyed.items():
        progress("reading motion", len(measured) / len(surveyed))
        measured[k] = measure(log, arm, cutoff)
    held = [measure(log, arm, cutoff) for log in holdout]
    model = TorqueModel.of_arm(arm)
    few = list(measured.values())
    model = model.with_slip_width(np.full(arm.n, options.slip_width) if options.slip_width else fitted_slip_width(model, few))
    sweeps, leave_out = pre_estimate(few, model)
    prior, nominal = as_prior(sweeps, model), nominal_prior(arm, model)
    rows = Rows(model, few, leave_out, lambda share: progress("regressor", share))
    weights = reference(rows, prior, nominal, options.robust)
    own = {k: rows.part(i) for i, k in enumerate(measured)}
    context = context_of(arm, cutoff, model.slip_width, weights)

    def portion(k: int) -> Portion:
        progress("sums", k / len(logs))
        if k in own:
            return Portion.of(own[k], weights, measured[k])
        log = logs[k]
        piece = digest_of(log) if kept else ""
        found = kept.get(context, piece) if kept else None
        if found is None:
            m = measure(log, arm, cutoff)
            found = Portion.of(Rows(model, [m]), weights, m)
            if kept:
                kept.put(context, piece, found)
        return found

    sums, names, excluded = joined(portion(k) for k in range(len(logs)))
    progress("solving", 0.0)
    solution = estimate(model, sums, prior, nominal)
    progress("nearest possible arm", 0.0)
    pi0 = full_nominal(arm, model)
    possible = possible_arm(model, solution.theta, solution.covariance, pi0, options.gamma, options.masses_only)
    calibrated = calibrated_arm(arm, model, possible, np.sqrt(np.diag(solution.covariance)), names)
    verdict = Conditioning.of(solution.condition)
    told = [*excluded, *[(m.name, e) for m in held for e in m.excluded]]
    result = FitResult(
        arm=arm.name,
        joint_names=arm.joint_names,
        estimates=base_estimates(model, solution, nominal),
        covariance=solution.covariance,
        training=gap(model, sums.usable, names, possible.theta),
        holdout=gap(model, plain(Rows(model, held)), [m.name for m in held], possible.theta) if held else None,
        condition=solution.condition,
        condition_scaled=solution.condition_scaled,
        verdict=verdict,
        outcome="",
        full=full_estimates(model, solution, possible, pi0, full_covariance(arm)),
        findings=findings(arm, list(surveyed.values()), solution, sweeps, model),
        excluded=tuple((name, e.joint or "all joints", e.reason, e.seconds) for name, e in told),
        settings={
            "cutoff_hz": cutoff, "robust": options.robust, "masses_only": options.masses_only, "gamma": options.gamma,
            "slip_width_rad": model.slip_width.tolist(), "rows_per_second": rows.row_rate,
        },
    )  # fmt: skip
    result = replace(result, outcome=outcome(result))
    return Identification(calibrated, result, model, solution, possible, tuple(few), tuple(held))


def survey(logs: Sequence[Log]) -> list[int]:
    """Indices of logs that together last SURVEY_SECONDS at most, spread evenly over all; all of them where they last no longer."""
    seconds = logs.seconds if isinstance(logs, Pieces) else [float(log.t[-1] - log.t[0]) for log in logs]
    if sum(seconds) <= SURVEY_SECONDS:
        return list(range(len(logs)))
    count = max(1, int(SURVEY_SECONDS / max(seconds)))
    return sorted({int((k + 0.5) * len(logs) / count) for k in range(count)})


def measure(log: Log, arm: Arm, cutoff: float | None = None) -> Measurement:
    """The measurement in a log, less the torque of those effects of the arm that the fit leaves as they are."""
    m = prepare(log, arm, cutoff)
    others = [e for e in arm.effects if e.effect not in LINEAR_EFFECTS]
    if not others:
        return m
    linear = [e for e in arm.effects if e.effect in LINEAR_EFFECTS]
    extra = torque_path(arm, m.trajectory).tau - torque_path(arm, m.trajectory, linear).tau
    return replace(m, tau=m.tau - extra)


def fitted_slip_width(model: TorqueModel, measurements: Sequence[Measurement], most: int = 5000) -> np.ndarray:
    """(n,) rad: of SLIP_WIDTHS the one that leaves each joint's rows the least residual; the narrowest unless another wins by 2 %."""
    n = model.arm.n
    sums = [[np.zeros((0, 0))] * n for _ in SLIP_WIDTHS]
    blocks = _first_rows(model, measurements, most)
    for k, width in enumerate(SLIP_WIDTHS):
        other = model.with_slip_width(np.full(n, width))
        for m, fine, used in blocks:
            slip = m.decimator.rows(other.slip(m.trajectory.q[fine[0]]))
            for j in range(n):
                a = fine[1][j].copy()
                a[:, int(np.searchsorted(used[j], model.friction_column("coulomb", j)))] = slip[:, j]
                keep = fine[3][:, j]
                full = np.concatenate([a[keep], fine[2][keep, j : j + 1]], axis=1)
                gram = full.T @ full
                sums[k][j] = gram if sums[k][j].shape != gram.shape else sums[k][j] + gram
    left = np.array([[_left(gram) for gram in row] for row in sums])
    best = np.argmin(left, axis=0)
    best = np.where(left[best, np.arange(n)] < 0.98 * left[0], best, 0)
    return np.array(SLIP_WIDTHS)[best]


def _first_rows(model: TorqueModel, measurements: Sequence[Measurement], most: int) -> list:  # type: ignore[type-arg]
    out, count = [], 0
    used = [model.used_by(j) for j in range(model.arm.n)]
    for m in measurements:
        first = 0
        for samples in m.blocks(20_000):
            tr = m.trajectory
            a = [m.decimator.rows(x) for x in model.joint_columns(tr.q[samples], tr.dq[samples], tr.ddq[samples])]
            b = m.decimator.rows(m.tau[samples])
            out.append((m, (samples, a, b, m.row_usable[first : first + len(b)]), used))
            first += len(b)
            count += len(b)
            if count > most:
                return out
    return out


def _left(gram: np.ndarray) -> float:
    """Least residual sum of squares of the last column on the others, from their Gram matrix."""
    norm = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    g = gram / np.outer(norm, norm)
    x = np.linalg.pinv(g[:-1, :-1], rcond=1e-10, hermitian=True) @ g[:-1, -1]
    return float(max(g[-1, -1] - x @ g[:-1, -1], 0.0) * norm[-1] ** 2)


def gap(model: TorqueModel, rows: Sequence[Information], names: Sequence[str], after: np.ndarray) -> Gap:
    """RMS of the filtered torque that the nominal parameters and `after` (p,) leave; `rows`: per joint those of [A_j b_j]."""
    n = model.arm.n
    used = [model.used_by(j) for j in range(n)]
    count = np.array([r.rows for r in rows])
    safe = np.where(count > 0, count, np.nan)

    def rms(theta: np.ndarray) -> np.ndarray:
        return np.sqrt([rows[j].squares(np.append(-theta[used[j]], 1.0)) for j in range(n)] / safe)

    before, left = rms(model.nominal()), rms(after)
    total, mean = (
        np.array([r.gram[k, -1] for r in rows]) / safe for k in (-1, -2)
    )  # the column before the torque is the constant
    constant = model.arm.torque_constant
    return Gap(
        logs=tuple(names),
        before=before,
        after=left,
        signal=np.sqrt(np.maximum(total - mean**2, 0.0)),
        rows=count,
        before_ampere=None if constant is None else before / constant,
        after_ampere=None if constant is None else left / constant,
    )


def findings(arm: Arm, logs: Sequence[Log], solution: Solution, sweeps: Sequence[Sweep], model: TorqueModel) -> tuple[str, ...]:
    """Sentences that a reader of the numbers should know."""
    out = [f"{log.path.name if log.path else 'log'}: {sentence}" for log in logs for sentence in log.findings]
    if sweeps:
        joints = ", ".join(arm.joint_names[s.joint] for s in sweeps)
        out.append(f"friction of {joints} was estimated from the constant-speed sweeps first and enters as a prior")
    if solution.regularised:
        out.append(
            f"the scaled condition number is {solution.condition_scaled:.3g}, so the arm's nominal numbers hold what the motion did not show"
        )
    wide = [j for j, w in zip(arm.joint_names, model.slip_width, strict=True) if w > SLIP_WIDTHS[0]]
    if wide:
        out.append(
            f"dry friction of {', '.join(wide)} builds up over more than {SLIP_WIDTHS[0]:g} rad after a change of direction"
        )
    for joint, share in zip(arm.joint_names, solution.downweighted, strict=True):
        if share > 0.1:
            out.append(
                f"{joint}: {share:.0%} of the rows leave residuals that a normal distribution would not; `calib diagnose` looks for the cause"
            )
    return tuple(out)


def outcome(result: FitResult) -> str:
    """The fit in one sentence."""
    unknown = [e.name.split(" ")[0] for e in result.estimates if not e.identifiable]
    gap = result.holdout or result.training
    where = "held-out" if result.holdout else "training"
    share = float(np.nanmean(gap.after / np.maximum(gap.before, 1e-12)))
    told = (
        f"; not identifiable from these logs: {', '.join(unknown[:6])}{' and others' if len(unknown) > 6 else ''}"
        if unknown
        else ""
    )
    return (
        f"{len(result.estimates) - len(unknown)} of {len(result.estimates)} parameters identified, condition number "
        f"{result.condition:.3g} ({result.verdict.name.lower()}); the {where} torque residual is {share:.0%} of the nominal arm's{told}"
    )
