"""The real ur_rtde clients against the emulated controller, in a process of their own because their C++ code holds the GIL."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Callable

import pytest

from sim.emulated.ur.emulator import SCRIPT, UrEmulator
from sim.errors import ConfigError, DeviceError

CLIENT = """
import json, sys
import rtde_control, rtde_receive
host = sys.argv[1]
receive = rtde_receive.RTDEReceiveInterface(host)
reply = {"q": receive.getActualQ(), "mode": receive.getRobotMode()}
control = rtde_control.RTDEControlInterface(host)
q = receive.getActualQ()
reply["moved"] = control.moveJ([q[0] + 0.05] + q[1:], 1.0, 5.0)
reply["servoed"] = control.servoJ([q[0] + 0.05] + q[1:], 0.0, 0.0, 0.002, 0.1, 300.0)
reply["stopped"] = control.servoStop(5.0)
control.stopScript()
print(json.dumps(reply))
"""


def client(host: str, script: str = CLIENT) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", script, host], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("version", [(5, 25, 1), (3, 15, 4), (10, 11, 0)], ids=["e-Series", "CB3", "PolyScope X"])
def test_the_real_clients_connect_move_and_stop(emulator: Callable[..., UrEmulator], version: tuple[int, int, int]) -> None:
    controller = emulator(version)
    before = list(controller.robot.actual_q)
    done = client(controller.host)
    assert done.returncode == 0, done.stderr
    reply = json.loads(done.stdout.splitlines()[-1])
    assert reply == {"q": before, "mode": 7, "moved": True, "servoed": True, "stopped": True}
    assert controller.robot.actual_q[0] == pytest.approx(before[0] + 0.05, abs=0.02)


def test_the_real_client_is_refused_in_local_control(emulator: Callable[..., UrEmulator]) -> None:
    controller = emulator()
    controller.inject("local_control")
    done = client(controller.host)
    assert done.returncode != 0
    assert "remote control" in done.stderr


def test_the_real_client_is_refused_when_a_fieldbus_owns_the_registers(emulator: Callable[..., UrEmulator]) -> None:
    controller = emulator()
    controller.inject("fieldbus")
    done = client(controller.host)
    assert done.returncode != 0
    assert "already in use" in done.stderr


def test_an_address_is_emulated_once_and_only_on_loopback(emulator: Callable[..., UrEmulator]) -> None:
    controller = emulator()
    with pytest.raises(DeviceError, match="cannot be opened"):
        UrEmulator(controller.robot, controller.host).start()
    with pytest.raises(ConfigError, match="loopback"):
        UrEmulator(controller.robot, "192.168.0.10")
    with pytest.raises(ConfigError, match="did you mean 'protective_stop'"):
        controller.inject("protectivestop")


def test_a_controller_that_is_switched_off_closes_the_sockets_of_its_program(emulator: Callable[..., UrEmulator]) -> None:
    controller = emulator()
    with socket.create_server((controller.host, 0)) as listener:
        listener.settimeout(20)
        host, port = listener.getsockname()
        opens = f'def opens():\n  socket_open("{host}", {port}, "host")\n  while True:\n    sync()\n  end\nend\n'
        with socket.create_connection((controller.host, SCRIPT)) as script:
            script.sendall(opens.encode())
            connection, _ = listener.accept()
        with connection:
            connection.settimeout(20)
            controller.stop()
            assert connection.recv(1) == b""
