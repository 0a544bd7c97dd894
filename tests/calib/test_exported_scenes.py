"""Exported models in use: standing under load, several arms in one scene, other time steps, and refused tables."""

import json

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import calib.mujoco
from sim.arm import ArmEffect, load_arm
from sim.effects import with_effect
from sim.errors import ConfigError
from sim.export import export
from sim.exported_table import TABLE
from sim.model import compiled
from sim.mujoco_export import exported_model

JOINT = "shoulder_lift_joint"


pytestmark = pytest.mark.usefixtures("no_callback_left")


def table_with(text: str, key: str, value: object) -> str:
    """The model's text with one value of its table changed; a key `a.b` is in a nested table."""
    begin = text.index("data=", text.index(TABLE)) + 6
    end = text.index('"', begin)
    table = json.loads(text[begin:end].replace("&quot;", '"'))
    *path, last = key.split(".")
    at = table
    for part in path:
        at = at[int(part)] if part.isdigit() else at[part]
    at[last] = value
    return text[:begin] + json.dumps(table).replace('"', "&quot;") + text[end:]


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("dry_friction.elbow_joint.lugre", [1.0], "at least 3 items"),
        ("dry_friction.elbow_joint.lugre", [1.0, float("nan"), 1.0], "must be finite"),
        ("dry_friction", {"nowhere": None}, "dry_friction.nowhere"),
        ("effects.0.form", "quantum", "should be 'native'"),
        ("effects.0.joint", "nowhere", "no joint is named 'nowhere'"),
        ("effects.0.joint", None, "a joint is needed"),
        ("effects", {}, "valid list"),
        ("joints", [], "at least 1 item"),
        ("effects.0.parameters", {"coulomb": -5.0}, "must lie between"),
        ("effects.0.parameters", {"coulomb": "5"}, "valid number"),
    ],
)
def test_a_table_that_cannot_be_is_refused_as_it_is_loaded(tmp_path, quiet_ur10e, key, value, message):
    arm = with_effect(quiet_ur10e, ArmEffect("presliding_friction", "elbow_joint", {"stiffness": 3000.0}))
    assert arm.effects[0].effect == "coulomb_friction"
    (tmp_path / "other.xml").write_text(table_with(exported_model(arm).text, key, value))
    with pytest.raises(ConfigError, match="export the arm again") as error:
        calib.mujoco.load(tmp_path / "other.xml")
    assert message in str(error.value)


def test_a_joint_stands_under_a_load_below_its_dry_friction(quiet_ur10e):
    """On bristles without damping it would vibrate at 3 to 11 mrad/s and creep at 1 mrad/s."""
    for name, dose in (
        ("stribeck_friction", {"stiction_excess": 4.0, "stribeck_velocity": 0.05}),
        ("load_dependent_friction", {"coefficient": 0.1}),
        ("thermal_friction", {"relative_drop": 0.4, "time_constant": 20.0}),
    ):
        arm = with_effect(quiet_ur10e, ArmEffect(name, "elbow_joint", dose))
        with calib.mujoco.paused():
            model = compiled(exported_model(arm).text, arm.model_path.parent)
        calib.mujoco.install()
        model.opt.gravity[:] = 0.0
        data, joint = mujoco.MjData(model), model.joint("elbow_joint")
        data.ctrl[2] = 4.0  # of 9.5 N m
        mujoco.mj_step(model, data, 1000)
        before = data.joint("elbow_joint").qpos[0]
        fastest = 0.0
        for _ in range(500):
            mujoco.mj_step(model, data)
            fastest = max(fastest, abs(data.qvel[joint.dofadr[0]]))
        assert abs(data.joint("elbow_joint").qpos[0] - before) < 2e-5, name
        assert fastest < 1e-4, name


def scene_of(text: str, *prefixes: str) -> mujoco.MjModel:
    """A scene with the model attached once for each prefix."""
    scene = mujoco.MjSpec()
    scene.option.timestep, scene.option.integrator = 0.001, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    for k, prefix in enumerate(prefixes):
        place = scene.worldbody.add_frame(pos=[0.0, 3.0 * k, 0.0])
        scene.attach(mujoco.MjSpec.from_string(text), frame=place, prefix=prefix)
    with calib.mujoco.paused():
        return scene.compile()


