"""Motions of an arm in MuJoCo's own viewer, if there is a display."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from sim.arm import Arm
from sim.cell import BoxObstacle, MeshObstacle, PlaneObstacle
from sim.errors import ConfigError
from sim.plant import Plant
from sim.trajectory import Trajectory

FRAME = 1 / 60  # s
Launch = Callable[[Any, Any], Any]


def require_display(environment: Mapping[str, str] = os.environ, platform: str = sys.platform) -> None:
    """ConfigError if no window can be opened or MuJoCo's viewer is not installed."""
    if platform == "linux" and not (environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY")):
        raise ConfigError("--viewer: there is no display here (DISPLAY is not set); open plan.html in a browser instead")
    _launch()


def _launch() -> Launch:
    try:
        import mujoco.viewer
    except ImportError as error:
        raise ConfigError(
            f"--viewer: MuJoCo's viewer is not installed ({error}); pip install 'arm-calib[viewer]', or open plan.html in a browser"
        ) from error
    launch: Launch = mujoco.viewer.launch_passive
    return launch


def play(
    arm: Arm,
    obstacles: Iterable[BoxObstacle | PlaneObstacle | MeshObstacle],
    motions: Iterable[Trajectory],
    launch: Launch | None = None,
    now: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Show the motions one after another at their own speed, until the last one ends or the window is closed."""
    plant = Plant(arm, obstacles=list(obstacles))
    with (launch or _launch())(plant.model, plant.data) as window:
        for motion in motions:
            began = now()
            while window.is_running() and (elapsed := now() - began) <= motion.duration:
                plant.reset(np.array([np.interp(motion.t[0] + elapsed, motion.t, motion.q[:, j]) for j in range(arm.n)]))
                window.sync()
                sleep(FRAME)
