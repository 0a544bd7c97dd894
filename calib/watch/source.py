"""Sources of readings: a cell that another program moves, or a log. A watcher treats both alike."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from calib.gate.commands import read_as, require
from calib.gate.correction import AS_RECORDED
from calib.terminal.recordings import recorded_arm
from calib.terminal.recordings import require as require_file
from calib.watch.picture import Declared
from calib.watch.recorded import digest_of, instant_of
from drivers import open_driver
from logs import is_log, read_log
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.cell import load_cell
from sim.errors import BadLog, ConfigError, EndOfRecording, UnknownCell
from sim.finite import is_finite
from sim.joint_state import JointState


@dataclass(frozen=True)
class Source:
    """Readings of an arm: `states` yields each once, in order; `declared_now` returns the payload that is declared at that time.

    duration s is known for a log; gravity (3,) m/s^2 where the device or log states its mounting; t_origin s is the instant on the
    device clock at which the readings' own time is zero; facts go into the record; gated: the readings have not passed the gate yet.
    recording: a log's digest; recorded: when it was made, None where it does not state that.
    """

    name: str
    arm: Arm
    rate: float
    states: Iterator[JointState]
    declared_now: Callable[[], Declared | None]
    gravity: np.ndarray | None = None
    duration: float | None = None
    live: bool = False
    gated: bool = False
    t_origin: float = 0.0
    findings: tuple[str, ...] = ()
    facts: dict[str, Any] = field(default_factory=dict)
    recording: str = ""
    recorded: datetime | None = None


@contextmanager
def open_source(
    reference: str,
    arm: str | None = None,
    configs: Path | None = None,
    accept_partial: bool = False,
    assume: Sequence[str] = (),
) -> Iterator[Source]:
    """A log, or a cell by its name or file; `arm`, for example the calibrated one, replaces the arm that they name.

    assume: words of `calib.gate.correction` that state how to read a log; for a cell, which its driver reads, only `as-recorded`.
    """
    if is_log(reference):
        yield from_log(Path(reference), arm, configs, accept_partial, assume)
        return
    foreign = [word for word in assume if word != AS_RECORDED]
    if foreign:
        raise ConfigError(
            f"--assume {foreign[0]}: is for recordings; {reference} is read by its driver: correct the cell file or the arm; "
            f"--assume {AS_RECORDED} watches it unchecked"
        )
    try:
        cell = load_cell(reference, configs)
    except UnknownCell as error:
        if not os.path.isdir(reference):
            raise
        raise ConfigError(
            f"{reference}: this folder holds no recording; give a recording, a folder that is one, or a cell"
        ) from error
    model = load_arm(arm or cell.table.arm, configs)
    driver = open_driver(cell, model)
    info = driver.listen()
    try:
        table = cell.table.payload

        def declared_now() -> Declared | None:
            declared = driver.declared_payload()
            if declared is not None:
                return Declared(declared[0], declared[1], "the controller")
            return None if table is None else Declared(table.mass, (table.com[0], table.com[1], table.com[2]), "the cell file")

        def states() -> Iterator[JointState]:
            with suppress(EndOfRecording):
                while True:
                    yield driver.read()

        yield Source(
            cell.name, model, driver.rate, states(), declared_now, None if info.gravity is None else np.array(info.gravity), live=True, gated=not assume,
            facts={"cell": cell.name, "device": info.model, "serial": info.serial, "firmware": info.firmware,
                   "assumed": ", ".join(cell.assumed)},
            findings=tuple(f"assumes {name}: {sentence}" for name, sentence in cell.assumed.items()),
        )  # fmt: skip
    finally:
        driver.close()


def from_log(
    path: Path, arm: str | None = None, configs: Path | None = None, accept_partial: bool = False, assume: Sequence[str] = ()
) -> Source:  # fmt: skip
    """Readings of a log, for `arm` or else the arm that the log names; BadLog where they cannot be that arm's."""
    require_file(path)
    about = read_log(path, accept_partial=accept_partial)
    arm_of_log = about.metadata.get("arm")
    if not (arm or arm_of_log):
        raise ConfigError(f"{path}: does not state which arm it is of; name it with --arm")
    model = load_arm(arm, configs) if arm else recorded_arm(path, configs)
    if arm_of_log and model.name != arm_of_log:
        raise BadLog(
            f"{path}: is a recording of {arm_of_log}, the arm given is {model.name}: it would show nothing about this arm; "
            "leave --arm out, or name an arm folder of that arm"
        )
    read = read_log(path, model.joint_names, accept_partial=accept_partial)
    log = read_as(read, assume)
    if len(log) < 2:
        raise BadLog(f"{path}: {len(log)} samples; there is nothing to watch")
    silent = ~np.isfinite(log.tau).any(axis=0)
    if silent.any() and (model.torque_constant is None or not np.isfinite(log.current[:, silent]).any(axis=0).all()):
        names = ", ".join(j for j, s in zip(model.joint_names, silent, strict=True) if s)
        raise ConfigError(
            f"{path}: no torque of {names}, and no current with a torque constant of {model.name} to compute one; write torque_constant "
            "into its arm.toml, or record effort"
        )
    steps = np.diff(log.t)
    if not (steps > 0).any():
        raise BadLog(f"{path}: every sample has the same time; there is nothing to watch")
    declared, gravity = _declared(log), _mounting(log)
    require(model if gravity is None else replace(model, tree=replace(model.tree, gravity=gravity)), [log])
    return Source(
        path.name, model, 1.0 / float(np.median(steps[steps > 0])), states_of(log), lambda: declared,
        gravity, float(log.t[-1] - log.t[0]), findings=log.findings, t_origin=1e-9 * log.t_origin,
        facts={"log": str(path), **{key: read.metadata.get(key, "") for key in ("cell", "serial")}}, recording=digest_of(read), recorded=instant_of(read),
    )  # fmt: skip


