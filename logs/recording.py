"""What a guard writes to while the arm moves: readings, commands and events of one motion."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from sim.errors import CalibError
from sim.joint_state import JointState

COMPLETED = "completed"  # the only end reason that makes a recording clean
INFO, WARN, ERROR = 20, 30, 40  # levels of rcl_interfaces/msg/Log


def metadata_text(metadata: Mapping[str, Any]) -> dict[str, str]:
    """Metadata as text: strings unchanged, anything else as JSON."""
    return {key: value if isinstance(value, str) else json.dumps(value, allow_nan=False) for key, value in metadata.items()}


class Recording(ABC):
    """Takes samples and events until it is closed; an exception in its context ends it as aborted."""

    path: Path
    joint_names: tuple[str, ...]
    samples: int

    @abstractmethod
    def write(
        self,
        state: JointState,
        q_cmd: np.ndarray | None = None,
        dq_cmd: np.ndarray | None = None,
        tau_cmd: np.ndarray | None = None,
    ) -> None:
        """Add one sample and the command (n,) rad, rad/s, N m that was sent with it; DeviceError once recording has failed."""

    @abstractmethod
    def event(self, level: int, name: str, message: str, t_device: float) -> None:
        """Add one line to /events at `t_device`, s on the device clock."""

    @abstractmethod
    def close(self, end_reason: str = COMPLETED) -> None:
        """End the recording: clean if `end_reason` is "completed", else aborted for that reason. Safe to call more than once."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if error is None:
            self.close()
            return
        try:
            self.close(f"{type(error).__name__}: {error}")
        except CalibError as second:
            error.add_note(str(second))
