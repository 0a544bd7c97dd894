"""What PolyScope X reports over its Robot API, by version; whatever answers there, nothing hangs or crashes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable

import pytest

from drivers import open_driver
from drivers.ur_rtde import robot_api
from drivers.ur_rtde.dashboard import ControllerInfo, controller_info, of_robot_api
from sim.arm import Arm
from sim.cell import Cell, load_cell
from sim.emulated import open_emulator
from sim.emulated.ur.emulator import UrEmulator
from sim.errors import DeviceError

PORT = 8080


@pytest.fixture
def robot(cell: Callable[..., Cell], arm: Arm):  # type: ignore[no-untyped-def]
    opened: list[UrEmulator] = []

    def make(polyscope: str) -> tuple[UrEmulator, Cell]:
        path = cell(polyscope=polyscope).path
        path.write_text(path.read_text().replace("watchdog =", f"robot_api_port = {PORT}\nwatchdog ="))
        table = load_cell(path)
        emulator = open_emulator(table, arm)
        assert isinstance(emulator, UrEmulator)
        emulator.start()
        opened.append(emulator)
        return emulator, table

    yield make
    for emulator in opened:
        emulator.stop()


@pytest.mark.parametrize(
    ("polyscope", "reply"),
    [
        ("10.11.0", ControllerInfo("10.11.0")),
        ("10.12.0", ControllerInfo("10.12.0", remote=True, operational_mode="AUTOMATIC", safety="NORMAL")),
        ("10.14.0", ControllerInfo("10.14.0", "UR10", "20230000000", True, "AUTOMATIC", "NORMAL")),
    ],
)
def test_each_version_reports_what_it_can(robot, polyscope: str, reply: ControllerInfo) -> None:  # type: ignore[no-untyped-def]
    emulator, _ = robot(polyscope)
    assert controller_info(emulator.host, emulator.robot.version, PORT) == reply


def test_an_answer_with_another_form_is_none() -> None:
    """A serial number becomes part of a folder's name, and every answer is shown in a terminal."""
    odd = {"PolyScope": "\x1b[2J10.11", "model": "\ud800", "serial": "../../x", "safety mode": "NORMAL\x07", "program": "a\nb"}
    assert of_robot_api(odd, (10, 11, 0, 0)) == ControllerInfo("10.11.0")
    good = {"PolyScope": "10.14.0-rc1", "model": "UR20", "serial": "20230000000", "program": "Palettierer für Köln"}
    assert of_robot_api(good, (10, 14, 0, 0)) == ControllerInfo(
        "10.14.0-rc1", "UR20", "20230000000", program="Palettierer für Köln"
    )


def test_local_control_and_a_program_that_plays_are_named(robot, arm: Arm) -> None:  # type: ignore[no-untyped-def]
    emulator, table = robot("10.14.0")
    emulator.robot.remote = False
    emulator.do(lambda: emulator.robot.play("palletise"))
    driver = open_driver(table, arm)
    with pytest.raises(DeviceError, match=r"local control.*program palletise is playing"):
        driver.connect()
    driver.close()
    assert emulator.robot.ended == []


def test_where_the_service_is_off_only_rtde_is_reported() -> None:
    assert controller_info("127.0.0.1", (10, 14, 0, 0), 1) == ControllerInfo("10.14.0")


@pytest.mark.parametrize(
    ("answer", "expected"),
    [(b"", {}), (b"nonsense\r\n\r\n", {}), (b"HTTP/1.1 500 \r\nContent-Length: 0\r\n\r\n", {}),
     (b"HTTP/1.1 200 \r\nContent-Length: 4\r\n\r\n[1]}", {}), (b"HTTP/1.1 200 \r\nContent-Length: 2\r\n\r\n[]", {}),
     (b'HTTP/1.1 200 \r\nContent-Length: 12\r\n\r\n{"mode": 17}', {"mode": 17})],
)  # fmt: skip
def test_what_is_no_answer_is_none(answer: bytes, expected: dict[str, object]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as client:
                client.recv(4096)
                client.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            found = robot_api.fetch("127.0.0.1", server.getsockname()[1], "/x")
        finally:
            thread.join()
    assert found == expected


@pytest.mark.parametrize("drip", [b"HTTP/1.1 200 OK\r\nA: ", b"HTTP/1.1 200 OK\r\nContent-Length: 60000\r\n\r\n", b""])
def test_an_answer_that_is_never_whole_is_given_up(monkeypatch: pytest.MonkeyPatch, drip: bytes) -> None:
    monkeypatch.setattr(robot_api, "TIMEOUT", 0.2)
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as client:
                try:  # the reader may have given up before the first byte
                    client.sendall(drip)
                    while not over.wait(0.05):
                        client.sendall(b"1")
                except OSError:
                    return

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            assert robot_api.fetch("127.0.0.1", server.getsockname()[1], "/system") == {}
        finally:
            over.set()
            thread.join()
