"""[options] of a cell with `driver = "ur_rtde"`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from sim.strict import StrictTable

GAP = 0.04
SLACK = 0.02
BEHIND = 0.1  # s by which an arm may lag its commands while its path is monitored (safety.sudden.LATE)
WAY = 0.01  # s that a command and the reading of its result are in transit (measured against the emulated controller: 8 ms)
DELAY_GAIN = 4.8  # delay of servoj, s: lookahead + 4.8 / gain (issue 86 of Universal Robots' client library)


class UrOptions(StrictTable):
    """How to reach and stream to a UR controller.

    host               name or address of the controller
    serial             its serial number, pinned at first use: `calib check` reports it. A controller with another one is refused
    safety_checksum    number of its safety configuration, as `calib check` reports it; if given, a controller with another one is refused
    lookahead          s, servoj smoothing; ur_rtde accepts 0.03 to 0.2
    gain               1, servoj proportional gain; ur_rtde accepts 100 to 2000
    stop_deceleration  rad/s^2 of every joint in the driver's own stop
    watchdog           Hz; the controller ends the program if the command process is silent for longer than a period: 10 Hz is 0.1 s
    frame_timeout      s that a motion continues without a reading, marked in the log; after that the motion stops. Every stop is verified to
                       have room for it. At least three periods
    setpoint_timeout   s without a command, in motion, after which the command process stops the arm by itself; if not given, frame_timeout
                       (or ahead, if longer) and 20 ms
    ahead              s of motion that a program of our own on the controller holds and plays by its own clock, so that this computer may be
                       late by as much; 0 streams each command through ur_rtde. ahead + lookahead + 4.8/gain + WAY is at most BEHIND. Never
                       tried on a real robot
    priority           real-time (FIFO) priority of the command process, 0 for none
    robot_api_port     of PolyScope X's Robot API
    """

    host: str
    serial: str | None = None
    safety_checksum: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None
    lookahead: Annotated[float, Field(ge=0.03, le=0.2)] = 0.1
    gain: Annotated[float, Field(ge=100, le=2000)] = 300.0
    stop_deceleration: Annotated[float, Field(ge=0.5, le=40.0)] = 4.0
    watchdog: Annotated[float, Field(ge=2.0, le=50.0)] = 10.0
    frame_timeout: Annotated[float, Field(gt=0.0, le=0.5)] = GAP
    setpoint_timeout: Annotated[float, Field(gt=0.0, le=0.5)] | None = None
    ahead: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0
    priority: Annotated[int, Field(ge=0, le=80)] = 0
    robot_api_port: Annotated[int, Field(ge=1, le=65535)] = 80

    @model_validator(mode="after")
    def _not_too_far_behind(self) -> UrOptions:
        behind = self.ahead + WAY + self.lookahead + DELAY_GAIN / self.gain
        if self.ahead and behind > BEHIND:
            raise ValueError(
                f"ahead = {self.ahead:g} with lookahead = {self.lookahead:g} and gain = {self.gain:g} puts the arm {behind:.3f} s behind its commands; at "
                f"most {BEHIND:g} s are allowed: commands that are played on time need no smoothing, so set lookahead = 0.03 and gain = 1200"
            )
        return self

    @property
    def patience(self) -> float:
        """s without a command, in motion, after which the command process stops the arm."""
        return self.setpoint_timeout or max(self.frame_timeout, self.ahead) + SLACK
