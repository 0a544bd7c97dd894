"""Errors are sentences: what, where, the value, the rule, the remedy. Each class has one exit code."""

from __future__ import annotations


class CalibError(Exception):
    """Something an operator can act on; printed as its message, without a traceback.

    `exit_code` is the command line's: 1 the answer is no, 2 usage, configuration or bad data,
    3 safety stop, 4 device.
    """

    exit_code = 2


class ConfigError(CalibError):
    """A configuration file, arm folder or command line value that breaks a rule."""


class UnknownArm(ConfigError):
    """No arm has the name that was given."""


class UnknownCell(ConfigError):
    """No cell has the name that was given."""


class BadLog(CalibError):
    """A recording that cannot be read as what it claims to be; names file, place, value, rule and remedy."""


class EmptyLog(BadLog):
    """A recording without samples, of a motion that never started; nothing in it is wrong."""


class AnswerIsNo(CalibError):
    """The question was answered, and the answer is no (a gap was found, a check failed)."""

    exit_code = 1


class SafetyStop(CalibError):
    """Motion was refused, or a motion was stopped, because a safety rule was not met."""

    exit_code = 3


class DeviceError(CalibError):
    """The device, its controller or the connection to it does not do what was requested."""

    exit_code = 4


class EndOfRecording(DeviceError):
    """A device that plays a recording has given its last sample."""