def test_each_arm_of_a_scene_has_its_effects(quiet_ur10e):
    warm = ArmEffect("thermal_friction", "elbow_joint", {"relative_drop": 0.5, "time_constant": 5.0})
    text = exported_model(with_effect(with_effect(quiet_ur10e, warm), ArmEffect("torque_gain", JOINT, {"gain": 1.2}))).text
    model = scene_of(text, "left/", "right_")
    calib.mujoco.install()
    data = mujoco.MjData(model)
    data.ctrl[:] = np.arange(4.0, 52.0, 4.0)
    data.time = 1e3
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(calib.mujoco.read(model, data, "left/").tau, [4, 9.6, 12, 16, 20, 24])
    np.testing.assert_allclose(calib.mujoco.read(model, data, "right_").tau, [28, 38.4, 36, 40, 44, 48])
    for prefix in ("left/", "right_"):
        dry = model.actuator(f"{prefix}calib_dry_friction_elbow_joint")
        assert dry.biasprm[3] == pytest.approx(0.5 * quiet_ur10e.tree.frictionloss[2])
    for other in (None, "middle/"):
        with pytest.raises(ConfigError, match=r"left/.*right_"):
            calib.mujoco.read(model, data, other)


def test_models_that_differ_in_names_alone_are_kept_apart(quiet_ur10e):
    push = ArmEffect(
        "external_contact", None, {"start": 0.0, "duration": 2.0, "force_x": 0.0, "force_y": 400.0, "force_z": 0.0}
    )
    text = exported_model(with_effect(quiet_ur10e, push)).text
    models = [scene_of(text, prefix) for prefix in ("r1_", "r2_")]
    renamed = compiled(text.replace(f'"{TABLE}"', '"effects_of_calib"'), quiet_ur10e.model_path.parent)
    ours = compiled(text, quiet_ur10e.model_path.parent)
    calib.mujoco.install()
    speeds = []
    for model in (*models, renamed, ours):
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data, 300)
        speeds.append(data.qvel[0])
    assert speeds[0] == speeds[1]
    assert abs(speeds[2]) < 0.5 * abs(speeds[3])
    assert calib.mujoco.read(ours, mujoco.MjData(ours)).q.shape == (6,)


def test_a_delay_is_kept_at_a_shorter_step(quiet_ur10e):
    text = exported_model(with_effect(quiet_ur10e, ArmEffect("time_delay", None, {"delay": 0.006}))).text
    model = compiled(text, quiet_ur10e.model_path.parent)
    for step in (1e-3, 2.5e-4):
        model.opt.timestep = step
        data = mujoco.MjData(model)
        for _ in range(round(0.05 / step)):
            data.ctrl[0] = 100.0 * data.time
            mujoco.mj_step(model, data)
        assert calib.mujoco.read(model, data).tau[0] == pytest.approx(100.0 * (0.05 - step - 0.006), abs=1e-6)
    model.opt.timestep = 1e-5
    with pytest.raises(ConfigError, match="too short for the delay"):
        calib.mujoco.read(model, mujoco.MjData(model))


def test_a_drive_that_gives_nothing_compiles(quiet_ur10e):
    text = exported_model(with_effect(quiet_ur10e, ArmEffect("torque_saturation", JOINT, {"limit": 0.0}))).text
    model = compiled(text, quiet_ur10e.model_path.parent)
    assert 0 < model.actuator_forcerange[1, 1] < 1e-6


def test_a_saturated_drive_limits_the_effort(tmp_path):
    arm = with_effect(load_arm("ur10e"), ArmEffect("torque_saturation", "elbow_joint", {"limit": 60.0}))
    export(arm, tmp_path, ["urdf", "isaaclab"])
    text = (tmp_path / "ur10e.urdf").read_text()
    assert pin.buildModelFromXML(text).effortLimit[2] == 60.0
    assert "torque_saturation" not in text
    given = json.loads((tmp_path / "ur10e_isaaclab.json").read_text())
    assert given["actuator"]["effort_limit_sim"]["elbow_joint"] == 60.0
    assert given["actuator"]["effort_limit_sim"]["wrist_1_joint"] == arm.tau_max[3]
    assert all(row["effect"] != "torque_saturation" for row in given["left_out"])
