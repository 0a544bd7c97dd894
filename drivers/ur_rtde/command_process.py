"""The supervisor's end of the command process: start it, stream to it, notice when it fails, kill it within bounded time."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from drivers.ur_rtde.commander import NUMBER, SETPOINT
from drivers.ur_rtde.options import UrOptions
from sim.errors import DeviceError

START_TIMEOUT = 15.0  # s for the process to start on a busy computer
TAKE_TIMEOUT = 8.0  # s; 5 s of these are the wait for the program
END_TIMEOUT = 3.0  # s; the longest stop of a UR joint at the lowest useful deceleration, and the end of its program
UNTAKEN = 0.25  # s that the newest setpoint may wait to be taken by the command process

REMEDIES = (
    ("already in use", "a fieldbus or another RTDE client owns the registers: on the pendant, switch EtherNet/IP, PROFINET and every "
     "MODBUS unit off in Installation > Fieldbus, and end other programs that control this robot"),
    ("remote control", "switch the pendant to Remote Control (top right corner)"),
    ("start control script", "the robot did not start the control program: see that it is on, brakes released, and in Remote Control"),
    ("Could not connect", "the controller is not reachable: see that it is on and its cable is in"),
    ("ran out of setpoints", "this computer was busy for longer than ahead: stop other work on it, set priority, or raise ahead in the cell's [options]"),
    ("setpoints wait at the controller", "the controller is busy, or its program does not run as it should: set ahead = 0 in the cell's [options] and "
     "send a capture"),
    ("connect back", "the robot must reach this computer: open its firewall for the robot's address, see that the robot is in Remote Control, or "
     "set ahead = 0 in the cell's [options]"),
    ("Operation not permitted", "this user may not use real-time priority: grant rtprio in /etc/security/limits.conf, or set priority = 0"),
)  # fmt: skip


class CommandProcess:
    """One command process from `start` to `end`. After a failure it stays failed, and a new one is started instead."""

    def __init__(self, options: UrOptions, rate: float, version: tuple[int, ...]) -> None:
        self._options, self._rate, self._version = options, rate, version
        self._channel: socket.socket | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process, closed in end()
        self._sent = self._taken = 0
        self._waiting_since: float | None = None
        self.failure: str | None = None
        self.refused = False  # whether it failed because the controller did not take a command

    @property
    def alive(self) -> bool:
        """Whether commands can be sent."""
        return self._channel is not None and self.failure is None

    def start(self) -> None:
        """Start the process, which claims the control registers and leaves the controller as it is; DeviceError with the remedy."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        options = self._options
        settings = {
            "host": options.host, "rate": self._rate, "version": self._version[:2], "period": 1.0 / self._rate,
            "lookahead": options.lookahead, "gain": options.gain, "stop_deceleration": options.stop_deceleration,
            "watchdog": options.watchdog, "setpoint_timeout": options.patience, "priority": options.priority, "ahead": options.ahead,
        }  # fmt: skip
        # run by path and with -P: the process sees the environment's packages and none of this project's
        script = Path(__file__).with_name("commander.py")
        command = [sys.executable, "-P", str(script), json.dumps(settings), str(theirs.fileno())]
        with theirs:
            self._process = subprocess.Popen(
                command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, stdout=self._output, stderr=self._output
            )
        self._channel = ours
        self._expect(b"R", START_TIMEOUT)

    def take_control(self) -> None:
        """Upload the control program, which ends any playing one, and wait until it takes commands; DeviceError with the remedy."""
        assert self._channel is not None
        try:
            self._channel.send(b"G")
        except OSError as error:
            self._fail(f"the command process has ended ({error})")
            raise DeviceError(self.failure) from error
        self._expect(b"K", TAKE_TIMEOUT)
        self._output_seen = os.fstat(self._output.fileno()).st_size

    def _expect(self, wanted: bytes, timeout: float) -> None:
        assert self._channel is not None
        ready, _, _ = select.select([self._channel], [], [], timeout)
        message = _received(self._channel) if ready else b"E" + f"no answer within {timeout:.0f} s".encode()
        if message != wanted:
            self._fail(message[1:].decode("utf-8", "replace") or "the command process ended")
            raise DeviceError(self.failure)

    def send(self, q: np.ndarray, dq: np.ndarray) -> None:
        """Stream one setpoint; DeviceError if this or an earlier one was not taken."""
        self.look()
        assert self._channel is not None
        self._sent += 1
        try:
            self._channel.send(b"Q" + SETPOINT.pack(self._sent, *q, *dq), socket.MSG_DONTWAIT)
        except OSError as error:
            self.look()  # if the process has reported why, that is the reason
            self._fail(f"the command process does not take commands ({error})")
            raise DeviceError(self.failure) from error
        self._waiting_since = self._waiting_since or time.monotonic()

    def look(self) -> None:
        """Process reports; DeviceError if the process failed, wrote output (a healthy one does not) or took no command for UNTAKEN s."""
        if self.failure is None and self._channel is not None:
            while self.failure is None and select.select([self._channel], [], [], 0.0)[0]:
                self._handle(_received(self._channel))
            if self.failure is None and os.fstat(self._output.fileno()).st_size > self._output_seen:
                self._fail("ur_rtde lost its connection")
            late = self._waiting_since is not None and time.monotonic() - self._waiting_since > UNTAKEN
            if self.failure is None and late:
                self._fail(f"the newest command was not taken within {UNTAKEN} s")
        if self.failure is not None:
            raise DeviceError(self.failure)

    def stop(self) -> None:
        """Request a stop; if that is not possible the process is killed, and the controller's watchdog stops the arm."""
        if self._channel is not None and self.failure is None:
            self._waiting_since = None
            try:
                self._channel.send(b"S", socket.MSG_DONTWAIT)
            except OSError as error:
                self._fail(f"the command process does not take the stop ({error})")

    def end(self) -> None:
        """Let the process stop the arm and end its program; kill it if it does not within bounded time."""
        if self._channel is not None:
            self._channel.close()  # the process takes the closed channel as an order to stop and exit
            self._channel = None
        if self._process is not None:
            try:
                self._process.wait(END_TIMEOUT)
            except subprocess.TimeoutExpired:
                self._process.kill()
                with contextlib.suppress(subprocess.TimeoutExpired):  # the system ends it as soon as it can
                    self._process.wait(END_TIMEOUT)
        if not self._output.closed:
            self._output.close()

    def _handle(self, message: bytes) -> None:
        if message[:1] == b"A":
            self._taken = NUMBER.unpack(message[1:])[0]
            self._waiting_since = None if self._taken == self._sent else time.monotonic()
        elif message[:1] == b"T":
            self._fail(
                f"no command came for {self._options.patience:g} s, so the arm was stopped; this computer was busy: "
                "stop other work on it, or raise frame_timeout in the cell's [options]"
            )
        elif message[:1] == b"E":
            self.refused = True
            self._fail(message[1:].decode("utf-8", "replace"))
        elif message[:1] == b"L":
            self._fail(message[1:].decode("utf-8", "replace"))
        elif not message:
            self._fail("the command process ended")

    def _fail(self, reason: str) -> None:
        """Record the reason and kill the process at once: from here on it could only do harm."""
        if self._process is not None:
            self._process.kill()
        self._output.seek(0)
        lines = self._output.read().decode("utf-8", "replace").strip().splitlines()
        text = f"{reason} {' '.join(lines)}"
        remedy = next((r for word, r in REMEDIES if word in text), None)
        last_line = f" ({lines[-1]})" if lines and remedy is None else ""
        self.failure = f"{self._options.host}: commands are not taken: {reason}{last_line}; " + (
            remedy or "see what the pendant says, clear it there, then connect again"
        )


def _received(channel: socket.socket) -> bytes:
    """One message; empty if the process is gone. A reset means the same: it left messages unread."""
    try:
        return channel.recv(8192)
    except ConnectionResetError:
        return b""
