"""The gate as commands call it: BadLog with the likely cause first, or the logs as they should be read."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from calib.gate.check import LIKELIEST, GateCheck
from calib.gate.copies import TWICE
from calib.gate.correction import AS_RECORDED, ASSUMED, applied, assumed, parsed
from calib.gate.gate import Gate, gate
from calib.gate.readings import motion, name_of
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.errors import BadLog, ConfigError
from sim.resources import config_folders

_OPTIONS = re.compile(r"--assume \S+?(?: --assume \S+?)*(?=[.;,]?(?:\s|$))")
_IMPORT = "calib import "
LEAST_MOTION, LEAST_OF_ONE = 5.0, 2.0  # s of motion for a diagnosis: in all fitted recordings together, and in each


def passed(arm: Arm, assume: Sequence[str], configs: Path | None = None) -> Callable[[Log], Log]:
    """A function that returns a log of the arm, read as `assume` states; it raises BadLog with the likely causes where the log is not the arm's."""

    others = _shipped if configs is None else partial(family, configs)

    def change(log: Log) -> Log:
        ordered = _ordered(log, arm)
        read = read_as(ordered, assume)
        found = gate(arm, [read], family=others)
        if found.refusal is not None:
            raise BadLog(_message(found.refusal, log, _lifts(found)))
        return read if assume else log

    return change


def read_as(log: Log, assume: Sequence[str]) -> Log:
    """The log read as the words state, one after the other, recorded in its metadata; ConfigError for an invalid word."""
    for c in [parsed(word, log.joint_names) for word in assume if word != AS_RECORDED]:
        log = applied(log, c)
    if AS_RECORDED in assume:
        log = replace(log, metadata={**log.metadata, ASSUMED: json.dumps([*assumed(log), AS_RECORDED], ensure_ascii=False)})
    return log


def require(arm: Arm, logs: Sequence[Log]) -> None:
    """Raise BadLog where one of the logs cannot be a recording of the arm."""
    _, refusal = examined(arm, logs)
    if refusal is not None:
        raise BadLog(refusal)


def examined(arm: Arm, logs: Sequence[Log], fitted: Sequence[Log] = ()) -> tuple[tuple[GateCheck, ...], str | None]:
    """The checks of every log alone, so that good ones cannot hide a bad one, and of all together; and why they are refused, or None.

    The checks end with those of the first refused log. fitted: the logs that a diagnosis fits, which must contain motion.
    """
    checks: list[GateCheck] = []
    for log in logs:
        alone = len(fitted) == 1 and log is fitted[0]
        found = gate(arm, [log], family=_shipped, least_motion=LEAST_MOTION if alone else LEAST_OF_ONE if fitted else 0.0)
        checks += found.checks
        if found.refusal is not None:
            return tuple(checks), _message(found.refusal, log, _lifts(found))
    if len(logs) > 1:
        found = gate(arm, logs)
        checks += [check for check in found.checks if check.of_all or not check.ok]
        if found.refusal is not None:
            return tuple(checks), _message(found.refusal, unchanged=_lifts(found))
    if len(fitted) > 1:
        together = motion(fitted, LEAST_MOTION)
        checks.append(together)
        if not together.ok and not all(AS_RECORDED in assumed(log) for log in fitted):
            return tuple(checks), _message(f"{together.detail}. {LIKELIEST}{together.causes[0].sentence}")
    return tuple(checks), None


def _lifts(found: Gate) -> bool:
    """Whether reading the recording as it is would help."""
    return not any(check.final or (check.check == TWICE and not check.ok) for check in found.checks)


def _message(refusal: str, log: Log | None = None, unchanged: bool = True) -> str:
    """The refusal of a log, or of several together; unchanged: whether to name reading as recorded as a remedy."""
    name = "these recordings" if log is None else str(log.path or "log")
    own = "" if log is None else f"{name_of(log)}: "  # checks of the readings alone begin with it
    text = f"{name}: {refusal.removeprefix(own)}"
    return f"{text}. To use it unchanged: --assume {AS_RECORDED}" if unchanged else text


def by_import(sentence: str, arm: str, file: str = "LOG") -> str:
    """A sentence of the gate for a command without `--assume`: it advises `calib import` of the recording `file` instead.

    A sentence that advises no `--assume`, or has this advice already, stays as it is.
    """
    command = f"{_IMPORT}{shlex.quote(file)} --arm {arm}"
    found = sentence if _IMPORT in sentence else _OPTIONS.sub(lambda words: f"`{command} {words.group()}`", sentence)
    return sentence if found == sentence else f"{found}; then replace the recording with the file that it writes"


@cache
def family(configs: Path | None) -> tuple[Arm, ...]:
    """Every readable arm of configs/arms: those that a recording may be of instead."""
    names = sorted({file.parent.name for folder in config_folders(configs, "arms") for file in folder.glob("*/arm.toml")})
    out = []
    for name in names:
        try:
            out.append(load_arm(name, configs))
        except ConfigError:  # an unfinished arm folder must not refuse the recording of another arm
            continue
    return tuple(out)


def _shipped() -> tuple[Arm, ...]:
    return family(None)


def _ordered(log: Log, arm: Arm) -> Log:
    """The log with its columns in the arm's order, without joints that the arm does not have; unchanged where joints are missing."""
    if tuple(log.joint_names) == arm.joint_names or not set(arm.joint_names) <= set(log.joint_names):
        return log
    return log.with_joints(arm.joint_names)
