"""Assignment of servo drives to joints: the `[options]` of a can_servo cell, read by the driver and the emulated drives."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from sim.arm import Arm
from sim.cell import Cell
from sim.errors import ConfigError
from sim.resources import nearest
from sim.strict import Finite, Positive, StrictTable, validated

ProtocolName = Literal["damiao", "cubemars", "robstride", "odrive"]


class RangeTable(StrictTable):
    """Ranges that a drive's frames encode, for drives that cannot report them: +-rad, +-rad/s, +-N m, and gains from zero up.

    No drive has a range outside these bounds: it is an unset register, or in another unit.
    """

    q: Annotated[Finite, Field(ge=0.1, le=1e4)]
    dq: Annotated[Finite, Field(ge=0.1, le=1e4)]
    tau: Annotated[Finite, Field(ge=0.01, le=1e4)]
    kp: Positive = 500.0
    kd: Positive = 5.0


class ServoTable(StrictTable):
    """One drive: the joint it moves, its identifiers, its serial number, and its gains.

    q_joint = direction * q_drive + zero; kp N m/rad and kd N m s/rad of an impedance drive. `feedback`: identifier of its
    replies (Damiao MST_ID, CubeMars). `gear`: motor revolutions per joint revolution (ODrive). protocol and fd (CAN FD frames
    at the data bit rate) default to those of the bus.
    """

    joint: str
    protocol: ProtocolName | None = None
    fd: bool | None = None
    node: Annotated[int, Field(ge=0, le=0x7FF)]
    feedback: Annotated[int, Field(ge=0, le=0x7FF)] | None = None
    serial: str | None = None
    kp: Annotated[Finite, Field(ge=0)] = 0.0
    kd: Annotated[Finite, Field(ge=0)] = 0.0
    direction: Literal[-1, 1] = 1
    zero: Finite = 0.0
    gear: Positive = 1.0
    ranges: RangeTable | None = None
    watchdog_endpoint: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None


class CanOptions(StrictTable):
    """A bus and its drives.

    interface, channel, bitrate and `bus` go to python-can. data_bitrate makes it a CAN FD bus, on which Damiao drives use FD
    unless their servo entry says otherwise. protocol applies to every drive whose servo entry names none. rate Hz is the
    control rate. watchdog s is the silence after which a drive switches itself off. brakes: whether the joints hold without
    torque. bus_load_max is the largest share of the bit rate that the planned traffic may take in the worst case. `assume` is
    the cell's (sim.assumptions).
    """

    interface: str
    channel: str
    bitrate: Literal[1_000_000, 500_000, 250_000, 125_000] = 1_000_000
    data_bitrate: Literal[2_000_000, 4_000_000, 5_000_000, 8_000_000] | None = None
    bus: dict[str, str | int | float | bool] = Field(default_factory=dict)
    protocol: ProtocolName | None = None
    rate: Positive
    watchdog: Annotated[Finite, Field(gt=0, le=0.5)] = 0.1
    brakes: bool
    rest_tolerance: Positive = 0.05
    start_tolerance: Positive = 0.03
    feedforward: Literal["none", "gravity", "model"] = "model"
    temperature_max: Positive = 70.0
    bus_load_max: Annotated[Finite, Field(gt=0, le=0.95)] = 0.75
    ignore: list[Annotated[int, Field(ge=0, le=0x1FFFFFFF)]] = Field(default_factory=list)
    servos: list[ServoTable]
    assume: frozenset[str] = frozenset()

    @model_validator(mode="after")
    def _distinct(self) -> CanOptions:
        for key in ("joint", "node", "serial"):
            values = [(wide, v) for s in self.servos if (v := getattr(s, key)) is not None
                      for wide in [key == "node" and (s.protocol or self.protocol) == "robstride"]]  # fmt: skip
            twice = sorted({str(v) for _, v in values if values.count((_, v)) > 1})
            if twice:
                raise ValueError(f"{key} {', '.join(twice)} appears twice in servos; each drive has its own")
        return self

    @property
    def protocols(self) -> str:
        """The protocols on this bus, joined for use in a sentence."""
        return " and ".join(sorted({s.protocol or self.protocol or "" for s in self.servos}))


def can_options(cell: Cell, arm: Arm) -> CanOptions:
    """Checked options of a cell, with the servos in joint order; ConfigError names what is missing or unknown."""
    if "assume" in cell.table.options:
        raise ConfigError(f"{cell.path}: assume is in [options]; it belongs at the top of the cell file")
    options = validated(CanOptions, {**cell.table.options, "assume": cell.table.assume}, cell.path)
    by_joint = {s.joint: s for s in options.servos}
    for name in by_joint:
        if name not in arm.joint_names:
            raise ConfigError(f"{cell.path}: options.servos names {name!r}; {nearest(name, arm.joint_names)}")
    missing = [name for name in arm.joint_names if name not in by_joint]
    if missing:
        raise ConfigError(
            f"{cell.path}: options.servos has no drive for {', '.join(missing)}; add one for each joint of {arm.name}"
        )
    whole = {name: _whole(by_joint[name], options, cell) for name in arm.joint_names}
    return options.model_copy(update={"servos": list(whole.values())})


NEEDS: dict[ProtocolName, tuple[str, ...]] = {
    "damiao": ("feedback",), "cubemars": ("feedback", "ranges"), "robstride": ("ranges",), "odrive": (),
}  # fmt: skip


def _whole(servo: ServoTable, options: CanOptions, cell: Cell) -> ServoTable:
    """A servo with the bus's protocol and frame format filled in; ConfigError for a missing key or an unsupported setting."""
    where, protocol = f"{cell.path}: servo of {servo.joint}", servo.protocol or options.protocol
    if protocol is None:
        raise ConfigError(f"{where} has no protocol; write protocol = one of {', '.join(NEEDS)} to it or to [options]")
    for key in NEEDS[protocol]:
        if getattr(servo, key) is None:
            raise ConfigError(f"{where} has no {key}; a {protocol} drive needs it")
    if protocol != "odrive" and not (servo.kp > 0 and servo.kd > 0):
        raise ConfigError(f"{where} needs kp and kd above zero; without them its joint falls")
    fd = protocol == "damiao" and options.data_bitrate is not None if servo.fd is None else servo.fd
    if fd and (protocol != "damiao" or options.data_bitrate is None):
        raise ConfigError(
            f"{where} has fd = true; that needs data_bitrate in [options] and a damiao drive, but this one is {protocol}"
        )
    return servo.model_copy(update={"protocol": protocol, "fd": fd})


def pose(values: list[float] | None, arm: Arm, what: str, cell: Cell) -> list[float]:
    """A pose of the cell file, (n,) rad; ConfigError if it is missing, not finite, or of the wrong length."""
    if values is None or len(values) != arm.n or not all(math.isfinite(v) for v in values):
        raise ConfigError(f"{cell.path}: {what} needs {arm.n} angles in rad, one for each joint of {arm.name}")
    return list(values)
