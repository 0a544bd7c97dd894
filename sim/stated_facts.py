"""Facts stated about an arm that its model file does not have: limits, and properties of its drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim.arm import Arm, ArmEffect
from sim.arm_table import LimitsTable
from sim.effects import with_effect
from sim.errors import ConfigError
from sim.prior import EFFECT
from sim.resources import nearest

LIMIT_UNITS = {"q_min": "rad", "q_max": "rad", "dq_max": "rad/s", "ddq_max": "rad/s^2", "jerk_max": "rad/s^3", "tau_max": "N m"}
# drive properties from a data sheet or a bench: unit, key of the prior, and relative standard deviation (friction changes by a third
# between a cold and a warm gear: B. Armstrong-Helouvry et al. 1994, doi:10.1016/0005-1098(94)90209-7)
DRIVE_FACTS = {
    "coulomb": ("N m", "coulomb", 0.3),
    "viscous": ("N m s/rad", "viscous", 0.3),
    "inertia": ("kg m^2", "rotor", 0.1),
}
# relative standard deviation of a stated stiffness: springs are made to within about a tenth, which is two of these
SPRING = 0.05


def with_limits(arm: Arm, limits: Mapping[str, list[float]]) -> Arm:
    """The arm with these limits, one number for each joint or one for all; ConfigError if one is impossible."""
    rows: dict[str, np.ndarray] = {}
    for key, values in limits.items():
        if key not in LimitsTable.model_fields:
            raise ConfigError(f"there is no limit {key!r}; {nearest(key, LimitsTable.model_fields)}")
        row = _each(arm, key, values)
        if not np.all(np.isfinite(row)) or (key not in ("q_min", "q_max") and not np.all(row > 0)):
            raise ConfigError(
                f"{key} = {row.tolist()} {LIMIT_UNITS[key]}: every number must be finite, and above zero except for q_min and q_max"
            )
        rows[key] = row
    q_min, q_max = rows.get("q_min", arm.q_min), rows.get("q_max", arm.q_max)
    if np.any(q_min >= q_max):
        j = int(np.argmax(q_min >= q_max))
        raise ConfigError(f"{arm.joint_names[j]}: q_min {q_min[j]} rad is not below q_max {q_max[j]} rad")
    return replace(
        arm, q_min=q_min, q_max=q_max, dq_max=rows.get("dq_max", arm.dq_max), ddq_max=rows.get("ddq_max", arm.ddq_max),
        jerk_max=rows.get("jerk_max", arm.jerk_max), tau_max=rows.get("tau_max", arm.tau_max),
    )  # fmt: skip


def limit_sources(own: Arm, arm: Arm, source: str) -> str:
    """Source of each limit of `arm`, in words; `own` is the arm as its model file `source` states it, before any was given."""
    rows = {key: (getattr(own, key), getattr(arm, key)) for key in LIMIT_UNITS}
    given = [key for key, (before, after) in rows.items() if not np.array_equal(before, after, equal_nan=True)]
    read = [key for key, (before, _) in rows.items() if key not in given and np.isfinite(before).any()]
    part = [key for key in read if not np.isfinite(rows[key][0]).all()]
    absent = [key for key in LIMIT_UNITS if key not in given and key not in read]
    words = [
        (read, f"read from {source}"), (part, "not for every joint"), (given, "given by hand"), (absent, "not stated"),
    ]  # fmt: skip
    return "; ".join(f"{', '.join(keys)} {how}" for keys, how in words if keys)


def with_drives(arm: Arm, facts: Mapping[str, list[float]]) -> Arm:
    """The arm with these drive properties, one number for each joint or one for all, as stated with the deviation of DRIVE_FACTS.

    ConfigError for an unknown property, and for a number that is not above zero: zero states nothing.
    """
    for key, values in facts.items():
        if key not in DRIVE_FACTS:
            raise ConfigError(f"there is no drive property {key!r}; {nearest(key, DRIVE_FACTS)}")
        (unit, prior, spread), row = DRIVE_FACTS[key], _each(arm, key, values)
        if not (np.all(np.isfinite(row)) and np.all(row > 0)):
            raise ConfigError(
                f"{key} = {row.tolist()} {unit}: every number must be finite and above zero; leave out what is not known"
            )
        effect, parameter = EFFECT[prior]
        for joint, value in zip(arm.joint_names, row.tolist(), strict=True):
            arm = with_effect(arm, ArmEffect(effect, joint, {parameter: value}))
        unknown = [k for k in arm.prior.unknown if k != prior]
        arm = replace(arm, prior=arm.prior.model_copy(update={"unknown": unknown, prior: spread}))
    return arm


def with_springs(arm: Arm, springs: Mapping[str, list[float]]) -> Arm:
    """The arm with springs: joint -> stiffness N m/rad and rest angle rad.

    A soft spring with a distant rest angle has a nearly constant torque. ConfigError for a joint that the arm does not have,
    and for an invalid spring.
    """
    for joint, numbers in springs.items():
        if joint not in arm.joint_names:
            raise ConfigError(f"--spring {joint}: there is no such joint; {nearest(joint, arm.joint_names)}")
        if len(numbers) != 2 or not np.all(np.isfinite(numbers)) or not numbers[0] > 0:
            raise ConfigError(
                f"--spring {joint} = {numbers}: write JOINT=K,Q0, the stiffness in N m/rad, above zero, and the rest angle in rad"
            )
        spring = {"stiffness": numbers[0], "rest_angle": numbers[1]}
        arm = with_effect(arm, ArmEffect("joint_spring", joint, spring, {"stiffness": SPRING * numbers[0]}))
    return arm


def _each(arm: Arm, key: str, values: list[float]) -> np.ndarray:
    row = np.array(values * arm.n if len(values) == 1 else values, dtype=float)
    if len(row) != arm.n:
        raise ConfigError(f"{key} has {len(row)} numbers for {arm.n} joints ({', '.join(arm.joint_names)})")
    return row


def missing_limits(arm: Arm) -> list[str]:
    """The limits that are missing for at least one joint."""
    return [key for key in LIMIT_UNITS if not np.all(np.isfinite(getattr(arm, key)))]
