"""Write configs/arms/<name>/ from the one table of published numbers, configs/published.toml.

    python configs/generate_arms.py            # writes next to itself
    python configs/generate_arms.py FOLDER     # writes somewhere else

The frames are those of ur_description: every joint turns about its local z axis, and the base frame is the controller's own
base frame ("base" in ur_description, which is turned by pi about z against "base_link").
"""

from __future__ import annotations

import argparse
import math
import sys
import tomllib
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from sim.arm import ArmTable
from sim.arm_folder import arm_toml_text, write_atomically

HERE = Path(__file__).resolve().parent
LINKS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
BODIES = ("shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")
X90, X_90 = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
# DH axes -> axes of the ur_description link frame (the `rotation` rows of physical_parameters.yaml)
FROM_DH = (X90, np.eye(3), np.eye(3), X90, X_90, np.eye(3))
HALF = math.sqrt(0.5)
IDENTITY, X_PLUS, X_MINUS = (1.0, 0.0, 0.0, 0.0), (HALF, HALF, 0.0, 0.0), (HALF, -HALF, 0.0, 0.0)

# Dry friction N m, viscous friction N m s/rad and rotor inertia kg m^2 (joint side) of a UR10e's six joints: generic values of
# the size that identification papers report for this arm. Nobody publishes them; they are a start, and `calib identify` replaces them.
UR10E = {
    "tau_max": (330, 330, 150, 54, 54, 54),
    "coulomb": (17, 19, 9.5, 2.6, 2.4, 2.2),
    "viscous": (16, 18, 9, 2, 1.9, 1.6),
    "rotor": (6, 6.5, 3.2, 0.55, 0.5, 0.45),
    "torque_noise": (2.2, 2.9, 1.6, 0.4, 0.45, 0.3),
}
UR_DDQ_MAX, JERK_TIME = 5.0, 0.05
UR_PRIOR = {"mass": 0.02, "com": 0.02, "inertia": 0.1, "coulomb": 0.5, "viscous": 0.5, "rotor": 0.5}


def estimate(arm: dict, key: str) -> list[float]:
    """`key` of each joint from the UR10e joint of the nearest torque class, in proportion to the rated torque."""
    if key in arm:
        return [float(x) for x in arm[key]]
    values = []
    for j, torque in enumerate(arm["tau_max"]):
        same = [i for i in range(6) if UR10E["tau_max"][i] == torque]
        nearest = min(range(6), key=lambda i: (abs(math.log(UR10E["tau_max"][i] / torque)), abs(i - j)))
        source = j if j in same else nearest
        values.append(_rounded(UR10E[key][source] * torque / UR10E["tau_max"][source]))
    return values


def _rounded(value: float) -> float:
    """Two digits: an estimate does not have more."""
    return float(f"{value:.2g}")


def link_frames(dh: list[float]) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Position m and quaternion of each joint frame in its parent's, as in ur_description's default_kinematics."""
    d1, a2, a3, d4, d5, d6 = dh
    return [((0, 0, d1), IDENTITY), ((0, 0, 0), X_PLUS), ((a2, 0, 0), IDENTITY), ((a3, 0, d4), IDENTITY),
            ((0, -d5, 0), X_PLUS), ((0, d6, 0), X_MINUS)]  # fmt: skip


def inertials(arm: dict) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Mass kg, centre of mass m and inertia about it kg m^2 of each link, in the ur_description link frames."""
    _, a2, a3, *_ = arm["dh"]
    offset = (0.0, a2, a3, 0.0, 0.0, 0.0)
    rows = []
    for j, (mass, com, moments) in enumerate(zip(arm["mass"], arm["com"], arm["inertia"], strict=True)):
        xx, xy, xz, yy, yz, zz = moments
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=float)
        centre = np.array(com, dtype=float)
        if arm["frame"] == "dh":
            rotation = FROM_DH[j]
            tensor = rotation @ tensor @ rotation.T
            centre = rotation @ centre + np.array([offset[j], 0.0, 0.0])
            # the tables have four to six digits: 0.38 - 0.6127 is meant as -0.2327
            centre = np.round(centre, 9)
        rows.append((float(mass), centre + 0.0, tensor + 0.0))
    return rows


