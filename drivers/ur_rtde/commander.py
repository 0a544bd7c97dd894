"""The command process: ur_rtde's control interface, alone in a process that may hang or crash without harm.

Run by path, with the fd of a SOCK_SEQPACKET socket. Imports nothing of this project but `ahead`, if setpoints are sent ahead. Messages in:
G take control, Q setpoint, S stop, X end. Messages out: R ready to take control, K control taken, A setpoint taken, T stopped because no
setpoint arrived, S stopped, E error, L the controller did not get in time what it needed.
However this process ends, nothing writes the watched register or to the program's socket any longer, and the controller ends the program.
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
from collections import deque
from typing import Any

SETPOINT = struct.Struct("<Q12d")
NUMBER = struct.Struct("<Q")
KICKS_PER_WATCHDOG = 4
SLIP = 4  # setpoints that may be sent at once after a late wake-up; the controller takes the last of them
CATCH_UP = 0.97  # periods between setpoints while more wait: 3 % faster than planned makes up for 40 ms in 1.3 s
SCRIPT_PORT = 30003
PHASE_TIMEOUT = 2.0  # s to open the port that takes programs
START_TIMEOUT = 5.0  # s for the program to start


class Lost(Exception):
    """A command was not taken; the message states which."""


class Aborted(Exception):
    """Sending has ended in motion: the controller plays what it has, then brakes."""


class Commander:
    """Streams setpoints and, when they end, brings the target to rest."""

    def __init__(self, control: Any, channel: socket.socket, settings: dict[str, float]) -> None:
        self.control, self.channel = control, channel
        self.period, self.lookahead, self.gain = settings["period"], settings["lookahead"], settings["gain"]
        self.deceleration, self.patience = settings["stop_deceleration"], settings["setpoint_timeout"]
        self.kick = 1.0 / settings["watchdog"] / KICKS_PER_WATCHDOG
        self.ahead = settings["ahead"]
        self.target: tuple[list[float], list[float]] | None = None

    def run(self) -> None:
        """Take setpoints until the channel closes or an end is requested; between them hold, and feed the watchdog.

        Setpoints that arrive late and together are sent one per period, slightly faster until none waits: never a jump to the newest.
        With `ahead` they are sent at once, because the controller itself plays one per period.
        """
        last = due = time.monotonic()
        late: deque[bytes] = deque()
        while True:
            now = time.monotonic()
            left = due - now if late else last + self.patience_now - now if self.target else self.kick
            ready, _, _ = select.select([self.channel], [], [], max(0.0, min(self.kick, left)))
            if ready:
                messages = self.waiting()
                order = next((m for m in messages if m[:1] in (b"S", b"X", b"")), None)
                if order is not None:
                    late.clear()
                    self.rest()
                    if order[:1] != b"S":
                        return
                    send_to_parent(self.channel, b"S")
                    continue
                late.extend(m for m in messages if m[:1] == b"Q")
                last = time.monotonic()
            if late:
                if not self.ahead and len(late) * self.period > self.patience:
                    raise Lost(f"a setpoint, {1e3 * len(late) * self.period:.0f} ms late,")
                while self.ahead and late:
                    self.follow(late.popleft())
                if late and (now := time.monotonic()) >= due:
                    self.follow(late.popleft())
                    due = max(due, now - SLIP * self.period) + CATCH_UP * self.period
            elif not ready:
                self.hold(last)

    @property
    def patience_now(self) -> float:
        """s without a setpoint after which the target is brought to rest; with `ahead`, at rest, before the controller runs out."""
        return 0.5 * self.ahead if self.ahead and self.target and not any(self.target[1]) else self.patience

    def hold(self, last: float) -> None:
        """Nothing has come since `last`: keep the last target, and after `patience_now` bring it to rest."""
        if self.target is None:
            if not self.control.kickWatchdog():
                raise Lost("kickWatchdog")
        elif time.monotonic() - last < self.patience_now:
            if self.ahead:
                self.control.look()
            else:
                self.servo(self.target[0])
        else:
            # if the last setpoint was at rest, the motion is over and nothing was missed
            moving = any(self.target[1])
            if self.ahead:
                self.control.look()  # the controller's own report takes precedence
            try:
                self.rest()
            finally:
                if moving:
                    send_to_parent(self.channel, b"T")

    def waiting(self) -> list[bytes]:
        """All messages that have arrived; the last is empty if the other end is gone."""
        messages = [_received(self.channel)]
        while messages[-1] and select.select([self.channel], [], [], 0.0)[0]:
            messages.append(_received(self.channel))
        return messages

    def follow(self, message: bytes) -> None:
        number, *values = SETPOINT.unpack(message[1:])
        self.target = (values[:6], values[6:])
        self.servo(values[:6])
        send_to_parent(self.channel, b"A" + NUMBER.pack(number))

    def servo(self, q: list[float]) -> None:
        if not self.control.servoJ(q, 0.0, 0.0, self.period, self.lookahead, self.gain):
            raise Lost("servoJ")

    def rest(self) -> None:
        """Bring every joint of the target to rest with the same deceleration, then end servo mode.

        Streamed rather than left to servoStop, which blocks: nothing would feed the watchdog meanwhile. With `ahead`, in motion: Aborted.
        """
        if self.target is None:
            return
        q, dq = self.target
        self.target = None
        if self.ahead and any(dq):
            self.control.abort()
            raise Aborted
        due = time.monotonic()
        while any(dq):
            slower = [math.copysign(max(0.0, abs(v) - self.deceleration * self.period), v) for v in dq]
            q = [x + 0.5 * (v + w) * self.period for x, v, w in zip(q, dq, slower, strict=True)]
            dq = slower
            self.servo(q)
            due += self.period
            time.sleep(max(0.0, due - time.monotonic()))
        # the arm lags its target by the delay of servoj: servo mode is kept and the watchdog fed until it has caught up
        for _ in range(0 if self.ahead else math.ceil(3.0 * self.lookahead / self.kick)):
            self.servo(q)
            time.sleep(self.kick)
        if not self.control.servoStop(self.deceleration):
            raise Lost("servoStop")


def control_program(major: int, minor: int) -> bytes:
    """ur_rtde's own control program for a controller of this version, as ur_rtde would upload it (verified against what it sends).

    ur_rtde uploads in the same call that opens its registers, and ends any playing program without asking. Sent from here, nothing comes
    between the last check of the controller and the upload.
    """
    import script_client

    text = script_client.ScriptClient("", major, minor).getScript()
    for kind in ("float", "int"):
        text = text.replace(f"# {kind} register offset\n", f"# {kind} register offset\n0", 1)
    return f"def rtde_control():\n{text}end\n".encode()


def took_control(settings: dict[str, Any], channel: socket.socket) -> Any:
    """A control interface whose program runs; None if the supervisor did not allow it.

    The registers are claimed first, which fails without harm if another client has them. Then the supervisor is asked, and the program
    is sent at once. The interface itself never uploads: it would do so again, unasked, whenever its connection breaks.
    """
    if settings["ahead"]:
        sys.path.append(os.path.dirname(os.path.abspath(__file__)))  # run by path with -P, which leaves it out
        from ahead import Upload  # type: ignore[import-not-found]

        upload = Upload(settings, settings["host"])
        send_to_parent(channel, b"R")
        if _received(channel) != b"G":
            return None
        sent_ahead = upload.start()
        if sent_ahead is None:
            raise RuntimeError("the control program did not connect back to this computer")
        return sent_ahead
    import rtde_control

    flags = rtde_control.RTDEControlInterface.Flags
    control = rtde_control.RTDEControlInterface(
        settings["host"], settings["rate"], int(flags.FLAG_NO_EXT_FT) | int(flags.FLAG_NO_WAIT)
    )
    program = control_program(*settings["version"])
    with socket.create_connection((settings["host"], SCRIPT_PORT), timeout=PHASE_TIMEOUT) as script:
        send_to_parent(channel, b"R")
        if _received(channel) != b"G":
            return None
        script.sendall(program)
        end = time.monotonic() + START_TIMEOUT
        while not control.isProgramRunning():
            if time.monotonic() > end:
                raise Lost("start control script")
            time.sleep(0.002)
    return control


def main() -> None:
    settings = json.loads(sys.argv[1])
    channel = socket.socket(fileno=int(sys.argv[2]))
    try:
        if settings["priority"]:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(settings["priority"]))
        control = took_control(settings, channel)
        if control is None:
            os._exit(0)
        if not control.setWatchdog(settings["watchdog"]):
            raise Lost("setWatchdog")
        send_to_parent(channel, b"K")
        Commander(control, channel, settings).run()
        control.stopScript()
    except Aborted:
        send_to_parent(channel, b"S")
        _ = _received(channel)  # until the supervisor has closed it
    except Lost as error:
        send_to_parent(channel, b"E" + f"{error} was not taken".encode())
    except (RuntimeError, OSError) as error:
        send_to_parent(channel, (b"L" if getattr(error, "own", False) else b"E") + str(error).encode()[:4000])
    # destructors of ur_rtde may throw and abort; nothing is left for them to do
    os._exit(0)


def send_to_parent(channel: socket.socket, message: bytes) -> None:
    """Send a message to the supervisor without waiting: one that is gone or stopped must not delay the arm's stop."""
    with contextlib.suppress(OSError):
        channel.send(message, socket.MSG_DONTWAIT)


def _received(channel: socket.socket) -> bytes:
    """One message; empty if the supervisor is gone."""
    try:
        return channel.recv(256)
    except ConnectionResetError:
        return b""


if __name__ == "__main__":
    main()
