"""A socketcand server on TCP, raw mode: `< send ... >` in, `< frame ... >` and `< error ... >` out.

Protocol: linux-can/socketcand, as spoken by python-can's client.
"""

from __future__ import annotations

import re
import select
import socket
import time

import can

from sim.emulated.can.port import Port
from sim.errors import DeviceError

SEND = re.compile(rb"< send ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) ([0-8])((?: [0-9A-Fa-f]{1,2})*) >")
PATIENCE = 0.2  # s after which a client that takes nothing is dropped, so that it does not block the bus


class SocketcandPort(Port):
    """Any number of clients on host:port; each receives the frames of the drives and of the other clients, as on a bus."""

    def __init__(self, host: str, port: int) -> None:
        self.address = (host, port)
        self._server: socket.socket | None = None
        self._clients: dict[socket.socket, bytes] = {}  # client -> received part of its next request

    def open(self) -> None:
        self._server = socket.socket()
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._server.bind(self.address)
        except OSError as error:
            raise DeviceError(
                f"{self.address[0]}:{self.address[1]} cannot be opened ({error}); stop the program that uses it"
            ) from error
        self._server.listen()
        self.address = self._server.getsockname()

    def receive(self, timeout: float, state: str, stalled: bool) -> list[can.Message]:
        if self._server is None:
            time.sleep(timeout)
            return []
        watched = [self._server, *(() if stalled else self._clients)]
        frames = []
        for ready in select.select(watched, [], [], timeout)[0]:
            if ready is self._server:
                self._accept(self._server)
            elif ready in self._clients:
                frames += self._receive(ready)
        return frames

    def acknowledge(self, message: can.Message, accepted: bool) -> None:
        """Nothing: the protocol does not acknowledge frames."""

    def deliver(self, messages: list[can.Message]) -> None:
        for message in messages:
            for client in list(self._clients):
                self._send_text(client, _frame_text(message))

    def unplug(self) -> None:
        for client in list(self._clients):
            self._drop(client)
        if self._server is not None:
            self._server.close()
            self._server = None

    def close(self) -> None:
        self.unplug()

    def _accept(self, server: socket.socket) -> None:
        client = server.accept()[0]
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.settimeout(PATIENCE)
        self._clients[client] = b""
        self._send_text(client, "< hi >")

    def _receive(self, client: socket.socket) -> list[can.Message]:
        try:
            data = client.recv(65536)
        except OSError:
            data = b""
        if not data:
            self._drop(client)
            return []
        self._clients[client] += data
        frames = self._requests(client)
        for frame in frames:
            for other in list(self._clients):
                if other is not client:
                    self._send_text(other, _frame_text(frame))
        return frames

    def _requests(self, client: socket.socket) -> list[can.Message]:
        frames = []
        buffer = self._clients[client]
        while (end := buffer.find(b">")) >= 0:
            text, buffer = buffer[: end + 1].strip(), buffer[end + 1 :]
            found = SEND.fullmatch(text)
            if found:
                identifier, length, data = found.groups()
                payload = bytes(int(x, 16) for x in data.split())
                if len(payload) == int(length):
                    frames.append(
                        can.Message(arbitration_id=int(identifier, 16), is_extended_id=len(identifier) == 8, data=payload)
                    )
            elif text.startswith(b"< open ") or text == b"< rawmode >":
                self._send_text(client, "< ok >")
            else:
                self._send_text(client, "< error unknown command >")
        if client in self._clients:
            self._clients[client] = buffer
        return frames

    def _send_text(self, client: socket.socket, text: str) -> None:
        if client not in self._clients:
            return
        try:
            client.sendall(text.encode("ascii"))
        except OSError:
            self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._clients.pop(client, None)
        client.close()


def _frame_text(message: can.Message) -> str:
    now = time.time()
    if message.is_error_frame:
        return f"< error {message.arbitration_id:03X} {now:.6f} >"
    identifier = f"{message.arbitration_id:08X}" if message.is_extended_id else f"{message.arbitration_id:03X}"
    return f"< frame {identifier} {now:.6f} {message.data.hex().upper()} >"
