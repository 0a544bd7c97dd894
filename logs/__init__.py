"""Recorded data: recorder, reader, importers."""

from logs.log import Event, Log, State
from logs.read import read_log
from logs.recorder import Recorder

__all__ = ["Event", "Log", "State", "read_log", "Recorder"]
