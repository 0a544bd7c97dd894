"""Diagnosis of an arm that stands still: its inertia and friction do not show, but a push against it does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.diagnosis.answer import Diagnosis, answer, entry
from calib.diagnosis.contact import force_spread
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.prices import MOST_SURE
from calib.gate import GateCheck
from calib.gate.commands import examined
from calib.gate.readings import name_of, seconds_of_motion
from calib.measurement.standing import Push, pushes
from logs.log import Log
from sim.arm import Arm, ArmEffect
from sim.rigid_body import RigidBody

GIVES_WAY = 1.0  # s of motion that a push may cause in a recording of a standing arm


def pushed_at_rest(arm: Arm, logs: Sequence[Log]) -> Diagnosis | None:
    """Contacts in logs of a standing arm; None if it moves, if another check fails, or if nothing pushed it."""
    trusted: list[GateCheck] = []
    found: list[tuple[ArmEffect, dict[str, float], str]] = []
    for log in logs:
        checks, _ = examined(arm, [log], [log])
        failed = {check.check for check in checks if not check.ok}
        if failed != {"motion"} or seconds_of_motion(log) > GIVES_WAY:
            return None
        trusted += [check for check in checks if check.ok]
        found += [(*_contact(arm, log, push), name_of(log)) for push in pushes(arm, log)]
    if not found:
        return None
    trusted.append(GateCheck("standing", True, "the arm stands still: only pushes against it can be found"))
    # a push counts as one only beyond what dry friction can hold
    entries = [entry(arm, item, std, MOST_SURE, 1.0 / len(found)) | {"log": name} for item, std, name in found]
    return Diagnosis(answer(arm, "effects_found", entries, [], None, "", trusted), tuple(item for item, *_ in found), None)


def _contact(arm: Arm, log: Log, push: Push) -> tuple[ArmEffect, dict[str, float]]:
    """Force f on the last link from the drives' response, -J(q)^T f = tau, as far as dry friction lets them show it.

    Gaussian in f with prior standard deviation `force_spread`. A joint's torque error counts as uniform over its band.
    """
    at = int(np.searchsorted(log.t, 0.5 * (push.start + push.end)))
    linear, _ = RigidBody(arm).jacobian(log.q[at : at + 1])
    columns = -linear[0].T
    weight = 1.0 / np.where(np.isfinite(push.doubt), push.doubt / np.sqrt(12.0), np.inf)
    information = (columns * weight[:, None]).T @ (columns * weight[:, None]) + np.eye(3) / force_spread(arm) ** 2
    covariance = np.linalg.inv(information)
    force = covariance @ (columns.T @ (weight**2 * push.torque))
    step = log.period
    values = {"start": push.start, "duration": push.end - push.start}
    std = {"start": step, "duration": 2 * step}
    for axis, value, variance in zip("xyz", force, np.diag(covariance), strict=True):
        values[f"force_{axis}"], std[f"force_{axis}"] = float(value), float(np.sqrt(variance))
    return ArmEffect(CONTACT, None, values), std
