"""Effects that arm.toml lists: payload and base tilt become part of the arm, and every entry must match the catalogue."""

import numpy as np
import pytest

from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.errors import ConfigError
from sim.mujoco_export import exported_model
from sim.rigid_body import RigidBody

BODIES = """
[[effects]]
effect = "{effect}"
parameters = {{ {parameters} }}
"""


@pytest.mark.parametrize(
    "item",
    [
        ArmEffect("payload", None, {"mass": 3.0, "com_x": 0.02, "com_y": 0.01, "com_z": 0.08}),
        ArmEffect("base_tilt", None, {"roll": 0.1, "pitch": -0.2}),
    ],
    ids=lambda e: e.effect,
)
def test_a_body_that_arm_toml_lists_is_part_of_the_arm(item, tmp_path):
    """As if it had been written into the model: same torque and same exported model."""
    meant = write_arm(tmp_path / "meant", load_arm("ur5e"), effects=[item])
    write_arm(tmp_path / "listed", load_arm("ur5e"))
    toml = tmp_path / "listed" / "arm.toml"
    listed = ", ".join(f"{key} = {value}" for key, value in item.parameters.items())
    toml.write_text(toml.read_text() + BODIES.format(effect=item.effect, parameters=listed))
    arm = load_arm(tmp_path / "listed")
    q = np.random.default_rng(2).uniform(-1, 1, (5, 6))
    np.testing.assert_allclose(*(RigidBody(a).inverse_dynamics(q, 0 * q, q) for a in (arm, meant)), atol=1e-12)
    assert exported_model(arm).text == exported_model(meant).text.replace(meant.sha256, arm.sha256)


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ('effect = "torque_ripple"\njoint = "elbow_joint"\nparameters = { amplitude = 1.0 }', "needs exactly"),
        ('effect = "joint_elasticity"\njoint = "elbow_joint"\nparameters = { stiffness = -5.0 }', "must lie between 10 and"),
        ('effect = "torque_ripple"\nparameters = { amplitude = 1.0, cycles = 2.0, phase = 0.0 }', "a joint is needed"),
    ],
)
def test_an_effect_that_the_catalogue_does_not_know_so_is_refused(entry, reason, tmp_path):
    write_arm(tmp_path / "arm", load_arm("ur5e"))
    toml = tmp_path / "arm" / "arm.toml"
    toml.write_text(toml.read_text() + "\n[[effects]]\n" + entry + "\n")
    with pytest.raises(ConfigError, match=reason) as error:
        load_arm(tmp_path / "arm")
    assert "arm.toml: [[effects]]" in str(error.value)
