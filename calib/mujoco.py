"""Effects of an exported model beyond plain MuJoCo: friction that depends on load or temperature, powers of speed, contacts, readings.

    import calib.mujoco
    model = calib.mujoco.load("exported/ur10e.xml")   # or an arm: "ur10e", "runs/real/arm"
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)                       # with every effect of the arm
    calib.mujoco.read(model, data).tau                # as the drives report it

The law of an effect is defined in its file of the catalogue; here it is evaluated at the current instant, as MuJoCo's passive force.
There is one callback per process. It acts only on models that `calib export` wrote, and a callback that was set before keeps running.
While it is set, MuJoCo compiles no other model (google-deepmind/mujoco#1376): compile it before, or in `with calib.mujoco.paused():`.
`mujoco.batch` and MJX run no callbacks: there a model has only its native elements.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import mujoco

from sim.arm import load_arm
from sim.errors import ConfigError
from sim.exported import ExportedArm, Reading
from sim.exported_table import TABLE
from sim.files import as_text, read_bytes
from sim.model import MAX_MESH, compiled
from sim.model import no_callback as paused
from sim.mujoco_export import exported_model

__all__ = ["Reading", "install", "load", "paused", "read"]
Passive = Callable[[mujoco.MjModel, mujoco.MjData], None]


def load(arm: str | Path, configs: Path | None = None) -> mujoco.MjModel:
    """The MuJoCo model of an exported .xml file, or of an arm (a name, a folder), with the callback installed.

    ConfigError if the file was not written by `calib export`.
    """
    path = Path(arm)
    if path.suffix == ".xml":
        text = as_text(read_bytes(path, MAX_MESH), path)
        model = compiled(text, path.parent, str(path))
    else:
        found = load_arm(arm, configs)
        model = compiled(exported_model(found).text, found.model_path.parent, found.name)
    if not ExportedArm.all_of(model):
        raise ConfigError(f"{path}: has no <custom> text {TABLE}, so its effects are unknown; write it with `calib export`")
    install()
    return model


def install() -> None:
    """Set MuJoCo's passive-force callback; a callback that is already set keeps running before it."""
    before = mujoco.get_mjcb_passive()
    if not isinstance(before, _Callback):
        mujoco.set_mjcb_passive(_Callback(before))


def read(model: mujoco.MjModel, data: mujoco.MjData, arm: str | None = None) -> Reading:
    """The state as encoders and drives would report it; torque of the last evaluation, which mj_step makes at the start of a step.

    arm: the prefix (or suffix) with which it was attached, if a model has several. ConfigError if there is no such arm, or if the step is
    so short that the delay of the torque channel exceeds the sensors' buffer.
    """
    arms = ExportedArm.all_of(model)
    if not arms:
        raise ConfigError(
            f"this model has no <custom> text {TABLE}; write it with `calib export`, or load it with calib.mujoco.load"
        )
    if (arm is None and len(arms) > 1) or (arm is not None and arm not in arms):
        raise ConfigError(
            f"{f'no arm is attached with {arm!r}' if arm else 'the model has several arms'}; give one of {sorted(arms)}"
        )
    one = arms[next(iter(arms)) if arm is None else arm]
    if model.opt.timestep < (1 - 1e-9) * one.least_step:
        raise ConfigError(
            f"the step of {model.opt.timestep:g} s is too short for the delay of the torque readings: the model buffers enough for steps of "
            f"{one.least_step:g} s or more; raise nsample of its sensors"
        )
    return one.reading(data)


class _Callback:
    """MuJoCo's passive-force callback: first the one that was set before, then the effects of the model, if any."""

    def __init__(self, before: Passive | None) -> None:
        self.before = before

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if self.before is not None:
            self.before(model, data)
        for arm in ExportedArm.all_of(model).values():
            if arm.acts:
                arm.add_forces(model, data)
