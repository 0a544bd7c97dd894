"""Playback of a captured controller on loopback: captured answers to captured requests, and frames at their captured pace."""

from __future__ import annotations

import itertools
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

from sim.capture import Message, read_capture

DATA = ord("U")
PORTS = {"rtde": (30004,), "dashboard": (29999,), "primary": (30001, 30011)}
HTTP_END = b"\r\n\r\n"
BASE = b"/universal-robots/robot-api"


class CapturedUr:
    """Serves the file of `calib capture` at a loopback address between `start` and `stop`; accepts no commands and no programs."""

    def __init__(self, path: Path, host: str, robot_api_port: int = 8080) -> None:
        self.head, self.messages = read_capture(path)
        self.host = host
        self._api = robot_api_port
        self._ending = threading.Event()
        self._threads: list[threading.Thread] = []
        self._sockets: list[socket.socket] = []

    def start(self) -> None:
        """Open the ports of the channels that were captured."""
        serve: dict[str, Callable[[socket.socket], None]] = {
            "rtde": self._rtde, "dashboard": self._dashboard, "primary": self._primary, "robot_api": self._http,
        }  # fmt: skip
        for channel in dict.fromkeys(m.channel for m in self.messages):
            for port in PORTS.get(channel, (self._api,)):
                server = socket.create_server((self.host, port))
                server.settimeout(0.05)
                self._sockets.append(server)
                self._run(self._accept, server, serve[channel])

    def stop(self) -> None:
        """Close everything."""
        self._ending.set()
        for thread in self._threads:
            thread.join()
        for server in self._sockets:
            server.close()

    def _run(self, target: Callable[..., None], *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self, server: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        while not self._ending.is_set():
            try:
                client, _ = server.accept()
            except TimeoutError:
                continue
            client.settimeout(0.05)
            self._run(self._served, client, serve)

    def _served(self, client: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        with client:
            try:
                serve(client)
            except OSError:
                return  # the client disconnected

    def _of(self, channel: str) -> list[Message]:
        return [m for m in self.messages if m.channel == channel]

    def _answers(self, channel: str) -> dict[bytes, bytes]:
        """Request -> answer, for channels on which the two alternate."""
        own = [m for m in self._of(channel) if not (m.from_device and channel == "rtde" and m.data[2:3] == bytes([DATA]))]
        return {q.data: a.data for q, a in itertools.pairwise(own) if not q.from_device and a.from_device}

    def _received(self, client: socket.socket, whole: Callable[[bytes], int | None]) -> bytes | None:
        """One message of the length that `whole` returns; None if the client disconnected or playback ended."""
        data = b""
        while not self._ending.is_set():
            length = whole(data)
            if length is not None and len(data) >= length:
                return data[:length]
            try:
                more = client.recv(1)
            except TimeoutError:
                continue
            if not more:
                return None
            data += more
        return None

    def _rtde(self, client: socket.socket) -> None:
        answers = self._answers("rtde")
        frames = [m for m in self._of("rtde") if m.from_device and m.data[2] == DATA]
        while (
            request := self._received(client, lambda d: struct.unpack_from(">H", d)[0] if len(d) >= 2 else None)
        ) is not None:
            if request not in answers:
                return
            client.sendall(answers[request])
            if request[2:3] == b"S":
                break
        begin = time.monotonic()
        for m in frames:
            if self._ending.wait(max(0.0, begin + m.t - frames[0].t - time.monotonic())):
                return
            client.sendall(m.data)
        self._ending.wait()

    def _dashboard(self, client: socket.socket) -> None:
        answers = self._answers("dashboard")
        client.sendall(b"Connected: Universal Robots Dashboard Server\n")
        while (line := self._received(client, lambda d: len(d) if d.endswith(b"\n") else None)) is not None:
            client.sendall(answers.get(line.strip(), b"could not understand: it was not asked when this was captured") + b"\n")

    def _primary(self, client: socket.socket) -> None:
        for m in self._of("primary"):
            if m.from_device and m.data:
                client.sendall(m.data)
        self._ending.wait()

    def _http(self, client: socket.socket) -> None:
        request = self._received(client, lambda d: len(d) if d.endswith(HTTP_END) else None)
        if request is not None:
            path = request.split(b" ")[1].removeprefix(BASE)
            body = self._answers("robot_api").get(path, b"")
            status = b"200" if body not in (b"", b"{}") else b"404"
            client.sendall(b"HTTP/1.1 " + status + b" \r\nContent-Length: %d\r\nConnection: close\r\n\r\n" % len(body) + body)