def states_of(log: Log) -> Iterator[JointState]:
    """The samples of a recording, one after the other."""
    for k in range(len(log)):
        yield JointState(float(log.t[k]), float(log.t[k]), log.q[k], log.dq[k], log.tau[k], log.current[k], log.temperature[k])


def _mounting(log: Log) -> np.ndarray | None:
    """(3,) m/s^2, gravity in the base frame as the recording states it; None where it does not."""
    text = log.metadata.get("mounting")
    if text is None:
        return None
    try:
        gravity = np.array([float(x) for x in json.loads(text)])
    except (ValueError, TypeError, RecursionError) as error:
        raise BadLog(f"{log.path}: mounting = {text[:80]!r} is not a gravity vector ({error}); correct its metadata") from error
    if not is_finite(gravity, 3):
        raise BadLog(f"{log.path}: mounting = {text[:80]!r} is not three finite numbers, m/s^2; correct its metadata")
    return gravity


def _declared(log: Log) -> Declared | None:
    """The payload that the device, else the cell file, declared while the log was recorded."""
    about = log.metadata
    try:
        if "device_payload_mass" in about:
            return _of_numbers(
                about["device_payload_mass"], json.loads(about.get("device_payload_com", "[0, 0, 0]")), "the controller"
            )
        if "payload" in about:
            table = json.loads(about["payload"])
            return _of_numbers(table["mass"], table["com"], "the cell file")
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BadLog(f"{log.path}: its metadata about the payload cannot be read ({error}); correct its metadata") from error
    return None


def _of_numbers(mass: object, com: Sequence[object], by: str) -> Declared:
    m, x, y, z = (float(str(value)) for value in (mass, *com))
    if not np.isfinite([m, x, y, z]).all():
        raise ValueError(f"{m:g} kg at {x:g}, {y:g}, {z:g} m are not four finite numbers")
    return Declared(m, (x, y, z), by)


def until(states: Iterator[JointState], seconds: float | None) -> Iterator[JointState]:
    """The readings of the first `seconds` on the device's clock; all of them where None."""
    first: float | None = None
    for state in states:
        if first is None and np.isfinite(state.t_device):
            first = state.t_device
        yield state
        if seconds is not None and first is not None and state.t_device - first >= seconds:
            return
