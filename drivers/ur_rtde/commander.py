"""The command process: ur_rtde's control interface, alone in a process that may hang or crash without harm.

Run by path, with the fd of a SOCK_SEQPACKET socket; imports nothing of this project. Messages in: Q setpoint, S stop, X end.
Messages out: K ready, A setpoint was taken, T stopped because no setpoint came, S stopped, E error.
Where it ends, however it ends, nobody writes the watched register, and the controller ends the program within its watchdog.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import socket
import struct
import sys
import time
from typing import Any

SETPOINT = struct.Struct("<Q12d")
NUMBER = struct.Struct("<Q")
KICKS_PER_WATCHDOG = 4
PHASE_TIMEOUT = 2.0  # s for the controller to notice that the uploading client is gone


class Lost(Exception):
    """A command was not taken; the message says which."""


class Commander:
    """Streams setpoints and, where they end, brings the target to rest."""

    def __init__(self, control: Any, channel: socket.socket, settings: dict[str, float]) -> None:
        self.control, self.channel = control, channel
        self.period, self.lookahead, self.gain = settings["period"], settings["lookahead"], settings["gain"]
        self.deceleration, self.patience = settings["stop_deceleration"], settings["setpoint_timeout"]
        self.kick = 1.0 / settings["watchdog"] / KICKS_PER_WATCHDOG
        self.target: tuple[list[float], list[float]] | None = None

    def run(self) -> None:
        """Until the channel closes or an end is asked for: take setpoints, keep the watchdog fed between motions."""
        last = time.monotonic()
        while True:
            wait = self.patience if self.target else self.kick
            ready, _, _ = select.select([self.channel], [], [], max(0.0, last + wait - time.monotonic()))
            if not ready:
                if self.target:
                    self.rest()
                    self.channel.send(b"T")
                elif not self.control.kickWatchdog():
                    raise Lost("kickWatchdog")
                last = time.monotonic()
                continue
            messages = self.waiting()
            setpoint = next((m for m in reversed(messages) if m[:1] == b"Q"), None)
            order = next((m for m in messages if m[:1] in (b"S", b"X", b"")), None)
            if setpoint is not None and order is None:
                self.follow(setpoint)
                last = time.monotonic()
            if order is not None:
                self.rest()
                if order[:1] != b"S":
                    return
                self.channel.send(b"S")
                last = time.monotonic()

    def waiting(self) -> list[bytes]:
        """All messages that have come; an empty one where the other end is gone."""
        messages = [self.channel.recv(256)]
        while messages[-1] and select.select([self.channel], [], [], 0.0)[0]:
            messages.append(self.channel.recv(256))
        return messages

    def follow(self, message: bytes) -> None:
        number, *values = SETPOINT.unpack(message[1:])
        self.target = (values[:6], values[6:])
        self.servo(values[:6])
        self.channel.send(b"A" + NUMBER.pack(number))

    def servo(self, q: list[float]) -> None:
        if not self.control.servoJ(q, 0.0, 0.0, self.period, self.lookahead, self.gain):
            raise Lost("servoJ")

    def rest(self) -> None:
        """Bring the target to rest along its direction, then end servo mode.

        Streamed rather than left to servoStop: its deceleration blocks, and nothing would feed the watchdog meanwhile.
        """
        if self.target is None:
            return
        q, dq = self.target
        self.target = None
        fastest = max(abs(x) for x in dq)
        unit = [x / fastest for x in dq] if fastest > 0 else dq
        due = time.monotonic()
        while fastest > 0:
            left = max(0.0, fastest - self.deceleration * self.period)
            q = [x + 0.5 * (fastest + left) * u * self.period for x, u in zip(q, unit, strict=True)]
            fastest = left
            self.servo(q)
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
        # the arm follows its target by the delay of servoj; servo mode is kept, and the watchdog fed, until it has
        for _ in range(math.ceil(3.0 * self.lookahead / self.kick)):
            self.servo(q)
            time.sleep(self.kick)
        if not self.control.servoStop(self.deceleration):
            raise Lost("servoStop")


def connected(settings: dict[str, Any]) -> Any:
    """A control interface whose program runs, and which cannot upload it a second time.

    An interface that uploads would do so again, unasked, whenever its connection breaks. So one uploads and leaves, and a second
    one, without that ability, takes over the running program.
    """
    import rtde_control

    flags = rtde_control.RTDEControlInterface.Flags
    quiet = int(flags.FLAG_NO_EXT_FT)
    open_ = rtde_control.RTDEControlInterface
    uploading = open_(settings["host"], settings["rate"], quiet | int(flags.FLAG_UPLOAD_SCRIPT))
    uploading.disconnect()
    end = time.monotonic() + PHASE_TIMEOUT
    while True:
        try:
            return open_(settings["host"], settings["rate"], quiet | int(flags.FLAG_NO_WAIT))
        except RuntimeError as error:
            # the controller may still hold the registers for the interface that just left
            if "in use" not in str(error) or time.monotonic() > end:
                raise
            time.sleep(0.05)


def main() -> None:
    settings = json.loads(sys.argv[1])
    channel = socket.socket(fileno=int(sys.argv[2]))
    try:
        if settings["priority"]:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(settings["priority"]))
        control = connected(settings)
        if not control.setWatchdog(settings["watchdog"]):
            raise Lost("setWatchdog")
        channel.send(b"K")
        Commander(control, channel, settings).run()
        control.stopScript()
    except Lost as error:
        _tell(channel, f"{error} was not taken")
    except (RuntimeError, OSError) as error:
        _tell(channel, str(error))
    # destructors of ur_rtde may throw and abort; there is nothing left that they could do
    os._exit(0)


def _tell(channel: socket.socket, sentence: str) -> None:
    # where the supervisor is gone there is nobody to tell
    with contextlib.suppress(OSError):
        channel.send(b"E" + sentence.encode()[:4000])


if __name__ == "__main__":
    main()
