"""The arm as described by its own controller: read from the primary interface, compared, and written as an arm folder."""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from calib.main import main
from drivers.ur_rtde import own_folder, primary
from drivers.ur_rtde.primary import OwnArm, own_arm, parsed, parts
from sim.arm import Arm, load_arm
from sim.cell import Cell, load_cell
from sim.dh import DhRows
from sim.emulated import open_emulator
from sim.emulated.ur.primary import SAFETY_CHECKSUM, HeldArm, greeting, held, nominal_rows
from sim.errors import DeviceError

LIMITS = {"q_min": np.full(6, -6.0), "q_max": np.full(6, 6.0), "dq_max": np.full(6, 2.0)}


def own(rows: DhRows) -> OwnArm:
    return OwnArm(rows, LIMITS["q_min"], LIMITS["q_max"], LIMITS["dq_max"], 2, "sum")


def flange(rows: DhRows, q: np.ndarray) -> np.ndarray:
    """The flange pose, as the plain product of Denavit-Hartenberg transforms."""
    world = np.eye(4)
    for theta, a, d, alpha, angle in zip(rows.theta, rows.a, rows.d, rows.alpha, q, strict=True):
        c, s, ca, sa = np.cos(theta + angle), np.sin(theta + angle), np.cos(alpha), np.sin(alpha)
        world = world @ [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
    return world


@pytest.mark.parametrize("name", ["ur10e", "ur5", "ur3e", "ur20"])
def test_the_rows_of_an_uncalibrated_arm_give_its_own_model(name: str) -> None:
    arm = load_arm(name)
    assert own_folder.moved(arm, own(nominal_rows(arm))) == pytest.approx(np.zeros(6), abs=1e-12)


def test_a_calibrated_arm_s_model_moves_as_its_controller_s_rows(arm: Arm, tmp_path: Path) -> None:
    rows = held(arm, 7).rows
    written = own_folder.write_own(tmp_path / "ur10e-20231", arm, own(rows), "20231")
    assert 1e-5 < np.max(own_folder.moved(arm, own(rows))) < own_folder.CALIBRATION_MAX
    model = mujoco.MjModel.from_xml_string(written.model_text)
    data = mujoco.MjData(model)
    # in every posture the last joint has the same axis, as a direction and as a line
    for q in np.random.default_rng(0).uniform(-np.pi, np.pi, (20, 6)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        frame, body = flange(rows, q), data.body("wrist_3_link")
        axis = body.xmat.reshape(3, 3)[:, 2]
        # rows end in Tx(a6) Rx(alpha6), after the last axis
        before = frame @ np.linalg.inv(_x(rows.alpha[5], rows.a[5]))
        assert axis == pytest.approx(before[:3, 2], abs=1e-9)
        apart = before[:3, 3] - body.xpos
        assert apart - axis * (apart @ axis) == pytest.approx(np.zeros(3), abs=1e-9)


def _x(angle: float, along: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0, along], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]])


def test_limits_are_the_narrower_ones_and_the_rest_is_kept(arm: Arm, tmp_path: Path) -> None:
    written = own_folder.write_own(tmp_path / "ur10e-20231", arm, own(nominal_rows(arm)), "20231")
    np.testing.assert_array_equal(written.q_max, np.minimum(arm.q_max, 6.0))
    np.testing.assert_array_equal(written.dq_max, np.minimum(arm.dq_max, 2.0))
    np.testing.assert_array_equal(written.tree.mass, arm.tree.mass)
    assert "20231" in written.provenance["kinematics"]
    assert written.name == "ur10e-20231"


def test_another_arm_s_lengths_are_named(arm: Arm) -> None:
    check = own_folder.kinematics(arm, own(nominal_rows(load_arm("ur5e"))))
    assert check.ok is False
    assert "a ur5e or ur7e" in check.remedy
    assert own_folder.kinematics(arm, own(nominal_rows(arm))).ok is True


def test_the_command_reads_it_from_a_controller(
    cell: Callable[..., Cell], arm: Arm, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = cell().path
    path.write_text(path.read_text() + "calibration = 3\n")
    emulator = open_emulator(load_cell(path), arm)
    emulator.start()
    try:
        assert main(["arm", "read", str(path), "--out", str(tmp_path / "mine"), "--json"]) == 0
    finally:
        emulator.stop()
    reply = json.loads(capsys.readouterr().out)
    assert reply["serial"] == "20230000000"
    assert 0 < max(reply["moved"]) < 0.005
    assert load_arm(tmp_path / "mine").name == "mine"


def test_bytes_that_are_no_primary_interface_are_refused() -> None:
    good = greeting(held(load_arm("ur10e"), None), "UR10")
    state = good[5:]
    found = parts(state, "there")
    assert np.allclose(parsed(found, "there").kinematics.d, [0.1807, 0, 0, 0.17415, 0.11985, 0.11655])
    assert parsed(found, "there").safety == SAFETY_CHECKSUM
    assert parsed(found | {10: b"\0\0\0"}, "there").safety is None
    rng = np.random.default_rng(5)
    for _ in range(300):
        broken = bytearray(state)
        for k in rng.integers(0, len(broken), 4):
            broken[k] = rng.integers(0, 256)
        cut = bytes(broken[: rng.integers(0, len(broken) + 1)])
        try:
            parsed(parts(cut, "there"), "there")
        except (DeviceError, KeyError) as error:
            assert isinstance(error, DeviceError) or error.args[0] in (5, 6)  # noqa: PT017
    nan = HeldArm(DhRows(np.full(6, np.nan), *(np.zeros(6),) * 3), np.full(6, -1.0), np.ones(6), np.ones(6))
    with pytest.raises(DeviceError, match="nothing was taken"):
        parsed(parts(greeting(nan, "UR10")[5:], "there"), "there")


@pytest.mark.parametrize("sends", [b"", struct.pack(">IB", 2, 16), struct.pack(">IB", 1 << 30, 16)])
def test_whatever_answers_the_answer_is_bounded(monkeypatch: pytest.MonkeyPatch, sends: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(primary, "PORTS", (server.getsockname()[1],))
        monkeypatch.setattr(primary, "TIMEOUT", 0.2)

        def serve() -> None:
            with server.accept()[0] as client:
                client.sendall(sends)
                client.recv(1)  # until the other end closes

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(DeviceError):
            own_arm("127.0.0.1")
        thread.join()
