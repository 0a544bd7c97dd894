"""What an exported model needs beyond plain MuJoCo: friction that follows load or warmth, powers of the speed, contacts, and readings.

    import calib.mujoco
    model = calib.mujoco.load("exported/ur10e.xml")   # or an arm: "ur10e", "runs/real/arm"
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)                       # with every effect of the arm
    calib.mujoco.read(model, data).tau                # as the drives report it

The law of an effect stands in its file of the catalogue; here it is applied at the present instant, as MuJoCo's passive force. The
callback is one for the process, acts on models that `calib export` wrote, and leaves every other model, and a callback that was
there before, as they are. While it is set MuJoCo itself compiles no other model (google-deepmind/mujoco#1376): compile them before,
or `with calib.mujoco.paused():`. `mujoco.batch` and MJX run no callbacks: there a model has its native elements only.
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
    """The MuJoCo model of an exported .xml file, or of an arm (a name, a folder), with the callback in place.

    ConfigError where the file was not written by `calib export`.
    """
    path = Path(arm)
    if path.suffix == ".xml":
        text = as_text(read_bytes(path, MAX_MESH), path)
        model = compiled(text, path.parent, str(path))
    else:
        found = load_arm(arm, configs)
        model = compiled(exported_model(found).text, found.model_path.parent, found.name)
    if not ExportedArm.all_of(model):
        raise ConfigError(f"{path}: has no <custom> text {TABLE}, so no effects are known of it; write it with `calib export`")
    install()
    return model


def install() -> None:
    """Set MuJoCo's passive-force callback; a callback that is there already keeps running before it."""
    before = mujoco.get_mjcb_passive()
    if not isinstance(before, _Callback):
        mujoco.set_mjcb_passive(_Callback(before))


def read(model: mujoco.MjModel, data: mujoco.MjData, arm: str | None = None) -> Reading:
    """The state as encoders and drives would report it; torque as of the last evaluation, which mj_step made at the step's begin.

    arm: the prefix (or suffix) with which it was attached, where a model has several. ConfigError where there is none such, or the step is so
    short that the delay of the torque channel is longer than the sensors' memory.
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
            f"the step of {model.opt.timestep:g} s is too short for the delay of the torque readings: the model keeps enough for steps of "
            f"{one.least_step:g} s and more; raise nsample of its sensors"
        )
    return one.reading(data)


class _Callback:
    """MuJoCo's passive-force callback: first the one that was there, then the effects of the model, where it has any."""

    def __init__(self, before: Passive | None) -> None:
        self.before = before

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if self.before is not None:
            self.before(model, data)
        for arm in ExportedArm.all_of(model).values():
            if arm.acts:
                arm.add_forces(model, data)
