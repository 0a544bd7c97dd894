"""Setpoints sent ahead to a program of our own on the controller, which plays one per control period.

Used by the command process in place of ur_rtde's control interface, whose registers hold only the newest setpoint. Imports nothing of this
project. The program connects back to this computer, as that of Universal Robots' client library does. The connection is the buffer: a
setpoint that is late by less than `ahead` does not change the motion. Every construct of the program occurs in that library's
external_control.urscript: socket_read_binary_integer and its count, integers scaled by 1e6, servoj by period, stopj when nothing comes.

Records are seven big-endian int32. The first is the kind: 1 setpoint (1e-6 rad), 2 a motion begins, 3 it ended at rest, 4 nothing new,
5 quit. The program reports int32: the number of setpoints played since its last report, or UNDERRUN.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import time

RECORD, COUNT = struct.Struct(">7i"), struct.Struct(">i")
SETPOINT, BEGIN, END, NOTHING, QUIT = 1, 2, 3, 4, 5
SCALE = 1_000_000
UNDERRUN = -1
REPORT = 10  # setpoints between two reports of the program
IDLE = 0.5  # s without a record, at rest, after which the program ends
SCRIPT_PORT = 30003
CONNECT_TIMEOUT, START_TIMEOUT = 2.0, 5.0

PROGRAM = """\
def calib_ahead():
  textmsg("setpoints come ahead over a socket")
  connected = socket_open("{host}", {port}, "ahead")
  playing = False
  played = 0
  while connected:
    patience = {idle}
    if playing:
      patience = {period}
    end
    record = socket_read_binary_integer(7, "ahead", patience)
    if record[0] != 7:
      socket_send_int({underrun}, "ahead")
      stopj({deceleration})
      connected = False
    elif record[1] == 1:
      q = [record[2] / {scale}, record[3] / {scale}, record[4] / {scale}, record[5] / {scale}, record[6] / {scale}, record[7] / {scale}]
      servoj(q, t={period}, lookahead_time={lookahead}, gain={gain})
      played = played + 1
      if played == {report}:
        socket_send_int(played, "ahead")
        played = 0
      end
    elif record[1] == 2:
      sleep({ahead})
      playing = True
    elif record[1] == 3:
      stopj({deceleration})
      playing = False
    elif record[1] == 4:
      sync()
    else:
      stopj({deceleration})
      connected = False
    end
  end
  socket_close("ahead")
end
"""


class Late(RuntimeError):
    """The program did not play what was sent; the message states why. Its end on the controller is only a consequence."""

    own = True


class Ahead:
    """Our end of the connection, with the calls of ur_rtde's control interface that the command process makes."""

    def __init__(self, connection: socket.socket, period: float, most: float) -> None:
        """most: s of setpoints that may wait at the controller; with more, the controller does not keep the period."""
        self._connection, self._most = connection, round(most / period)
        self._playing = False
        self._waiting = 0  # setpoints that were sent and not yet reported as played
        self._heard = b""
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        return self._connection.fileno()

    def servoJ(self, q: list[float], *_: float) -> bool:
        """Send a setpoint, preceded by BEGIN at the start of a motion. False if the connection is gone."""
        self.look()
        sent = self._playing or self._send(BEGIN)
        self._playing = True
        self._waiting += 1
        if self._waiting > self._most + REPORT:
            raise Late(f"{self._waiting} setpoints wait at the controller, which does not play one a period")
        return sent and self._send(SETPOINT, [round(SCALE * x) for x in q])

    def kickWatchdog(self) -> bool:
        """Send NOTHING, so that the program keeps waiting."""
        self.look()
        return self._send(NOTHING)

    def servoStop(self, _: float) -> bool:
        """Send END: the motion has ended at rest."""
        self._playing, self._waiting = False, 0
        return self._send(END)

    def setWatchdog(self, _: float) -> bool:
        """Nothing to set: the program times out by itself, after IDLE, or after one period in motion."""
        return True

    def stopScript(self) -> None:
        """End the program."""
        self._send(QUIT)
        self._connection.close()

    def abort(self) -> None:
        """Stop sending: the program plays what it has, finds the connection gone, and brakes with stopj."""
        self._connection.close()

    def look(self) -> None:
        """Process the program's reports; Late if it ran out of setpoints and braked."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            self._heard += self._connection.recv(4096)
        while len(self._heard) >= COUNT.size:
            (played,) = COUNT.unpack(self._heard[: COUNT.size])
            self._heard = self._heard[COUNT.size :]
            if played == UNDERRUN:
                raise Late("the controller ran out of setpoints and stopped the arm")
            self._waiting = max(0, self._waiting - played)

    def _send(self, kind: int, values: list[int] | None = None) -> bool:
        try:
            return self._connection.send(RECORD.pack(kind, *(values or [0] * 6))) == RECORD.size
        except OSError:
            return False


class Upload:
    """Upload of the program to the controller; nothing is sent or runs until `start`."""

    def __init__(self, settings: dict[str, float], host: str) -> None:
        self._settings = settings
        self._script = socket.create_connection((host, SCRIPT_PORT), timeout=CONNECT_TIMEOUT)
        self._host = self._script.getpeername()[0]
        self._listener = socket.create_server((self._script.getsockname()[0], 0), backlog=1)

    def start(self) -> Ahead | None:
        """Send the program and wait until it has connected; None if it does not within START_TIMEOUT."""
        address, port = self._listener.getsockname()[:2]
        s = self._settings
        text = PROGRAM.format(
            host=address, port=port, idle=IDLE, period=s["period"], deceleration=s["stop_deceleration"], underrun=UNDERRUN, scale=SCALE,
            lookahead=s["lookahead"], gain=s["gain"], report=REPORT, ahead=s["ahead"],
        )  # fmt: skip
        with self._script, self._listener:
            self._script.sendall(text.encode())
            end = time.monotonic() + START_TIMEOUT
            while (left := end - time.monotonic()) > 0:
                if select.select([self._listener], [], [], left)[0]:
                    connection, (peer, *_) = self._listener.accept()
                    if peer == self._host:
                        return Ahead(connection, s["period"], s["ahead"] + s["setpoint_timeout"])
                    connection.close()
        return None
