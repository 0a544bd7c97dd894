"""Functions that a program on the emulated controller may call: motion, time, and sockets to other computers."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
from collections.abc import Generator
from typing import Any

import numpy as np

from sim.emulated.ur.urscript import Call

CONNECT_TIMEOUT = 1.0  # s; on the same computer, a connection is immediate
WAIT = Generator[None, None, Any]


class Functions:
    """URScript functions of one running program; call `close` when it has ended, for whatever reason."""

    def __init__(self, robot: Any) -> None:
        self._robot = robot
        self._sockets: dict[str, socket.socket] = {}
        self._bytes: dict[str, bytes] = {}

    def table(self) -> dict[str, Call]:
        """The functions by their URScript names."""
        return {
            "textmsg": self._textmsg, "sync": self._sync, "sleep": self._sleep, "servoj": self._servoj, "stopj": self._stopj,
            "socket_open": self._open, "socket_close": self._close, "socket_read_binary_integer": self._read_integers,
            "socket_send_int": self._send_integer,
        }  # fmt: skip

    def close(self) -> None:
        """Close every socket."""
        for connection in self._sockets.values():
            connection.close()
        self._sockets.clear()

    def _textmsg(self, *words: object) -> WAIT:
        self._robot.note(" ".join(str(word) for word in words))
        return
        yield

    def _sync(self) -> WAIT:
        yield

    def _sleep(self, seconds: float) -> WAIT:
        for _ in range(math.ceil(seconds / self._robot.dt - 1e-6)):
            yield

    def _servoj(self, q: list[float], *, t: float, lookahead_time: float, gain: float) -> WAIT:
        self._robot.motion.servo(np.array(q, dtype=float), lookahead_time, gain)
        yield from self._sleep(t)

    def _stopj(self, a: float) -> WAIT:
        self._robot.motion.stop(a)
        while not self._robot.motion.standing:
            yield

    def _open(self, address: str, port: int, name: str) -> WAIT:
        self._sockets.pop(name, socket.socket()).close()
        try:
            connection = socket.create_connection((address, port), CONNECT_TIMEOUT, source_address=(self._robot.host, 0))
        except OSError as error:
            self._robot.note(f"socket_open({address}, {port}): {error}")
            return False
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._sockets[name], self._bytes[name] = connection, b""
        return True
        yield

    def _close(self, name: str) -> WAIT:
        if name in self._sockets:
            self._sockets.pop(name).close()
        return
        yield

    def _read_integers(self, number: int, name: str, timeout: float) -> WAIT:
        """[number, ...], or [0, NaN, ...] if fewer arrive within `timeout` s; at once if the connection is gone."""
        end = self._robot.time + timeout
        size = 4 * number
        while True:
            there = self._fill(name, size)
            if len(self._bytes.get(name, b"")) >= size:
                data, self._bytes[name] = self._bytes[name][:size], self._bytes[name][size:]
                return [number, *struct.unpack(f">{number}i", data)]
            if not there or self._robot.time >= end - 1e-9:
                return [0, *[math.nan] * number]
            yield

    def _fill(self, name: str, size: int) -> bool:
        connection = self._sockets.get(name)
        if connection is None or self._robot.unplugged:
            return connection is not None
        while len(self._bytes[name]) < size:
            try:
                data = connection.recv(4096)
            except BlockingIOError:
                return True
            except OSError:
                self._bytes[name] = b""  # reset: what had not been read is lost
                return False
            if not data:
                return False
            self._bytes[name] += data
        return True

    def _send_integer(self, value: int, name: str) -> WAIT:
        with contextlib.suppress(OSError, KeyError):
            if not self._robot.unplugged:
                self._sockets[name].send(struct.pack(">i", int(value)))
        return
        yield
