"""An effect of the catalogue: its parameters, its stage on the torque path, its bounds, and the values at which it is tried."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sim.errors import ConfigError
from sim.mjcf_form import Exported, JointSize, Mjcf
from sim.motion_view import CandidateColumns, MotionView, behind_the_load, of_the_reading
from sim.torque_box import Known, TorqueBox
from sim.torque_path import PathState, Stage
from sim.tree import KinematicTree
from sim.turns import BEFORE_THE_GEAR

Values = Mapping[str, float]


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    zero: value at which the effect vanishes; None if another parameter makes it vanish or no finite value does.
    lower, upper: physical bounds. grid: typical values from which a nonlinear fit starts; one suffices for a linear parameter.
    spread: prior standard deviation of the logarithm of a parameter without a zero, which keeps a fit near its typical values.
    turns: cycles per revolution. Below sim.turns.BEFORE_THE_GEAR they are whole, so a whole number is chosen, not fitted.
    """

    name: str
    unit: str
    meaning: str
    zero: float | None = 0.0
    lower: float = -np.inf
    upper: float = np.inf
    grid: tuple[float, ...] = (1.0,)
    spread: float = np.inf
    turns: bool = False

    def chosen(self, value: float) -> bool:
        """Whether `value` is one of a few possible values, so that it is not fitted."""
        return self.turns and value < BEFORE_THE_GEAR and float(value).is_integer()


@dataclass(frozen=True)
class Probe:
    """Parameter values at which an effect is tried: the torque changes linearly from `base` to each of `points`.

    combine: coefficients (k,) of the points -> parameter values.
    """

    base: Values
    points: tuple[Values, ...]
    combine: Callable[[np.ndarray], dict[str, float]]


class Unbounded(Exception):
    """The torque that an effect adds has no known bound."""


