"""Recorded data: recorder, reader, importers."""

from logs.log import Event, Log, State
from logs.read import read_log
from logs.recorder import COMPLETED, Recorder, Recording
from logs.recorder_process import RecorderProcess

__all__ = ["COMPLETED", "Event", "Log", "Recorder", "RecorderProcess", "Recording", "State", "read_log"]
