"""What an effect of the catalogue is: its parameters, the stage of the torque path at which it acts, its bounds and its trials."""

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
    """One number of an effect.

    zero is the value at which the effect vanishes (None where another parameter makes it vanish); lower and upper are physical
    bounds; grid are typical values from which a nonlinear fit begins (one value suffices where the torque is linear in it).
    spread: standard deviation of the logarithm of a value without a zero, as far as a fit leaves its typical values.
    turns: cycles in a revolution, which below sim.turns.BEFORE_THE_GEAR are whole, so that a whole number is chosen and not fitted.
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
        """Whether a value is one of a few that are possible, so that nothing near it is."""
        return self.turns and value < BEFORE_THE_GEAR and float(value).is_integer()


@dataclass(frozen=True)
class Probe:
    """Parameter values at which an effect is tried: torque changes linearly between `base` and each of `points`.

    combine turns the coefficients of the points (k,) into parameter values.
    """

    base: Values
    points: tuple[Values, ...]
    combine: Callable[[np.ndarray], dict[str, float]]


class Unbounded(Exception):
    """Nobody can say how much torque an effect adds at most."""


class Effect:
    """One physical effect. Subclasses set the class variables and implement the method of their stage.

    A joint effect gets the joint's index; an effect of the whole arm gets joint None.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    looks: ClassVar[str]
    reference: ClassVar[str]
    experiment: ClassVar[str] = ""
    stage: ClassVar[Stage]
    scope: ClassVar[Literal["joint", "arm"]] = "joint"
    parameters: ClassVar[tuple[Parameter, ...]]
    # tried at so many points that together they follow noise: no part of what measures the noise of a recording
    many: ClassVar[bool] = False
    # fall of -2 log likelihood that naming it must bring beyond that of an ordinary effect; each was tuned on clean recordings of the exam
    surcharge: ClassVar[float] = 0.0
    # the effect at the same joint that in nature holds a little of this one: beside it, no evidence makes a small one sure
    part_of: ClassVar[str] = ""
    # whether its law holds by definition, so that what is left beside it is never the error of its form
    exact: ClassVar[bool] = False
    # whether its joint is driven through the one right before it in the chain, on which it acts too; the first joint has no such effect
    driven: ClassVar[bool] = False
    # at stage MOTOR: whether it uses the torque through the gear
    needs_load: ClassVar[bool] = False

    @property
    def law(self) -> str:
        """The effect as an equation: the first paragraph of its docstring, in one line."""
        return " ".join((self.__doc__ or "").split("\n\n")[0].split()).rstrip(".")

    def passed_on(self, p: Values) -> float:
        """Its torque on the joint before over that on its own joint; 0 of what acts on one joint."""
        return 0.0

    def plausible(self, p: Values, load: float, evidence: float) -> bool:
        """Whether a fit that ended at p has found this effect: bounds that are not a single parameter's.

        load N m is the largest through the gear in the recordings, evidence the fall of -2 log likelihood.
        """
        return True

    def apply(self, state: PathState, joint: int | None, p: Values) -> None:
        """Change `state` by this effect with parameter values `p`; every stage but RIGID."""
        raise TypeError(f"{self.name} acts on the rigid bodies, not on a motion")

    def bound(self, box: TorqueBox, joints: np.ndarray, p: Known, unsure: np.ndarray) -> None:
        """Change `box` so that it holds whatever `apply` makes of any motion in it, with any parameters of p, at `joints` (k,).

        unsure (k,): share by which the whole effect may be off, where no parameter has a standard deviation of its own. An effect of the
        whole arm gets no joints. By default there is no bound: `safety` refuses a motion of an arm that has such an effect.
        """
        raise Unbounded(self.name)

    def reading(self, angle: np.ndarray, p: Values) -> np.ndarray:
        """What the encoder reads at a joint angle, rad; stage ENCODER only."""
        raise TypeError(f"{self.name} does not act on the encoder")

    def reading_speed(self, angle: np.ndarray, speed: np.ndarray, p: Values) -> np.ndarray:
        """How fast that reading changes, rad/s, where the joint turns with `speed`: by the slope of `reading`."""
        step = 1e-6
        return speed * (self.reading(angle + step, p) - self.reading(angle - step, p)) / (2 * step)

    def bodies(self, tree: KinematicTree, joint: int | None, p: Values) -> KinematicTree:
        """The kinematic tree with this effect; stage RIGID only."""
        raise TypeError(f"{self.name} does not act on the rigid bodies")

    def mjcf(self, joint: str, p: Values) -> Mjcf | None:
        """The MJCF form, or None where plain MuJoCo has none and `sim.plant` applies the effect each step."""
        return None

    def exported(self, joint: str, p: Values, size: JointSize) -> Exported:
        """The effect in an exported model: its MJCF form where it has one, else by its stage a sensor's or the callback's."""
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

        Where no parameter has such a value they are the upper bounds: a gear too stiff to twist, a limit never reached.
        """
        if all(p.zero is None for p in self.parameters):
            return {p.name: p.upper for p in self.parameters}
        return {p.name: p.grid[0] if p.zero is None else p.zero for p in self.parameters}

    def scaled(self, p: Values, factor: float) -> dict[str, float]:
        """The effect `factor` times as strong: what vanishes at a zero in proportion, else every parameter, which is a stiffness or a limit, over it."""
        if all(x.zero is None for x in self.parameters):
            return {x.name: float(np.clip(p[x.name] / factor, x.lower, x.upper)) for x in self.parameters}
        return dict(p) | {
            x.name: float(np.clip(x.zero + factor * (p[x.name] - x.zero), x.lower, x.upper))
            for x in self.parameters
            if x.zero is not None
        }

    def forms(self) -> Sequence[Effect]:
        """Other published laws of this effect, with the same parameters: nobody knows which one a real joint follows."""
        return ()

    def probes(self, own: Values | None) -> list[Probe]:
        """Where to try the effect, beside the values that the arm has (None where it has none).

        By default the torque is linear in the parameters that have a zero, for each value on the grids of the others.
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
        """How the effect would show in the torque of some recordings, from every start of its nonlinear parameters; none where it cannot.

        By default by its probes: those of an encoder through the posture, those behind the load through the torque of their joint.
        """
        if joint is not None and self.stage is Stage.ENCODER:
            yield from of_the_reading(self, views, joint)
        elif joint is not None and self.stage is not Stage.RIGID:
            yield from behind_the_load(self, views, joint)

    def imitators(self, path: PathState, joint: int) -> dict[str, np.ndarray]:
        """What is no effect of the catalogue and looks like this one: its name -> (N, k) whose weighted sums are torques of that joint.

        Where one of them explains recordings better than the effect does, the effect is not named.
        """
        return {}

    def motor_lead(self, load: np.ndarray) -> np.ndarray | None:
        """(N,) rad by which the motor leads the link per unit of the only parameter, under load (N,) N m through the gear.

        NaN where that is not known. A drive holds its motor at the command, so this much stands in the following error. None of an effect
        whose lead is in no proportion to its parameter, or that a softer drive would show as well.
        """
        return None

    def joint_before(self, joint: int | None) -> int:
        """Index of the joint through which that joint is driven; ConfigError for the first."""
        if not joint:
            raise ConfigError(
                f"{self.name}: the joint is driven through the one before it, and the first has none; name another"
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
