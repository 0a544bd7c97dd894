"""The flange of an arm: the site `attachment_site` on its last link, as in the MuJoCo Menagerie, or else the last link's origin."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from sim.arm import Arm
from sim.model import compiled

FLANGE = "attachment_site"


def flange_of(arm: Arm) -> tuple[np.ndarray, np.ndarray, str]:
    """Position (3,) and axes (3, 3) of the flange in the last link's frame, and what it was taken from."""
    found = _site(arm.model_text, arm.model_path.parent, arm.name, arm.n - 1)
    if found is None:
        return np.zeros(3), np.eye(3), f"last link {arm.tree.link_names[-1]}"
    position, quaternion = np.array(found[:3]), np.array(found[3:])
    return position, Rotation.from_quat(quaternion, scalar_first=True).as_matrix(), f"site {FLANGE}"


@lru_cache(maxsize=32)
def _site(text: str, folder: Path, name: str, last: int) -> tuple[float, ...] | None:
    """Position and quaternion of the site in the frame of joint `last`; None if its body has no such site."""
    model = compiled(text, folder, name)
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, FLANGE)
    if site < 0 or model.site_bodyid[site] != model.jnt_bodyid[last]:
        return None
    return *(model.site_pos[site] - model.jnt_pos[last]).tolist(), *model.site_quat[site].tolist()
