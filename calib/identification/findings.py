"""Sentences about a fit: what a reader of its numbers should know."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from calib.identification.instruments import LEVEL
from calib.identification.model import SLIP_WIDTHS
from sim.arm import Arm

if TYPE_CHECKING:
    from calib.identification.base_fit import BaseFit


def findings(arm: Arm, fit: BaseFit) -> tuple[str, ...]:
    """Findings of a fit, as sentences."""
    out, solution, sweeps, model = list(fit.remarks), fit.solution, fit.sweeps, fit.model
    if sweeps:
        joints = ", ".join(arm.joint_names[s.joint] for s in sweeps)
        out.append(f"friction of {joints} was estimated from the constant-speed sweeps first and enters as a prior")
    floors: dict[tuple[str, float], list[np.ndarray]] = {}  # a long recording is several measurements
    for m in fit.measurements:
        if m.period is not None and m.noise is not None:
            floors.setdefault((m.name, m.period), []).append(m.noise)
    for (name, period), noises in floors.items():
        floor = ", ".join(f"{x:.3g}" for x in np.sqrt(np.mean(np.square(noises), axis=0)))
        out.append(
            f"{name} repeats a motion of {period:.4g} s: its average over the periods was differentiated; the torque differs by {floor} N m "
            "between the periods (RMS, filtered), which no model can explain"
        )
    if solution.regularised:
        shown = f"the scaled condition number is {solution.condition_scaled:.3g}"
        shown = shown if math.isfinite(solution.condition_scaled) else "some directions are not excited at all"
        out.append(f"{shown}, so parameters that the motion did not excite stay near nominal")
    bent = [j for j, ar in zip(arm.joint_names, fit.weights.noise.ar, strict=True) if not ar.any()]
    if bent:
        out.append(
            f"{', '.join(bent)}: the low-frequency residual repeats in every log, so it is model error, not noise; no whitening was "
            "applied. Friction while a joint begins to slide is such an error; `calib diagnose` looks for other causes"
        )
    wide = [j for j, w in zip(arm.joint_names, model.slip_width, strict=True) if w > SLIP_WIDTHS[0]]
    if wide:
        out.append(
            f"dry friction of {', '.join(wide)} builds up over more than {SLIP_WIDTHS[0]:g} rad after a change of direction"
        )
    if fit.by_command and fit.by_command.preferred:
        out.append(
            f"position noise biases least squares (Hausman test, p = {fit.by_command.p_value:.1g}), so the commanded motion was used "
            "as instrument"
        )
    elif fit.by_command and fit.by_command.p_value < LEVEL:
        out.append(
            f"least squares disagrees with the commanded motion as instrument (p = {fit.by_command.p_value:.1g}), but that instrument "
            "is too weak to replace it: the intervals may be too narrow"
        )
    if fit.often.any():
        names = ", ".join(j for j, k in zip(arm.joint_names, fit.often, strict=True) if k)
        out.append(
            f"{names}: most rows are close to a reversal, so these rows had to stay in the fit; friction and reflected inertia may be off by "
            "more than their standard deviations: record a slower or longer motion"
        )
    for joint, share in zip(arm.joint_names, solution.downweighted, strict=True):
        if share > 0.1:
            out.append(
                f"{joint}: {share:.0%} of the rows have residuals too large for a normal distribution; `calib diagnose` looks for the cause"
            )
    return tuple(out)