class Effect:
    """One physical effect. Subclasses set the class variables and implement the method of their stage.

    A joint effect receives the joint's index; an effect of the whole arm receives joint None.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    looks: ClassVar[str]
    reference: ClassVar[str]
    experiment: ClassVar[str] = ""
    stage: ClassVar[Stage]
    scope: ClassVar[Literal["joint", "arm"]] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]]
    # tried at so many points that together they fit noise; left out when the noise of a recording is measured
    many: ClassVar[bool] = False
    # fall of -2 log likelihood needed to name it, in addition to that of an ordinary effect; tuned on clean recordings of the exam
    surcharge: ClassVar[float] = 0.0
    # effect at the same joint that physically includes a little of this one; beside it, no evidence confirms a small one
    part_of: ClassVar[str] = ""
    # whether its law holds by definition, so that a remaining residual is never due to its form
    exact: ClassVar[bool] = False
    # whether its joint is driven through the previous one in the chain, on which it then also acts; the first joint cannot have it
    driven: ClassVar[bool] = False
    # at stage MOTOR: whether it uses the torque through the gear
    needs_load: ClassVar[bool] = False

    @property
    def law(self) -> str:
        """The effect's equation: the first paragraph of its docstring, on one line."""
        return " ".join((self.__doc__ or "").split("\n\n")[0].split()).rstrip(".")

    def passed_on(self, p: Values) -> float:
        """Ratio of its torque on the previous joint to that on its own joint; 0 if it acts on one joint only."""
        return 0.0

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether a fit that ended at p has found this effect: conditions beyond the bounds of single parameters.

        load: largest load through the gear in the recordings, N m. evidence: fall of -2 log likelihood.
        """
        return True

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Apply this effect with parameter values `p` to `state`, in place; every stage except RIGID."""
        raise TypeError(f"{self.name} acts on the rigid bodies, not on a motion")

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """Change `box` so that it contains the result of `apply` for any motion in it and any parameters in p, at `joints` (k,).

        unsure (k,): relative error of the whole effect, if its parameters have no standard deviations of their own. An effect of
        the whole arm receives no joints. By default there is no bound: `safety` refuses a motion of an arm with such an effect.
        """
        raise Unbounded(self.name)

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """Encoder reading at a joint angle, rad; stage ENCODER only."""
        raise TypeError(f"{self.name} does not act on the encoder")

    def reading_speed(self, angle: np.ndarray, speed: np.ndarray, p: Values) -> np.ndarray:
        """Rate of change of that reading, rad/s, at the joint speed `speed`, from the slope of `reading`."""
        step = 1e-6
        return speed * (self.reading(angle + step, p) - self.reading(angle - step, p)) / (2 * step)

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The kinematic tree with this effect; stage RIGID only."""
        raise TypeError(f"{self.name} does not act on the rigid bodies")

    def mjcf(self, joint: str, p: Values) -> Mjcf | None:
        """The MJCF form; None if plain MuJoCo has none, in which case `sim.plant` applies the effect at each step."""
        return None

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """Form of the effect in an exported model: MJCF if it has such a form, else by stage native, sensor or callback."""
        form = self.mjcf(joint, p)
        if form is not None:
            words = [", ".join(form.joint), *(tag for _, tag, _ in form.elements)]
            return Exported("native", " and ".join(w for w in words if w), mjcf=form)
        if self.stage is Stage.RIGID:
            return Exported("native", "masses, centres of mass and gravity")
        if self.stage in (Stage.ENCODER, Stage.SENSOR, Stage.CHANNEL):
            return Exported("sensor", "calib.mujoco.read")
        return Exported("callback", "calib.mujoco")

    def none(self) -> dict[str, float]:
        """Parameter values at which the effect is absent.

        If no parameter has such a value, they are the upper bounds: a gear too stiff to twist, a limit never reached.
        """
        if all(p.zero is None for p in self.parameters):
            return {p.name: p.upper for p in self.parameters}
        return {p.name: p.grid[0] if p.zero is None else p.zero for p in self.parameters}

    def scaled(self, p: Values, factor: float) -> dict[str, float]:
        """Parameter values, within bounds, of the effect `factor` times as strong.

        Parameters with a zero scale from it. If none has a zero, all are stiffnesses or limits, and are divided by `factor`.
        """
        if all(x.zero is None for x in self.parameters):
            return {x.name: float(np.clip(p[x.name] / factor, x.lower, x.upper)) for x in self.parameters}
        return dict(p) | {
            x.name: float(np.clip(x.zero + factor * (p[x.name] - x.zero), x.lower, x.upper))
            for x in self.parameters
            if x.zero is not None
        }

    def forms(self) -> Sequence[Effect]:
        """Other published laws of this effect with the same parameters; which of them a real joint follows is unknown."""
        return ()

    def probes(self, own: Values | None) -> list[Probe]:
        """Values at which to try the effect, given the arm's own values (None if it has none).

        Default: the torque is linear in the parameters that have a zero, for each combination of grid values of the others.
        """
        linear = [p for p in self.parameters if p.zero is not None]
        others = [p for p in self.parameters if p.zero is None]
        grids = [p.grid if own is None else (own[p.name], *p.grid) for p in others]
        probes = []
        for values in itertools.product(*grids):
            base = (self.none() if own is None else dict(own)) | {p.name: v for p, v in zip(others, values, strict=True)}
            steps = [max(0.1 * abs(base[p.name]), 0.1 * abs(p.grid[0])) for p in linear]
            points = tuple(base | {p.name: base[p.name] + h} for p, h in zip(linear, steps, strict=True))
            probes.append(Probe(base, points, _added(base, [p.name for p in linear], steps)))
        return probes

    def columns(self, views: Sequence[MotionView], joint: int | None) -> Iterator[CandidateColumns]:
        """Torque columns of the effect in recordings, for each start of its nonlinear parameters; none if it cannot show.

        Default, from its probes: an encoder effect through the posture, an effect behind the load through the torque of its joint.
        """
        if joint is not None and self.stage is Stage.ENCODER:
            yield from of_the_reading(self, views, joint)
        elif joint is not None and self.stage is not Stage.RIGID:
            yield from behind_the_load(self, views, joint)

    def imitators(self, path: PathState, joint: int) -> dict[str, np.ndarray]:
        """Causes outside the catalogue that look like this effect: name -> (N, k) whose weighted sums are torques of that joint.

        If one of them explains the recordings better than the effect does, the effect is not named.
        """
        return {}

    def motor_lead(self, load: np.ndarray) -> np.ndarray | None:
        """(N,) rad by which the motor leads the link per unit of the only parameter, under load (N,) N m through the gear.

        NaN where it is unknown. A drive holds its motor at the command, so the lead appears in the following error. None for an
        effect whose lead is not proportional to its parameter, or whose following error a softer drive would also show.
        """
        return None

    def joint_before(self, joint: int | None) -> int:
        """Index of the joint through which `joint` is driven, the one before it; ConfigError for the first joint."""
        if not joint:
            raise ConfigError(
                f"{self.name}: its joint is driven through the one before it, and the first has none; name another joint"
            )
        return joint - 1

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name."""
        return next(x for x in self.parameters if x.name == name)


def _added(base: Values, names: list[str], steps: list[float]) -> Callable[[np.ndarray], dict[str, float]]:
    """base + coefficient * step for each named parameter."""

    def combine(coefficients: np.ndarray) -> dict[str, float]:
        return dict(base) | {n: base[n] + float(c) * h for n, c, h in zip(names, coefficients, steps, strict=True)}

    return combine
