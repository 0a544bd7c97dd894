"""The viewer plays each motion in its own time, ends with the motion or its window, and is refused without a display."""

import sys
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest

from sim.arm import load_arm
from sim.errors import ConfigError
from sim.trajectory import Trajectory
from sim.viewer import play, require_display

ARM = load_arm("ur10e")
T = np.linspace(0, 2, 201)
MOTION = Trajectory(T, np.outer(T, np.ones(6)), np.ones((201, 6)), np.zeros((201, 6)))


class Window:
    """A viewer that records the angles shown and closes after `frames` of them."""

    def __init__(self, frames: int = 10**6) -> None:
        self.frames, self.seen = frames, []

    def __call__(self, model: Any, data: Any) -> Self:
        self.data = data
        return self

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        pass

    def is_running(self) -> bool:
        return len(self.seen) < self.frames

    def sync(self) -> None:
        self.seen.append(self.data.qpos[:6].copy())


def shown(window: Window, motions: list[Trajectory]) -> np.ndarray:
    clock = [0.0]
    play(ARM, [], motions, window, lambda: clock[0], lambda dt: clock.__setitem__(0, clock[0] + 0.5))
    return np.array(window.seen)


def test_each_motion_is_shown_in_its_own_time() -> None:
    q = shown(Window(), [MOTION, MOTION])
    assert np.allclose(q[:, 0], [0.0, 0.5, 1.0, 1.5, 2.0] * 2)


def test_it_ends_with_its_window() -> None:
    assert len(shown(Window(3), [MOTION, MOTION])) == 3


def test_without_a_display_it_is_refused_with_what_to_open_instead() -> None:
    with pytest.raises(ConfigError, match=r"open plan\.html in a browser"):
        require_display({}, "linux")
    require_display({"DISPLAY": ":0"}, "linux")
    require_display({}, "darwin")


def test_a_viewer_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco.viewer", None)
    with pytest.raises(ConfigError, match=r"arm-calib\[viewer\]"):
        require_display({"DISPLAY": ":0"}, "linux")