def numbers(values) -> str:
    """Full-precision text of a row of numbers."""
    return " ".join(repr(float(v)) if float(v) != int(v) else str(int(v)) for v in values)


def model_xml(name: str, arm: dict) -> str:
    """The arm as MJCF: bodies nested in order, a motor on each joint with its published torque limit."""
    capsules, (radius, height) = arm["capsules"], arm["base_cylinder"]
    lines = [
        f'<mujoco model="{name}">',
        '  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>',
        '  <option jacobian="dense" integrator="implicitfast" timestep="0.001"/>',
        "  <default>",
        # the softest friction constraint that MuJoCo allows at this time step would let a standing joint creep at 5 mrad/s
        '    <joint type="hinge" axis="0 0 1" solreffriction="0.002 1" solimpfriction="0.9999 0.9999 0.001"/>',
        '    <geom type="capsule" group="3" contype="1" conaffinity="1" rgba="0.6 0.6 0.65 1"/>',
        "  </default>",
        "  <worldbody>",
        '    <body name="base">',
        f'      <geom name="base_0" type="cylinder" fromto="{numbers((0, 0, 0, 0, 0, height))}" size="{numbers([radius])}"/>',
    ]
    frames, bodies = link_frames(arm["dh"]), inertials(arm)
    limit = math.radians(360)
    for j, (joint, body) in enumerate(zip(LINKS, BODIES, strict=True)):
        pad = "  " * (j + 3)
        position, quaternion = frames[j]
        mass, com, tensor = bodies[j]
        full = (tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2])
        lines += [
            f'{pad}<body name="{body}" pos="{numbers(position)}" quat="{numbers(quaternion)}">',
            f'{pad}  <inertial mass="{numbers([mass])}" pos="{numbers(com)}" fullinertia="{numbers(full)}"/>',
            f'{pad}  <joint name="{joint}_joint" range="{numbers((-limit, limit))}" '
            f'frictionloss="{numbers([estimate(arm, "coulomb")[j]])}" damping="{numbers([estimate(arm, "viscous")[j]])}" '
            f'armature="{numbers([estimate(arm, "rotor")[j]])}"/>',
            *(f"{pad}  {_geom(body, i, c)}" for i, c in enumerate(capsules[body.removesuffix("_link")])),
        ]
    lines.append("  " * 9 + '<site name="attachment_site"/>')
    lines += ["  " * (j + 2) + "</body>" for j in range(6, -1, -1)]
    lines += [
        "  </worldbody>",
        "  <contact>",
        '    <exclude body1="base" body2="shoulder_link"/>',
        "  </contact>",
        "  <actuator>",
    ]
    for joint, torque in zip(LINKS, arm["tau_max"], strict=True):
        span = numbers((-torque, torque))
        lines.append(f'    <motor name="{joint}" joint="{joint}_joint" ctrlrange="{span}" forcerange="{span}"/>')
    lines += ["  </actuator>", "</mujoco>", ""]
    return "\n".join(lines)


def _geom(body: str, index: int, capsule: list[float]) -> str:
    start, end, radius = capsule[:3], capsule[3:6], capsule[6]
    place = f'type="sphere" pos="{numbers(start)}"' if start == end else f'fromto="{numbers(start + end)}"'
    return f'<geom name="{body.removesuffix("_link")}_{index}" {place} size="{numbers([radius])}"/>'


