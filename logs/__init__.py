"""Recorded data: recorder, reader, importers."""

from logs.log import Event, Log, State
from logs.pieces import Pieces, open_pieces
from logs.read import is_log, read_log
from logs.recorder import Recorder
from logs.recorder_process import RecorderProcess
from logs.recording import COMPLETED, Recording

__all__ = [
    "COMPLETED",
    "Event",
    "Log",
    "Pieces",
    "Recorder",
    "RecorderProcess",
    "Recording",
    "State",
    "is_log",
    "open_pieces",
    "read_log",
]
