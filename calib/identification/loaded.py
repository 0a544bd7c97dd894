"""Logs without and with a load at the flange -> the arm, the load and, with a known mass, the torque constants."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from calib.gate.check import LIKELIEST
from calib.gate.commands import require
from calib.gate.copies import twice
from calib.gate.correction import AS_RECORDED, assumed
from calib.identification.base_fit import Options, fitted, survey
from calib.identification.identify import Identification, identify
from calib.identification.payload import VAGUE, Load, load_between, scale_from_known_mass, scale_from_own_load
from logs.log import Log
from sim.arm import Arm
from sim.errors import BadLog, ConfigError


def identify_with_load(
    arm: Arm,
    logs: Sequence[Log],
    loaded: Sequence[Log],
    holdout: Sequence[Log] = (),
    options: Options | None = None,
    known_mass: float | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> tuple[Identification, Load]:
    """The calibrated arm without the load, and the load.

    With `known_mass` (kg) the torque constants come from it. Where the logs hold currents, the returned arm has them instead of
    the nominal ones (the search begins at 1 N m/A if the arm states none). Where the drive reports torque, the load's `scale`
    is the ratio of reported to true torque.
    """
    options = options or Options()
    require(arm, loaded)
    _require_apart([logs[k] for k in survey(logs)], loaded)
    if known_mass is None:
        found = identify(arm, logs, holdout, options, progress)
        same = replace(options, slip_width=found.model.slip_width, cutoff=found.result.settings["cutoff_hz"])
        load = load_between(found.model, found.solution, fitted(arm, loaded, same, progress).solution)
        return _with_load(found, load, None), load
    provisional = arm if arm.torque_constant is not None else replace(arm, torque_constant=np.ones(arm.n))
    free = fitted(provisional, logs, options, progress)
    same = replace(options, slip_width=free.model.slip_width, cutoff=free.cutoff)
    load = scale_from_known_mass(free.model, free.solution, fitted(provisional, loaded, same, progress).solution, known_mass)
    by_current = np.all([~np.isfinite(log.tau).any(axis=0) for log in (*logs, *loaded)], axis=0)
    if by_current.any():
        constant = np.array(provisional.torque_constant)
        constant[by_current] /= load.scale[by_current]
        origin = (
            f"from {known_mass:g} kg at the flange, by calib identify; std {_row(constant * load.scale_std / load.scale)} N m/A"
        )
        provisional = replace(
            provisional, torque_constant=constant, provenance={**provisional.provenance, "torque_constant": origin}
        )
    found = identify(provisional if by_current.any() else arm, logs, holdout, options, progress)
    return _with_load(found, load, known_mass), load


def _require_apart(logs: Sequence[Log], loaded: Sequence[Log]) -> None:
    """BadLog where a loaded log is also among the others: a recording does not differ from itself."""
    for log in logs:
        for other in loaded:
            check = twice([log, other])
            if not check.ok and not all(AS_RECORDED in assumed(x) for x in (log, other)):
                raise BadLog(f"{check.detail}. {LIKELIEST}{check.causes[0].sentence}")


def identify_with_own_load(
    arm: Arm,
    logs: Sequence[Log],
    holdout: Sequence[Log],
    options: Options,
    known_mass: float,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> Identification:
    """The calibrated arm of one joint; its torque constant is from the gravity of its own load (`calib arm drive --load`)."""
    if arm.n != 1:
        raise ConfigError(
            f"--known-mass {known_mass:g}: {arm.name} has {arm.n} joints, so it needs recordings with that load; give them with --loaded LOG"
        )
    if any(np.isfinite(log.tau).any() for log in logs):
        raise ConfigError(
            f"--known-mass {known_mass:g}: these recordings hold torque, so no torque constant is needed; leave it out"
        )
    provisional = arm if arm.torque_constant is not None else replace(arm, torque_constant=np.ones(1))
    free = fitted(provisional, logs, options, progress)
    scale, std = scale_from_own_load(free.model, free.solution, known_mass)
    constant = np.array(provisional.torque_constant) / scale
    origin = f"from the gravity of its own {known_mass:g} kg, by calib identify; std {_row(constant * std / scale)} N m/A"
    scaled = replace(provisional, torque_constant=constant, provenance={**provisional.provenance, "torque_constant": origin})
    found = identify(scaled, logs, holdout, options, progress)
    sentence = (
        f"the torque constant is {_row(constant)} ± {_row(constant * std / scale)} N m/A, from the gravity of {known_mass:g} kg"
    )
    return replace(found, result=replace(found.result, findings=(*found.result.findings, sentence)))


def _with_load(found: Identification, load: Load, known_mass: float | None) -> Identification:
    at = ", ".join(f"{c * 1e3:.0f} ± {s * 1e3:.1g}" for c, s in zip(load.com, load.com_std, strict=True))
    sentence = f"the loaded logs carry {load.mass:.4g} kg" + ("" if known_mass else f" ± {load.mass_std:.2g}")
    sentence += f" more, at {at} mm in the last link's frame"
    if known_mass:
        sentence += f"; the torque readings are {_row(load.scale)} ± {_row(load.scale_std)} times the torque that {known_mass:g} kg cause"
    more = [sentence]
    vague = load.scale_std > VAGUE * np.abs(load.scale)
    if known_mass and vague.any():
        names = ", ".join(name for name, bad in zip(found.model.arm.joint_names, vague, strict=True) if bad)
        more.append(
            f"the torque constant of {names} stays unknown (standard deviation above {VAGUE:.0%}): this load hardly changes its torque; mount "
            "more mass, or mount it farther from the axis"
        )
    if load.chi2 > 3:
        more.append(
            f"something else changed between the logs with and without the load (chi^2 {load.chi2:.1f} per degree of freedom, 1 expected); "
            "warm up the arm alike for both, and run the same motion"
        )
    result = replace(found.result, load=load.as_dict(), findings=(*found.result.findings, *more))
    return replace(found, result=result)


def _row(values: np.ndarray) -> str:
    return " ".join(f"{v:.3g}" for v in values)
