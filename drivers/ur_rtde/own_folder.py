"""Arm folder of one robot: the cell's arm with the kinematics and limits that its controller holds."""

from __future__ import annotations

import shutil
import tempfile
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.driver import Check
from drivers.ur_rtde.family import FAMILY, member
from drivers.ur_rtde.primary import OwnArm
from sim.arm import Arm, load_arm
from sim.arm_folder import arm_toml_text
from sim.arm_table import ArmTable
from sim.dh import joint_frames
from sim.errors import ConfigError
from sim.files import write_atomically
from sim.mjcf import numbers

CALIBRATION_MAX = (
    0.005  # m; a robot's calibration moves a joint by tenths of a millimetre, another arm's joints are centimetres away
)


def origins(arm: Arm) -> np.ndarray:
    """Joint positions of a serial arm in the base frame at q = 0, (n, 3) m."""
    return _chain(np.array([_homogeneous(r, p) for r, p in zip(arm.tree.rotation, arm.tree.position, strict=True)]))


def moved(arm: Arm, own: OwnArm) -> np.ndarray:
    """Distance of each joint of the controller's arm from that of the model at q = 0, (n,) m."""
    nominal = origins(arm)
    return np.linalg.norm(_chain(joint_frames(own.kinematics, nominal)) - nominal, axis=1)


def kinematics(arm: Arm, own: OwnArm) -> Check:
    """Check that the kinematics that the controller holds are those of the arm, up to a calibration."""
    far = float(np.max(moved(arm, own)))
    if far <= CALIBRATION_MAX:
        return Check("kinematics", True, f"the controller's own kinematics are within {1e3 * far:.2f} mm of the model's")
    like = [name for name in FAMILY if float(np.max(moved(load_arm(name), own))) <= CALIBRATION_MAX]
    looks = f"this looks like a {' or '.join(like)}: set arm in the cell file" if like else "check which arm this is"
    return Check("kinematics", False, f"a joint is {1e3 * far:.1f} mm away from where the model has it", looks, "arm-as-stated")


def write_own(folder: Path, arm: Arm, own: OwnArm, serial: str) -> Arm:
    """Write the arm to a new folder and return it as loaded: joints as in the controller, limits no wider than the controller's.

    ConfigError if the folder exists, or the arm is not one of the family with an MJCF of six joints.
    """
    if folder.exists():
        raise ConfigError(f"{folder} exists; remove it first, or give another --out")
    source = arm.model_path.parent
    if arm.model_path.suffix != ".xml" or not (source / "arm.toml").is_file() or member(arm) is None:
        raise ConfigError(
            f"{arm.model_path}: only an arm folder of the family, with model.xml, can take a controller's kinematics"
        )
    frames = joint_frames(own.kinematics, origins(arm))
    root = ElementTree.fromstring(arm.model_text, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    bodies = [body for world in root.findall("worldbody") for body in world.iter("body") if body.find("joint") is not None]
    if len(bodies) != len(frames):
        raise ConfigError(f"{arm.model_path}: has {len(bodies)} bodies with a joint, the controller {len(frames)}")
    for body, frame in zip(bodies, frames, strict=True):
        for key in ("euler", "axisangle", "xyaxes", "zaxis"):
            body.attrib.pop(key, None)
        x, y, z, w = Rotation.from_matrix(frame[:3, :3]).as_quat()
        body.set("pos", numbers(frame[:3, 3]))
        body.set("quat", numbers((w, x, y, z)))
    data = tomllib.loads((source / "arm.toml").read_text(encoding="utf-8"))
    data["name"] = folder.name
    limits = data["limits"]
    limits["q_min"] = np.maximum(arm.q_min, own.q_min).tolist()
    limits["q_max"] = np.minimum(arm.q_max, own.q_max).tolist()
    limits["dq_max"] = np.minimum(arm.dq_max, own.dq_max).tolist()
    data["provenance"] |= {
        "kinematics": f"read from the controller of robot {serial}, its own calibration {own.checksum}",
        "limits of the controller": "q_min, q_max and dq_max are no wider than its configuration data",
    }
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        shutil.copytree(source, draft, dirs_exist_ok=True)
        write_atomically(draft / "model.xml", ElementTree.tostring(root, encoding="unicode") + "\n")
        write_atomically(draft / "arm.toml", arm_toml_text(ArmTable.model_validate(data)))
        load_arm(draft)
        draft.chmod(0o755)
        draft.rename(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return load_arm(folder)


def _homogeneous(rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation, position
    return frame


def _chain(frames: np.ndarray) -> np.ndarray:
    world, found = np.eye(4), []
    for frame in frames:
        world = world @ frame
        found.append(world[:3, 3])
    return np.array(found)
