"""Replies of the dashboard server: whatever answers there, each wait is bounded."""

from __future__ import annotations

import socket
import threading

import pytest

from drivers.ur_rtde import dashboard
from sim.errors import DeviceError


@pytest.mark.parametrize("sends", [b"", b"Connected\n", b"x" * (2 * dashboard.LINE_MAX)])
@pytest.mark.parametrize("drips", [b"", b"."])
def test_an_answer_that_is_never_whole_is_given_up(monkeypatch: pytest.MonkeyPatch, sends: bytes, drips: bytes) -> None:
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(dashboard, "PORT", server.getsockname()[1])
        monkeypatch.setattr(dashboard, "TIMEOUT", 0.2)

        def serve() -> None:
            with server.accept()[0] as client:
                client.sendall(sends)
                while not over.wait(0.05):
                    try:
                        client.sendall(drips)
                    except OSError:
                        return

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with pytest.raises(DeviceError, match="does not answer"):
                dashboard.ask("127.0.0.1", "robotmode")
        finally:
            over.set()
            thread.join()


def test_an_answer_in_pieces_is_one_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(dashboard, "PORT", server.getsockname()[1])

        def serve() -> None:
            with server.accept()[0] as client:
                client.sendall(b"Connected\n")
                assert client.recv(100) == b"safetymode\n"
                for piece in (b"Safety", b"mode: NOR", b"MAL\r\n"):
                    client.sendall(piece)
                client.recv(100)

        thread = threading.Thread(target=serve)
        thread.start()
        assert dashboard.ask("127.0.0.1", "safetymode") == ["Safetymode: NORMAL"]
        thread.join()
