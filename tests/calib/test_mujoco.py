"""The exported MuJoCo model moves like `sim.plant` for every effect, and `calib.mujoco` leaves other models alone."""

import json

import mujoco
import numpy as np
import pytest

import calib.mujoco
from benchmarks.exported import DOSES, ExportedPlant, Run, difference, doses, ran
from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.effects import EFFECTS, with_effect
from sim.errors import ConfigError
from sim.export import export
from sim.model import compiled
from sim.mujoco_export import TABLE, exported_model
from sim.plant import Plant

JOINT = "shoulder_lift_joint"
# Dry friction of plain MuJoCo is a step, while the catalogue's law, which LuGre follows, builds up over 0.1 mrad.
REVERSALS = ("stribeck_friction", "load_dependent_friction", "thermal_friction")

CASES = list(doses())
SECONDS = 2.5  # of the benchmark's five, enough for each dose to act; effects that show at reversals run all five


pytestmark = pytest.mark.usefixtures("no_callback_left")


@pytest.fixture(scope="module")
def without(quiet_ur10e) -> Run:
    found = ran(ExportedPlant(quiet_ur10e, quiet_ur10e))
    mujoco.set_mjcb_passive(None)
    return found


def item_of(effect, dose):
    return ArmEffect(effect.name, JOINT if effect.scope == "joint" else None, dose)


@pytest.mark.parametrize(("effect", "dose"), CASES, ids=[e.name for e, _ in CASES])
def test_the_exported_arm_moves_as_the_plant_does(effect, dose, quiet_ur10e, without):
    """Same drive: motion within 1 %, torque within 0.5 % except at reversals, much closer than the arm without the effect."""
    truth = with_effect(quiet_ur10e, item_of(effect, dose))
    seconds = 2 * SECONDS if effect.name in REVERSALS else SECONDS
    real = ran(Plant(truth, quiet_ur10e), seconds)
    motion, torque = difference(real, ran(ExportedPlant(truth, quiet_ur10e), seconds))
    _, torque_without = difference(real, Run(*(x[: len(real.q)] for x in (without.q, without.reading, without.tau))))
    assert motion < 1e-2
    assert torque < (6e-2 if effect.name in REVERSALS else 5e-3)
    assert torque_without > 1.5 * torque
    assert torque_without > 1e-2


def test_every_effect_has_a_form_and_a_dose(quiet_ur10e):
    assert {e.name for e in EFFECTS} <= set(DOSES)
    forms = {}
    for effect, dose in doses():
        item = item_of(effect, dose)
        table = exported_model(with_effect(quiet_ur10e, item)).table
        mine = [r["form"] for r in table["effects"] if (r["effect"], r["joint"]) == (item.effect, item.joint)]
        forms.setdefault(mine[0] if mine else "bodies", set()).add(effect.name)
    assert forms["callback"] == {
        "load_dependent_friction", "thermal_friction", "external_contact", "nonlinear_viscous_friction", "friction_law",
    }  # fmt: skip
    assert forms["sensor"] == {"torque_gain", "torque_offset", "time_delay", "encoder_offset", "encoder_eccentricity"}
    assert forms["bodies"] == {"payload", "link_inertia", "base_tilt"}


def test_ctrl_stays_as_long_as_the_arm_has_motors(quiet_ur10e):
    arm = quiet_ur10e
    for effect, dose in doses():
        arm = with_effect(arm, item_of(effect, dose))
    model = compiled(exported_model(arm).text, arm.model_path.parent)
    assert model.nu == arm.n
    rows = exported_model(arm).table["effects"]
    assert [(r["effect"], r["how"]) for r in rows if r["form"] == "none"] == [("joint_elasticity", "")]
    assert [model.joint(model.actuator_trnid[k, 0]).name for k in range(model.nu)] == list(arm.joint_names)


