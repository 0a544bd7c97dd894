"""Something touched the arm for a while."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from sim.effects.effect import Effect, Parameter, Values
from sim.interval import Interval
from sim.motion_view import CandidateColumns, MotionView
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage


class ExternalContact(Effect):
    """f(t) = f sin(pi (t - start)/duration)^2 while it lasts."""

    name = "external_contact"
    summary = "something touched the arm for a while"
    looks = "a single short residual on several joints at once"
    reference = "S. Haddadin, A. De Luca, A. Albu-Schaffer (2017), doi:10.1109/TRO.2017.2723903"
    experiment = "the same motion in an empty cell"
    stage = Stage.FORCE
    scope = "arm"
    # many windows are tried: on 116 clean cases of the exam (seeds 26112951 to ...991) the best gained 31 once, otherwise at most 25
    surcharge = 2.0
    parameters = (
        Parameter("start", "s", "onset, from the start of the recording", zero=None, lower=0.0, upper=1e5),
        Parameter("duration", "s", "how long it lasts", zero=None, lower=0.02, upper=60.0, grid=(1.0,)),
        Parameter("force_x", "N", "force on the last link", grid=(1.0,)),
        Parameter("force_y", "N", "force on the last link", grid=(1.0,)),
        Parameter("force_z", "N", "force on the last link", grid=(1.0,)),
    )

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """None: it is searched for in time (calib.diagnosis.contact)."""
        return iter(())

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """f += f sin^2 within the window."""
        phase = (state.t - p["start"]) / p["duration"]
        window = np.where((phase > 0) & (phase < 1), self.window(phase), 0.0)
        state.force += window[:, None] * np.array([p["force_x"], p["force_y"], p["force_z"]])

    def window(self, phase: np.ndarray) -> np.ndarray:
        """Share (N,) of the force at 0 < phase < 1."""
        return np.sin(np.pi * phase) ** 2

    def forms(self) -> Sequence[Effect]:
        """A half sine, and a force that starts and ends abruptly: how the arm was touched is unknown."""
        return _HalfSine(), _Constant()

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """f += anything from 0 to f: when the recording begins is unknown."""
        for axis, name in enumerate(("force_x", "force_y", "force_z")):
            box.add(box.force, np.array([axis]), Interval.zeros((1,)).hull(p[name].wider(unsure)))


class _HalfSine(ExternalContact):
    """f(t) = f sin(pi (t - start)/duration)."""

    def window(self, phase: np.ndarray) -> np.ndarray:
        """sin(pi x)."""
        return np.sin(np.pi * phase)


class _Constant(ExternalContact):
    """f(t) = f."""

    def window(self, phase: np.ndarray) -> np.ndarray:
        """1."""
        return np.ones_like(phase)
