"""[options] of a cell with `driver = "ur_rtde"`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sim.strict import StrictTable

GAP = 0.04
SLACK = 0.02


class UrOptions(StrictTable):
    """How to reach and stream to a UR controller.

    host               name or address of the controller
    serial             its serial number, pinned at first use: `calib check` says it. A controller with another one is refused
    lookahead          s, servoj smoothing; ur_rtde accepts 0.03 to 0.2
    gain               1, servoj proportional gain; ur_rtde accepts 100 to 2000
    stop_deceleration  rad/s^2 of every joint in the driver's own stop
    watchdog           Hz; the controller ends the program where the command process is silent for longer: 10 Hz is 0.1 s
    frame_timeout      s without a reading that a motion endures, marked in the log; beyond it the motion stops. Every stop is proved to have
                       room for it. At least three periods
    setpoint_timeout   s without a command, in motion, after which the command process stops the arm by itself; frame_timeout and 20 ms
                       where it is not given
    priority           real-time (FIFO) priority of the command process, 0 for none
    robot_api_port     of PolyScope X's Robot API
    """

    host: str
    serial: str | None = None
    lookahead: Annotated[float, Field(ge=0.03, le=0.2)] = 0.1
    gain: Annotated[float, Field(ge=100, le=2000)] = 300.0
    stop_deceleration: Annotated[float, Field(ge=0.5, le=40.0)] = 4.0
    watchdog: Annotated[float, Field(ge=2.0, le=50.0)] = 10.0
    frame_timeout: Annotated[float, Field(gt=0.0, le=0.5)] = GAP
    setpoint_timeout: Annotated[float, Field(gt=0.0, le=0.5)] | None = None
    priority: Annotated[int, Field(ge=0, le=80)] = 0
    robot_api_port: Annotated[int, Field(ge=1, le=65535)] = 80

    @property
    def patience(self) -> float:
        """s without a command, in motion, after which the command process stops the arm."""
        return self.setpoint_timeout or self.frame_timeout + SLACK
