"""The last check of a controller before control is taken, and the wait until our program runs."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

from drivers.ur_rtde.condition import FULL_SPEED, SCALING, other_program
from drivers.ur_rtde.dashboard import controller_info
from drivers.ur_rtde.frames_in_order import FramesInOrder
from drivers.ur_rtde.options import UrOptions
from drivers.ur_rtde.receiver import Frame
from sim.errors import DeviceError
from sim.joint_state import Status

START_TIME = 2.0  # s for the frames to show the program running at full speed: they lag behind the command connection


def require_no_program(frames: FramesInOrder, host: str) -> None:
    """The last check before control is taken: DeviceError if a program has started meanwhile, which is left alone."""
    status, sentence, remedy = other_program(int(frames.newest().values["runtime_state"][0]))
    if status is not Status.RUNNING:
        raise DeviceError(f"{host}: {sentence}; it began just now; {remedy}")


def overtaken(options: UrOptions, version: tuple[int, ...]) -> DeviceError | None:
    """Error that names another client's program, which ended ours before ours took a command; None if none is reported."""
    name = controller_info(options.host, version, options.robot_api_port).program
    if not name:
        return None
    return DeviceError(f"{options.host}: the program {name} began in the same moment, and plays; end it, then try again")


def await_program(
    frames: FramesInOrder, host: str, assumed: Collection[str], condition: Callable[[Frame], tuple[Status, str]]
) -> None:
    """Wait until the frames show our program running, at full speed unless `assumed` waives it; DeviceError after START_TIME."""
    end = time.monotonic() + START_TIME
    while True:
        values = frames.next().values
        runs = bool(int(values["robot_status_bits"][0]) >> 1 & 1)
        if runs and (values["speed_scaling"][0] >= FULL_SPEED or SCALING in assumed):
            return
        if time.monotonic() > end:
            status, detail = condition(frames.next())
            if status is Status.RUNNING:
                detail = "the control program does not run; see what the pendant says"
            raise DeviceError(f"{host}: {detail}")