def arm_table(name: str, arm: dict, sources: dict) -> ArmTable:
    """The arm.toml of an arm, with the provenance of every number in it and in its model."""
    own = arm.get("own", False)
    ddq_max = [float(x) for x in arm.get("ddq_max", [UR_DDQ_MAX] * 6)]
    masses = f"{sources['dh']}; {sources['description']}"

    def cited(key: str, usual: str) -> str:
        return sources["own"] if own else sources[arm[key]] if key in arm else usual

    guess = (
        "nobody publishes friction or rotor inertia: generic estimates of the size that identification papers report for a UR10e"
        + (
            ""
            if name in ("ur10e", "ur12e", "ur16e")
            else "; scaled here from the UR10e joint of the nearest size in proportion to rated torque"
        )
        + "; identify the arm to replace them"
    )
    provenance = {
        "frames": "link frames of ur_description; the base frame is the controller's own ('base', turned by pi about z against 'base_link')",
        "kinematics": cited("kinematics_source", sources["dh"])
        + ("" if own else "; nominal, without the calibration that each controller holds"),
        "mass and centre of mass": cited("mass_source", masses),
        "inertia": cited("inertia_source", "") + "; rotors are not in it",
        "tau_max and dq_max": cited("limits_source", f"{sources['description']}, joint_limits.yaml: the maker's rated maxima"),
        "q_min and q_max": sources["own"] if own else "maker's working range, -360 to 360 deg on every joint; self-collision and cables end it earlier",
        "ddq_max": sources["own"] + "; estimate from torque limit and inertia"
        if own
        else "not published; 5 rad/s^2 as chosen 'conservatively' in ur_moveit_config/config/joint_limits.yaml of "
        "github.com/UniversalRobots/Universal_Robots_ROS2_Driver (commit 5e3c4646); torque is the arm's real limit",
        "jerk_max": "not published; estimate: ddq_max is reached in 0.05 s",
        "coulomb, viscous, rotor inertia": sources["own"] + "; generic values of small geared servos" if own else guess,
        "sensors": "estimate: 16-bit encoder at the joint, noise of small servo drives"
        if own
        else f"rate: RTDE, {arm.get('rate', 500)} Hz; encoder_resolution not published, 20 bits assumed; torque_noise: part above about 20 Hz of the current of "
        "published UR10e recordings times torque constant, scaled by rated torque; velocity_noise from the same recordings",
        "capsules": arm["capsules"]["source"],
    }  # fmt: skip
    if "torque_constant" in arm:
        provenance["torque_constant"] = (
            "N m at the joint per A, by calib identify from published recordings of one UR10e without a load and with the 2.805 kg that its "
            "publishers state (github.com/shamilmamedov/dynamic_calibration); std 0.42 at base and shoulder, 0.34 at the elbow, 0.07 at the "
            "wrists, each group with one kind of drive; other published estimates differ by 10-15 %"
        )
    if name == "ur20":
        provenance["wrist_3"] = "0.926 kg and its centre of mass from the ROS description; the maker's article has 0.846 kg"
    limit = math.radians(360)
    table = {
        "schema": "arm/1", "name": name, "model": "model.xml", "joints": [f"{j}_joint" for j in LINKS],
        "limits": {
            "q_min": [-limit] * 6, "q_max": [limit] * 6, "dq_max": [math.radians(x) for x in arm["dq_max"]],
            "ddq_max": ddq_max, "jerk_max": [x / JERK_TIME for x in ddq_max], "tau_max": [float(x) for x in arm["tau_max"]],
        },
        "sensors": {
            "rate": 200.0 if own else float(arm.get("rate", 500)), "encoder_resolution": 2 * math.pi / 2 ** (16 if own else 20),
            "velocity_noise": [0.005 if own else 0.003] * 6,
            "torque_noise": arm.get("torque_noise") or estimate(arm, "torque_noise"),
        },
        "torque_constant": arm.get("torque_constant"), "prior": {**UR_PRIOR, "inertia": arm.get("prior_inertia", UR_PRIOR["inertia"])},
        "provenance": provenance,
    }  # fmt: skip
    return ArmTable.model_validate(table)


def generate(out: Path) -> None:
    """Write every arm of published.toml to `out`/<name>/."""
    published = tomllib.loads((HERE / "published.toml").read_text(encoding="utf-8"))
    sources = published.pop("sources")
    for name, arm in published.items():
        folder = out / name
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / "model.xml", model_xml(name, arm))
        write_atomically(folder / "arm.toml", arm_toml_text(arm_table(name, arm, sources)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=HERE / "arms")
    generate(parser.parse_args().folder)
