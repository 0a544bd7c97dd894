"""A socketcand server on TCP, raw mode: `< send ... >` in, `< frame ... >` and `< error ... >` out.

Protocol: linux-can/socketcand, as python-can's client speaks it.
"""

from __future__ import annotations

import contextlib
import re
import select
import socket
import time

import can

from sim.emulated.can.port import Port
from sim.errors import DeviceError

SEND = re.compile(rb"< send ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) ([0-8])((?: [0-9A-Fa-f]{1,2})*) >")


class SocketcandPort(Port):
    """One client at a time on host:port."""

    def __init__(self, host: str, port: int) -> None:
        self.address = (host, port)
        self._server: socket.socket | None = None
        self._client: socket.socket | None = None
        self._buffer = b""

    def open(self) -> None:
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._server.bind(self.address)
        except OSError as error:
            raise DeviceError(
                f"{self.address[0]}:{self.address[1]} cannot be opened ({error}); end the other program there"
            ) from error
        self._server.listen(1)
        self.address = self._server.getsockname()

    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        if self._server is None:
            time.sleep(timeout)
            return []
        watched = [self._server] + ([self._client] if self._client is not None and not stalled else [])
        ready = select.select(watched, [], [], timeout)[0]
        if self._server in ready:
            self._drop()
            self._client = self._server.accept()[0]
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._buffer = b""
            self._say("< hi >")
        elif self._client in ready and self._client is not None:
            try:
                data = self._client.recv(65536)
            except OSError:
                data = b""
            if not data:
                self._drop()
                return []
            self._buffer += data
            return self._requests()
        return []

    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        """The protocol has no answer to a frame."""

    def deliver(self, messages: list[can.Message]) -> None:
        now = time.time()
        for m in messages:
            if m.is_error_frame:
                self._say(f"< error {m.arbitration_id:03X} {now:.6f} >")
            else:
                identifier = f"{m.arbitration_id:08X}" if m.is_extended_id else f"{m.arbitration_id:03X}"
                self._say(f"< frame {identifier} {now:.6f} {m.data.hex().upper()} >")

    def unplug(self) -> None:
        self._drop()
        if self._server is not None:
            self._server.close()
            self._server = None

    def close(self) -> None:
        self.unplug()

    def _requests(self) -> list[can.Message]:
        frames = []
        while (end := self._buffer.find(b">")) >= 0:
            text, self._buffer = self._buffer[: end + 1].strip(), self._buffer[end + 1 :]
            found = SEND.fullmatch(text)
            if found:
                identifier, length, data = found.groups()
                payload = bytes(int(x, 16) for x in data.split())
                if len(payload) == int(length):
                    frames.append(
                        can.Message(arbitration_id=int(identifier, 16), is_extended_id=len(identifier) == 8, data=payload)
                    )
            elif text.startswith(b"< open ") or text == b"< rawmode >":
                self._say("< ok >")
            else:
                self._say("< error unknown command >")
        return frames

    def _say(self, text: str) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.sendall(text.encode("ascii"))

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
