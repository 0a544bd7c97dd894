"""The control program that ur_rtde uploads, reduced to its register protocol; one `yield` is one `sync()` of URScript.

From ur_rtde 1.6.5, scripts/rtde_control.script: commands arrive in integer register 0 and in double registers, answers leave in
integer register 0. Only joint-space motion, stops, payload and watchdog are emulated; any other command ends the program, as an
error in URScript does.
"""

from __future__ import annotations

import re
from collections.abc import Generator, Iterator
from typing import Any

import numpy as np

READY, DONE = 1, 2
REALTIME = {6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71}
MOVE_J, SPEED_J, SERVO_J, SPEED_STOP, SERVO_STOP, PAYLOAD, TRIGGER_STOP = 1, 9, 11, 15, 16, 17, 31
STOP_L, STOP_J, WATCHDOG, QUIT = 33, 34, 35, 255
JOINTS = 6


def register_offset(text: str) -> int | None:
    """Register offset of an uploaded control program; None for any other program."""
    found = re.search(r"reg_offset_int = # int register offset\n\s*(\d+)", text)
    return int(found.group(1)) if found and text.lstrip().startswith("def ") else None


def control_program(robot: Any, offset: int) -> Iterator[None]:
    """Main loop of the control program; it ends on command QUIT or on an unknown command."""
    executing = False
    progress = _Progress(robot, offset)
    progress.finished()
    robot.output_int[offset] = READY
    while True:
        command = robot.input_int[offset]
        if command == QUIT:
            return
        if command in REALTIME:
            if not _realtime(robot, command, offset):
                return
            robot.output_int[offset] = READY
        elif command == 0:
            executing = False
            robot.output_int[offset] = READY
        elif not executing:
            known = yield from _blocking(robot, command, offset, progress)
            if not known:
                return
            robot.output_int[offset] = DONE
            executing = True
        yield


def _realtime(robot: Any, command: int, offset: int) -> bool:
    d = robot.input_double[offset:]
    if command == SERVO_J:
        robot.motion.servo(np.array(d[:JOINTS]), d[9], d[10])
    elif command == SPEED_J:
        robot.motion.speed(np.array(d[:JOINTS]), d[6])
    else:
        robot.note(f"the control program received command {command}, which is not emulated")
        return False
    return True


def _blocking(robot: Any, command: int, offset: int, progress: _Progress) -> Generator[None, None, bool]:
    d = robot.input_double[offset:]
    if command == MOVE_J:
        there = robot.motion.move(np.array(d[:JOINTS]), d[6], d[7], lambda: robot.speed_slider)
        if robot.input_int[offset + 1] == 1:
            progress.started()
            robot.background = progress.until(there)
        else:
            while not there():
                yield
    elif command in (SPEED_STOP, SERVO_STOP, STOP_L, STOP_J):
        robot.background = None
        robot.motion.stop(d[0])
        while not robot.motion.standing:
            yield
        progress.finished()
    elif command == PAYLOAD:
        robot.payload, robot.payload_cog = d[0], list(d[1:4])
    elif command == TRIGGER_STOP:
        robot.protective_stop()
    elif command == WATCHDOG:
        robot.watch(f"input_int_register_{offset}", d[0])
    else:
        robot.note(f"the control program received command {command}, which is not emulated")
        return False
    return True


class _Progress:
    """Word in output integer register 2: operation count in bits 24-30, write count in bits 16-22, running in bit 15."""

    def __init__(self, robot: Any, offset: int) -> None:
        self._robot, self._index = robot, offset + 2
        self._writes = self._operation = 0

    def started(self) -> None:
        self._operation = (self._operation + 1) % 128
        self._write(0x8000)

    def finished(self) -> None:
        self._write(0)

    def until(self, there: Any) -> Iterator[None]:
        while not there():
            yield
        self.finished()

    def _write(self, low: int) -> None:
        self._writes = (self._writes + 1) % 128
        self._robot.output_int[self._index] = self._operation << 24 | self._writes << 16 | low
