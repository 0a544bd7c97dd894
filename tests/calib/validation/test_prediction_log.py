"""The file for viewers: other readers decode it, its frames match the arm, and its torques match the validation."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from calib.validation.prediction_log import joint_poses, write_predictions
from calib.validation.validate import validate
from logs import read_log
from sim.arm import load_arm
from sim.model import compiled

SAMPLE = Path(__file__).resolve().parents[3] / "logs" / "samples" / "servo6_excitation.mcap"


def matrix(pose: np.ndarray) -> np.ndarray:
    out = np.eye(4)
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, np.r_[pose[6], pose[3:6]])
    out[:3, :3], out[:3, 3] = rotation.reshape(3, 3), pose[:3]
    return out


def test_other_readers_see_the_arm_move_and_both_torques(tmp_path: Path) -> None:
    arm = load_arm("servo6")
    log = read_log(SAMPLE, arm.joint_names)
    found = validate(arm, [log], forward=False)
    (file,) = write_predictions(tmp_path, arm, [log], found.checks)
    m, keep = found.checks[0].measurement, np.flatnonzero(found.checks[0].measurement.inside)
    assert file == tmp_path / "prediction.mcap"
    got: dict[str, list] = {}
    with file.open("rb") as stream:
        for _, channel, message, decoded in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            got.setdefault(channel.topic, []).append((message.log_time, decoded))
    assert set(got) == {"/joint_states", "/prediction/joint_states", "/prediction/missing", "/robot_description", "/tf"}
    np.testing.assert_array_equal([d.effort for _, d in got["/prediction/joint_states"]], found.checks[0].tau_hat[keep])
    np.testing.assert_array_equal([d.effort for _, d in got["/joint_states"]], m.tau[keep])
    missing = np.array([d.effort for _, d in got["/prediction/missing"]])
    np.testing.assert_allclose(missing, m.tau[keep] - found.checks[0].tau_hat[keep], atol=1e-12)
    start = log.t_host_origin + round(m.trajectory.t[keep[0]] * 1e9)
    assert abs(got["/joint_states"][0][0] - start) < 10
    names = {link.child_frame_id for _, d in got["/tf"] for link in d.transforms}
    assert names == set(arm.tree.link_names)
    model = mujoco.MjSpec.from_string(got["/robot_description"][0][1].data).compile()
    assert model.njnt == arm.n
    at, last = got["/tf"][-1]
    k = int(np.argmin(np.abs([t - at for t, _ in got["/joint_states"]])))
    x = last.transforms[2].transform
    pose = np.array([x.translation.x, x.translation.y, x.translation.z, x.rotation.x, x.rotation.y, x.rotation.z, x.rotation.w])
    np.testing.assert_allclose(pose, joint_poses(arm, m.trajectory.q[keep[k]][None])[0, 2], atol=1e-12)


def test_the_frames_are_where_mujoco_has_them() -> None:
    for name in ("servo6", "ur10e"):
        arm = load_arm(name)
        model = compiled(arm.model_text, arm.model_path.parent)
        data = mujoco.MjData(model)
        q = np.random.default_rng(3).uniform(-2, 2, arm.n)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        frames: list[np.ndarray] = []
        for j, pose in enumerate(joint_poses(arm, q[None])[0]):
            up = np.eye(4) if arm.tree.parent[j] < 0 else frames[arm.tree.parent[j]]
            frames.append(up @ matrix(pose))
            np.testing.assert_allclose(frames[j][:3, 3], data.xanchor[j], atol=1e-12)
            np.testing.assert_allclose(frames[j][:3, :3] @ arm.tree.axis[j], data.xaxis[j], atol=1e-12)
