"""The schema of arm.toml."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from sim.strict import Finite, Label, Name, NotNegative, Positive, StrictTable


class LimitsTable(StrictTable):
    """Limits per joint, in the order of `joints`; every key is required unless `incomplete` in arm.toml lists it."""

    q_min: list[Finite] | None = None
    q_max: list[Finite] | None = None
    dq_max: list[Positive] | None = None
    ddq_max: list[Positive] | None = None
    jerk_max: list[Positive] | None = None
    tau_max: list[Positive] | None = None


class SensorsTable(StrictTable):
    """Rate and noise of the arm's readings, used by the plant and as a first guess of the noise floor.

    rate Hz; encoder_resolution rad; velocity_noise rad/s, torque_noise N m (standard deviations per joint).
    """

    rate: Positive
    encoder_resolution: Positive
    velocity_noise: list[NotNegative]
    torque_noise: list[NotNegative]


class EffectTable(StrictTable):
    """One effect that the arm has, with its parameters and, where known, their standard deviations."""

    effect: str
    joint: str | None = None
    parameters: dict[str, Finite]
    std: dict[str, Finite] = Field(default_factory=dict)


Numbers = Literal["measured", "cad", "guessed", "unknown"]


class PriorTable(StrictTable):
    """How well the arm's own numbers are known: relative standard deviations.

    mass, com (relative to the link's size), inertia, coulomb, viscous, rotor.
    numbers  source of the masses and inertias; "unknown": those in the model are placeholders derived from the arm's size
    unknown  what is not stated for this arm: a fit leaves it free, on the scale of sim.prior, and ignores its relative number
    """

    numbers: Numbers | None = None
    unknown: list[Literal["coulomb", "viscous", "rotor", "offset"]] = Field(default_factory=list)
    mass: Positive = 0.015
    com: Positive = 0.015
    inertia: Positive = 0.03
    coulomb: Positive = 0.04
    viscous: Positive = 0.04
    rotor: Positive = 0.1


TorqueAt = Literal["motor", "joint"]
SpeedFrom = Literal["position", "measured"]
Incomplete = Literal["q_min", "q_max", "dq_max", "ddq_max", "jerk_max", "tau_max", "sensors", "shapes"]


class ArmTable(StrictTable):
    """The schema of arm.toml.

    torque_continuous: N m that the joint's drive can hold indefinitely (its rated torque); tau_max is its peak.
    torque_at: where the torque is measured: at the motor (its current, before the gear), or by a sensor at the joint, behind
    the gear.
    speed_from: source of speed and acceleration: differences of the position, or the speed that the drive reports.
    incomplete: what is not stated for this arm, because it was written from a bare model file. Such a limit comes from the
    model if the model has it; otherwise, a caller that needs it asks for it. "shapes": the files of some collision shapes were
    missing. No motion is cleared until they are added to the model, or the entry is removed to do without. Remove an entry from
    the list when its number is written here.
    """

    schema_: Literal["arm/1"] = Field(alias="schema")
    name: Name
    model: str
    joints: list[Label]
    incomplete: list[Incomplete] = Field(default_factory=list)
    limits: LimitsTable = LimitsTable()
    sensors: SensorsTable | None = None
    torque_constant: list[Positive] | None = None
    torque_continuous: list[Positive] | None = None
    torque_at: TorqueAt = "motor"
    speed_from: SpeedFrom = "position"
    prior: PriorTable = PriorTable()
    effects: list[EffectTable] = Field(default_factory=list)
    provenance: dict[str, str]