def test_an_exported_file_loads_and_reads(tmp_path, quiet_ur10e):
    gain = ArmEffect("torque_gain", JOINT, {"gain": 1.2})
    thermal = ArmEffect("thermal_friction", "elbow_joint", {"relative_drop": 0.5, "time_constant": 5.0})
    arm = write_arm(tmp_path / "arm", quiet_ur10e, effects=[gain, thermal])
    files = export(arm, tmp_path / "out", ["mjcf"])
    table = json.loads(files[-1].read_text())
    assert {r["effect"]: r["form"] for r in table["effects"]} | {"torque_gain": "sensor", "thermal_friction": "callback"} == {
        r["effect"]: r["form"] for r in table["effects"]
    }
    model = calib.mujoco.load(files[0])
    data = mujoco.MjData(model)
    data.ctrl[:] = 10.0
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(calib.mujoco.read(model, data).tau, [10, 12, 10, 10, 10, 10])
    data.time = 1e3  # warm
    mujoco.mj_step(model, data)
    dry = model.actuator("calib_dry_friction_elbow_joint")
    assert dry.biasprm[3] == pytest.approx(0.5 * arm.tree.frictionloss[2])


def test_other_models_and_callbacks_are_left_alone(quiet_ur10e):
    plain = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    data, calls = mujoco.MjData(plain), []
    mujoco.set_mjcb_passive(lambda model, data: calls.append(model))
    calib.mujoco.install()
    calib.mujoco.install()
    mujoco.mj_step(plain, data)
    assert len(calls) == 1
    assert np.all(data.qfrc_passive == 0)
    with pytest.raises(ConfigError, match="calib_effects"):
        calib.mujoco.read(plain, data)
    assert compiled("<mujoco/>", quiet_ur10e.model_path.parent).nv == 0  # although the callback is installed


def test_a_model_that_export_did_not_write_is_refused(tmp_path, quiet_ur10e):
    (tmp_path / "plain.xml").write_text("<mujoco/>")
    with pytest.raises(ConfigError, match="calib export"):
        calib.mujoco.load(tmp_path / "plain.xml")
    text = exported_model(quiet_ur10e).text
    for old, new in (("effects/2", "effects/9"), ("coulomb_friction", "coulomb_fiction"), ("17.0", "1e999")):
        (tmp_path / "broken.xml").write_text(text.replace(f"{old}", new))
        with pytest.raises(ConfigError):
            calib.mujoco.load(tmp_path / "broken.xml")
    assert TABLE in text


def test_a_soft_joint_collides_with_nothing_new(quiet_ur10e):
    """The motor-side body lies between a link and the body that carries it. MuJoCo must not report contacts with it."""
    soft = with_effect(quiet_ur10e, ArmEffect("joint_elasticity", "elbow_joint", {"stiffness": 5000.0}))
    q = np.array([0.2, -1.6, 1.0, -1.3, -1.2, 0.3])

    def contacts(arm):
        model = compiled(exported_model(arm).text, arm.model_path.parent)
        data = mujoco.MjData(model)
        for name, angle in zip(arm.joint_names, q, strict=True):
            data.joint(name).qpos[0] = angle
        mujoco.mj_forward(model, data)
        return data.ncon

    assert contacts(soft) == contacts(quiet_ur10e)


def test_a_gap_is_in_radians_whatever_the_models_unit(tmp_path):
    inertial = '<inertial mass="1" pos="0.1 0 0" diaginertia="0.01 0.01 0.01"/>'
    (tmp_path / "one.xml").write_text(
        f"""<mujoco model="one"><compiler angle="degree"/><default><joint damping="2" armature="0.1"/></default><worldbody>
        <frame pos="0 0 1"><body name="rod"><joint name="hinge" axis="0 1 0" range="-90 90"/>{inertial}
        <body name="tip" pos="0.5 0 0"><joint name="slide" type="slide" axis="1 0 0" range="-0.1 0.1"/>{inertial}</body></body></frame>
        </worldbody></mujoco>"""
    )
    arm = load_arm(tmp_path / "one.xml")
    for joint in arm.joint_names:
        model = compiled(exported_model(with_effect(arm, ArmEffect("backlash", joint, {"half_gap": 0.01}))).text, tmp_path)
        np.testing.assert_allclose(model.joint(f"{joint}:twist").range, [-0.01, 0.01])
        assert model.joint(f"{joint}:twist").damping[0] == pytest.approx(0.02)
        assert model.joint(joint).damping[0] == 2.0
