"""Uncertainty of a parameter from the choice of its effect's law: between-model variance.

If a joint follows law f of F published ones with parameters theta, the fit with the catalogue's law ends at theta + b_f, to
first order b_f = (J' W J)^-1 J' W (tau_f - tau). With equal weights for these laws and the catalogue's own, the variance of a
parameter is that of the fit plus sum_f b_f^2 / (F + 1) (D. Draper 1995, Assessment and Propagation of Model Uncertainty,
doi:10.1111/j.2517-6161.1995.tb02015.x). It concerns the number's distance from the joint's, not the predicted torque.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.diagnosis.fit import Fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.parameters import logarithmic, parameters_of
from calib.diagnosis.sensitivity import other_law
from sim.arm import ArmEffect
from sim.effects import effect_named
from sim.effects.effect import Effect


def form_std(f: Fit) -> list[dict[str, float]]:
    """Square root of the between-model variance of every parameter of every accepted effect, in its unit."""
    accepted = f.accepted
    if not accepted:
        return []
    variance = np.zeros(len(f.covariance))
    for item in (*f.hypothesis.arm.effects, *(e for e in accepted if e.effect == CONTACT)):
        laws = effect_named(item.effect).forms()
        variance += sum((_bias(f, item, law) ** 2 for law in laws), np.zeros_like(variance)) / (len(laws) + 1)
    out = [dict.fromkeys(e.parameters, 0.0) for e in accepted]
    for (i, p), v in zip(parameters_of(accepted), variance, strict=True):
        scale = abs(accepted[i].parameters[p.name]) if logarithmic(p) else 1.0
        out[i][p.name] = float(np.sqrt(v) * scale)
    return out


def with_shift(std: Mapping[str, float], fitted: ArmEffect, written: ArmEffect) -> dict[str, float]:
    """`form_std` of one effect with each parameter's shift from the fit to the arm folder, which has no lead of friction."""
    return {k: float(np.hypot(s, written.parameters[k] - fitted.parameters[k])) for k, s in std.items()}


def _bias(f: Fit, item: ArmEffect, law: Effect) -> np.ndarray:
    """b_f (k,) of the accepted parameters in fitting units if `item` follows `law`; of a logarithm at most 1."""
    joint = f.joint
    change = [other_law(model, f.hypothesis, k, item, law) for k, model in enumerate(f.models)]
    g = np.zeros(len(joint.theta))
    for j in range(joint.rows.n):
        rows = joint.rows.take(j, [c[:, j] for c in change])
        if rows.any():
            g += joint.products(j, joint.rows.whiten(joint.noise, j, rows))
    k = len(f.covariance)
    own = joint.inverse[-k:]
    units = np.sqrt(np.diag(f.covariance) / np.maximum(np.diag(own[:, -k:]), 1e-300))
    bias = units * (own @ g)
    logs = np.array([logarithmic(p) for _, p in parameters_of(f.accepted)])
    return np.where(logs, np.clip(bias, -1.0, 1.0), bias)
