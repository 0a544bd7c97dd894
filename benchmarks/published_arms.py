"""The published arms that are tried, and the facts given because their models do not have them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from sim.arm import load_arm
from sim.usual_arm import COULOMB, INERTIA, VISCOUS

# m from base to floor, for arms whose file begins at the shoulder or the trunk
FLOOR = {"talos_left": -1.2, "alex_left": -1.2}
# name -> file in the wheel, and options that select the arm
ARMS: dict[str, tuple[str, list[str]]] = {
    "panda": ("panda_description/urdf/panda.urdf", ["--tool", "panda_hand"]),
    "panda_capsules": ("panda_description/urdf/panda_collision.urdf", ["--tool", "panda_hand"]),
    "so100": ("so_arm_description/urdf/so100.urdf", []),
    "so101": ("so_arm_description/urdf/so101.urdf", []),
    "z1": ("z1_description/urdf/z1.urdf", []),
    "z1_on_b1": ("b1_description/urdf/b1-z1.urdf", ["--joints", "joint?"]),
    "talos_left": ("talos_data/robots/talos_left_arm.urdf", []),
    "talos_right": ("talos_data/robots/talos_reduced.urdf", ["--tool", "arm_right_7_link"]),
    "tiago": ("tiago_description/robots/tiago.urdf", ["--tool", "arm_7_link"]),
    "tiago_no_hand": ("tiago_description/robots/tiago_no_hand.urdf", ["--tool", "arm_tool_link"]),
    "tiago_dual_left": ("tiago_description/robots/tiago_dual.urdf", ["--tool", "arm_left_7_link"]),
    "tiago_pro_left": ("tiago_pro_description/robots/tiago_pro.urdf", ["--tool", "arm_left_7_link"]),
    "baxter_left": ("baxter_description/urdf/baxter.urdf", ["--tool", "left_hand_link"]),
    "baxter_right": ("baxter_description/urdf/baxter.urdf", ["--tool", "right_hand_link"]),
    "centauro_left": ("centauro_description/urdf/centauro.urdf", ["--joints", "j_arm1_?"]),
    "kinova_j2s6s200": ("kinova_description/robots/kinova.urdf", []),
    "kinova_on_anymal": ("anymal_b_simple_description/robots/anymal-kinova.urdf", ["--joints", "j2s6s200_joint_?"]),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", []),
    "ur3_gripper": ("ur_description/urdf/ur3_gripper.urdf", []),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", []),
    "ur5_gripper": ("ur_description/urdf/ur5_gripper.urdf", []),
    "ur10_limited": ("ur_description/urdf/ur10_joint_limited_robot.urdf", []),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", []),
    "pr2_right": ("pr2_description/urdf/pr2.urdf", ["--tool", "r_wrist_roll_link", "--lock", "torso_lift_joint"]),
    "romeo_right": ("romeo_description/urdf/romeo.urdf", ["--tool", "r_wrist", "--lock", "TrunkYaw"]),
    "icub_right": ("icub_description/robots/icub.urdf", ["--tool", "r_hand", "--lock", "torso_*"]),
    "alex_left": ("alex_description/urdf/alex_nub_hands.urdf", ["--tool", "LeftGripperYawLink", "--lock", "Spine*"]),
    "g1_left": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", ["--tool", "left_rubber_hand", "--lock", "waist_*"]),
    "double_pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", []),
}
# name -> what a message asks for -> the options that state it, as an owner knows them from the data sheet
FACTS: dict[str, dict[str, list[str]]] = {
    "kinova_j2s6s200": {
        "missing: q_min, q_max": [
            "--limit", "q_min=-6.28,0.8204,0.3317,-6.28,0.5236,-6.28", "--limit", "q_max=6.28,5.4628,5.9515,6.28,5.7595,6.28",
        ],
    },
    "pr2_right": {
        "--numbers guessed": ["--numbers", "guessed"],
        # the counterbalance in the shoulder, which balances the arm: mid-range it matches the gravity torque of the file's
        # masses
        "if a spring or a counterbalance carries them": ["--spring", "r_shoulder_lift_joint=3,-12.5"],
        # forearm and wrist turn without limit
        "missing: q_min, q_max": [
            "--limit", "q_min=-2.285,-0.523,-3.9,-2.321,-6.28,-2.094,-6.28", "--limit", "q_max=0.714,1.396,0.8,0,6.28,0,6.28",
        ],
    },
    # speeds that their owners allow
    "alex_left": {"limits.dq_max = 25": ["--limit", "dq_max=6"]},
    "g1_left": {"limits.dq_max = 37": ["--limit", "dq_max=6"]},
    "icub_right": {"limits.dq_max = 100": ["--limit", "dq_max=2"]},
    "double_pendulum": {
        "missing: q_min, q_max, dq_max, tau_max": [
            "--limit", "q_min=-6.28", "--limit", "q_max=6.28", "--limit", "dq_max=6", "--limit", "tau_max=5",
        ],
    },
}  # fmt: skip
# name of a fact in the table, where the message that asked for it does not name it
GIVEN = {
    "--numbers guessed": "that its masses are guessed",
    "if a spring or a counterbalance carries them": "the counterbalance of its shoulder",
    "limits.dq_max = 25": "a lower dq_max",
    "limits.dq_max = 37": "a lower dq_max",
    "limits.dq_max = 100": "a lower dq_max",
}
# ordinary drive, as shares of tau_max: dry friction, viscous friction at full speed, reflected inertia at ddq_max
DRIVES = ("state them (`calib arm new --drive`)", {"coulomb": COULOMB, "viscous": VISCOUS, "inertia": INERTIA})
SHEET = ["--limit", "ddq_max=5", "--limit", "jerk_max=100"]
CELL = 'schema = "cell/1"\nname = "{name}"\narm = "{arm}"\ndriver = "mock"\nhome = {home}\n'


def cell_text(name: str, arm: Path) -> str:
    """A mock cell of the arm, with the plane that `calib plan` assumes without a cell, and a home from which it can move."""
    import numpy as np

    from calib.excitation.home import home_of, open_cell
    from calib.excitation.room import Room

    model = load_arm(arm)
    cell = open_cell(model)
    plane = cell.table.obstacles[0]
    if name in FLOOR:
        plane = plane.model_copy(update={"position": (0.0, 0.0, FLOOR[name])})
        cell = replace(cell, table=cell.table.model_copy(update={"obstacles": [plane]}))
    home = home_of(Room(model, cell), cell, None, np.random.default_rng(0))
    where = f'[[obstacles]]\nkind = "plane"\nname = "floor"\nposition = {list(plane.position)}\nnormal = [0.0, 0.0, 1.0]\n'
    return CELL.format(name=name, arm=arm, home=[round(float(x), 6) for x in home]) + where
