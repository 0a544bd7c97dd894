"""A second payload on an arm that has one."""

import numpy as np
import pytest

from sim.arm import ArmEffect, load_arm
from sim.arm_folder import write_arm
from sim.mjcf_edit import mounted


@pytest.mark.parametrize("second", [(0.7, 0.0, 0.021, 0.08), (1.5, 0.05, -0.01, 0.1), (0.3, 0.1, 0.1, 0.0)])
def test_a_second_payload_stands_beside_the_first(second, tmp_path):
    """Two point masses have no moment of inertia about their line, which MuJoCo accepts only as a principal moment."""
    arm, names = load_arm("ur10e"), ("mass", "com_x", "com_y", "com_z")
    points = [(0.7, 0.0, 0.02, 0.08), second]
    items = [ArmEffect("payload", None, dict(zip(names, point, strict=True))) for point in points]
    one = write_arm(tmp_path / "one", arm, effects=items[:1])
    both = write_arm(tmp_path / "both", one, effects=items[1:])
    together = write_arm(tmp_path / "together", arm, effects=items)
    np.testing.assert_allclose(both.tree.inertia[-1], together.tree.inertia[-1], atol=1e-12)
    mass, com, _ = mounted(both.model_text)
    assert mass == pytest.approx(points[0][0] + points[1][0])
    np.testing.assert_allclose(com, sum(p[0] * np.array(p[1:]) for p in points) / mass)
