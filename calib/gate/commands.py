"""The gate as commands ask it: refused with its sentence, or the logs as they are to be read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from calib.gate.correction import AS_RECORDED
from calib.gate.gate import gate
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.errors import BadLog, ConfigError
from sim.resources import config_folders


def passed(arm: Arm, assume: Sequence[str], configs: Path | None = None) -> Callable[[Log], Log]:
    """A function of a log: itself where it is the arm's, the log read as `assume` says; BadLog with the likely causes where it is not."""

    def change(log: Log) -> Log:
        ordered = _ordered(log, arm)
        found = gate(arm, [ordered], assume, lambda: family(configs))
        if found.refusal is not None:
            raise BadLog(f"{log.path or 'log'}: {found.refusal}; or take it as it is with --assume {AS_RECORDED}")
        return found.logs[0] if any(word != AS_RECORDED for word in assume) else log

    return change


def family(configs: Path | None) -> list[Arm]:
    """Every arm of configs/arms that can be read: what a recording may be of instead."""
    names = sorted({file.parent.name for folder in config_folders(configs, "arms") for file in folder.glob("*/arm.toml")})
    out = []
    for name in names:
        try:
            out.append(load_arm(name, configs))
        except ConfigError:  # an arm that is being written is no reason to refuse another one's recording
            continue
    return out


def _ordered(log: Log, arm: Arm) -> Log:
    """The log's columns in the arm's order, without joints that the arm does not have; as it is where joints are missing."""
    if tuple(log.joint_names) == arm.joint_names or not set(arm.joint_names) <= set(log.joint_names):
        return log
    columns = [log.joint_names.index(name) for name in arm.joint_names]
    names = ("q", "dq", "tau", "current", "temperature", "q_cmd", "dq_cmd", "tau_cmd")
    return replace(log, joint_names=arm.joint_names, **{name: getattr(log, name)[:, columns] for name in names})
