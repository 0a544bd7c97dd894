"""Model selection for the corrected arm: an effect or law is written only if the arm predicts and moves no worse with it.

- With several recordings and none held out, an effect must help. Everything is fitted to the others, and a left-out recording
  (a part of one, if there are two) must be predicted better with the effect than with free friction laws alone, or nearly as
  well without needing such a law.
- The arm as written, with what an arm folder can hold, predicts no joint worse than the arm as it was (sim.prediction.predict).
  Its simulated motion is no farther from the recorded one (calib.validation.forward); with friction laws, also than without them.

Worse means significantly worse where a joint slides (calib.diagnosis.significance). On held-out recordings it also means an RMS
error that rises by more than RISEN, over every row in motion, reversals included, and all joints of an effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.diagnosis.corrected import ORDINARY, ArmChange
from calib.diagnosis.fit import Fit, fit
from calib.diagnosis.hypothesis import CONTACT
from calib.diagnosis.law import Law, Refitted
from calib.diagnosis.selection import joints_of
from calib.diagnosis.significance import WORSE
from calib.diagnosis.simulated_motion import SimulatedMotion
from calib.diagnosis.written_arm import AS_IT_WAS, REFIT_WITH_LAWS, WORSE_ELSEWHERE, WrittenArm, as_written, links_kept, ways_of
from calib.measurement.preprocessing import Measurement
from calib.validation.forward import ForwardError
from sim.arm import ArmEffect
from sim.effects.friction_law import FORMS

WORSE_THAN_LAW = 0.05  # relative rise of a joint's RMS torque error that an effect may cost against a law of many terms
# relative rise of the RMS error of an effect's joints on held-out recordings, significant or not, beyond which it does not help
RISEN = 0.05
HELPS = 0.02  # share of a joint's error that an effect must remove
SEVERAL = 2  # recordings; a part of a single one, such as one speed of a staircase, need not show what the others do
PIECES = 3  # parts into which fewer recordings are each cut
INSTEAD = 0.9  # of the power that a law removes; one effect that removes as much is the simpler model


@dataclass(frozen=True)
class Refusal:
    """An effect that was fitted and is left out: the joint that decided, and its RMS N m without the effect and with it.

    An empty joint means that simulated motion decided: RMS m of the flange, or rad of the angle if angle is set.
    on: which recordings; instead: the arm without the effect.
    by_law: it predicts better than the arm as it was, but worse than a friction law, which is written in its place.
    sliding: the error is larger only where the joint slides, and that error is given.
    """

    effect: ArmEffect
    joint: str
    without: float
    with_it: float
    on: str
    instead: str
    by_law: bool = False
    sliding: bool = False
    angle: bool = False

    @property
    def text(self) -> str:
        """What was tried and why it was refused."""
        what, unit = (
            (f"torque error of {self.joint}{' while it slides' if self.sliding else ''}", "N m")
            if self.joint
            else (f"error of the {'angle' if self.angle else 'flange'} in simulated motion", "rad" if self.angle else "m")
        )
        left_out = (
            f"{self.effect.title} is written into the corrected arm as a friction law: on {self.on} the {what} is "
            if self.by_law
            else f"{self.effect.title} was fitted and is left out of the corrected arm: on {self.on} the {what} is "
        )
        with_it = f"{self.with_it:.4g} {unit} with it" if np.isfinite(self.with_it) else "unbounded with it"
        return f"{left_out}{with_it} and {self.without:.4g} {unit} with {self.instead}"


@dataclass(frozen=True)
class Promotion:
    """change: of the written arm, None if it stays as it was; its laws; effects that were left out, and why.

    motion: simulated motion of the arm as it was and of the written one; empty if nothing was simulated.
    """

    change: ArmChange | None
    laws: tuple[Law, ...]
    refused: tuple[Refusal, ...]
    motion: tuple[tuple[ForwardError, ForwardError], ...] = ()

    def written(self, item: ArmEffect) -> ArmEffect | None:
        """A named effect as the written arm has it; None if it does not."""
        effects = self.change.effects if self.change else ()
        return next((e for e in effects if e.key == item.key), None)


def promoted(
    measurements: Sequence[Measurement],
    named: Fit,
    baseline: Fit,
    apart: Sequence[Measurement],
    limits: Sequence[ArmEffect] = (),
) -> Promotion:
    """The arm with the effects of `named`, refitted with what an arm folder can hold, and friction laws for the rest.

    Effects at a significantly worse joint are left out, and the rest is refitted. The errors are those of held-out recordings;
    without any, those of the fitted ones, which refuses less.
    """
    start, shown, on = (
        baseline.hypothesis.start,
        apart or measurements,
        "the held-out recordings" if apart else "the recordings",
    )
    risen = RISEN if apart else np.inf
    several = not apart and len(measurements) >= SEVERAL
    pieces = PIECES if several and len(measurements) < PIECES else 1
    bare = WrittenArm.of(ArmChange({}, ()), (), start, shown)
    kept = bare if apart else None
    ways, alone = ways_of(as_written(measurements, baseline), kept, shown, limits, pieces)
    refits = [way for way in ways if np.all(way.rms <= (1 + risen) * bare.rms)]
    plain = next(iter(refits), bare)
    good = _as_good(bare.rms, plain.rms) / np.maximum(plain.rms, 1e-12)
    motion = SimulatedMotion(start, shown)
    f = as_written(measurements, named)
    refused: list[Refusal] = []
    while any(e.effect != CONTACT for e in f.accepted):  # every round leaves out at least one effect
        own = [e for e in f.accepted if e.effect != CONTACT]
        ways, beside = ways_of(f, kept, shown, limits, pieces)
        harmful = [r for e in own if several and (r := _no_help(e, f, alone, beside)) is not None]
        if not harmful:
            together = [list(x) for x in {tuple(joints_of(e, f.hypothesis.arm)) for e in own}]
            concerned = np.isin(np.arange(start.n), [j for joints in together for j in joints])
            least = np.where(concerned, 1 + WORSE, 1 + WORSE_ELSEWHERE)
            than_bare = [way.worse(bare, least) | way.risen(bare, risen, together) for way in ways]
            worse = [x | way.worse(plain, good, together) for x, way in zip(than_bare, ways, strict=True)]
            fit_for = [way for way, bad in zip(ways, worse, strict=True) if not bad.any()]
            for way in moving_well(fit_for, motion):
                return Promotion(way.change, way.laws, tuple(refused), motion.errors(way.change))
            if plain is not bare and motion.rises(plain.change):
                # a refit that could not be written itself is no reference
                plain, good = bare, np.full(start.n, 1 + WORSE_THAN_LAW)
                continue
            # if motion refuses these, another way may be refused for the torque of some effects only
            seen = [k for k, bad in enumerate(worse) if bad.any() and not (fit_for and motion.rises(ways[k].change))]
            harmful = []
            if seen:
                k = seen[0]
                harmful = harmful_effects(own, f, ways[k], worse[k], [bare if x else plain for x in than_bare[k]], on)
            if fit_for and len(harmful) in (0, len(own)):
                a, b = motion.worst(fit_for[0].change)
                refused += [Refusal(e, "", a.compared, b.compared, on, AS_IT_WAS, angle=a.on_axis) for e in own]
                break
        refused += harmful
        gone = [r.effect for r in harmful]
        rest = tuple(e for e in f.accepted if e not in gone)
        f = fit(measurements, f.hypothesis.with_effects(rest), 3, f.solved.noise, f.models)
    if plain.laws and not apart:
        plain = links_kept(as_written(measurements, baseline), plain, shown, limits, pieces)
    if (
        plain is not bare
        and (plain.laws or limits)
        and np.all(plain.rms <= (1 + WORSE) * bare.rms)
        and next(moving_well([plain, *refits], motion), None) is plain
    ):
        before = dict(zip(start.joint_names, bare.rms, strict=True))
        refused = [replace(r, by_law=bool(apart) and has_law(r, plain, before)) for r in refused]
        return Promotion(plain.change, plain.laws, tuple(refused), motion.errors(plain.change))
    return Promotion(ArmChange({}, tuple(limits)) if limits else None, (), tuple(refused))


def moving_well(ways: Sequence[WrittenArm], motion: SimulatedMotion) -> Iterator[WrittenArm]:
    """Those of `ways` that move no farther from the recording than the arm as it was; with laws, also than the first without."""
    lawless = next((way.change for way in ways if not way.laws), None)
    for way in ways:
        if not motion.rises(way.change) and not (way.laws and lawless is not None and motion.rises(way.change, lawless)):
            yield way


def _as_good(before: np.ndarray, law: np.ndarray) -> np.ndarray:
    """(n,) error up to which an effect is as good a model as a law that reduces the error from `before` to `law`."""
    removed = INSTEAD * np.maximum(before**2 - law**2, 0.0)
    return np.maximum((1 + WORSE_THAN_LAW) * law, np.sqrt(before**2 - removed))


def _no_help(e: ArmEffect, f: Fit, alone: Refitted, beside: Refitted) -> Refusal | None:
    """Why an effect helps at none of its joints, or None; `beside` has the fit's effects, `alone` none.

    Friction, offsets and reflected inertia are free without it too, so it need only be as good.
    """
    joints = joints_of(e, f.hypothesis.arm)
    better = e.effect in ORDINARY or beside.plain < (1 - HELPS) * alone.plain
    helps = better & (beside.plain <= _as_good(alone.plain, alone.predicted))
    helps |= beside.predicted < (1 - HELPS) * alone.predicted
    if helps[joints].any():
        return None
    j = min(joints, key=lambda j: beside.predicted[j] / max(alone.predicted[j], 1e-12))
    names = f.hypothesis.start.joint_names
    return Refusal(
        e, names[j], float(alone.predicted[j]), float(beside.predicted[j]), "recordings left out in turn", REFIT_WITH_LAWS
    )


def harmful_effects(
    own: Sequence[ArmEffect], f: Fit, way: WrittenArm, bad: np.ndarray, better: Sequence[WrittenArm], on: str
) -> list[Refusal]:
    """The effects at the joints that are worse, or all if none acts there; better: per joint the arm that it is worse than."""
    start, worse, out = f.hypothesis.start, {int(j) for j in np.flatnonzero(bad)}, []
    at_fault = [e for e in own if set(joints_of(e, f.hypothesis.arm)) & worse] or own
    for e in at_fault:
        there = set(joints_of(e, f.hypothesis.arm)) & worse or worse
        slides = not any(way.rms[j] > better[j].rms[j] for j in there)
        without, with_it = [x.sliding_rms if slides else x.rms for x in better], way.sliding_rms if slides else way.rms
        j = max(there, key=lambda j: with_it[j] / max(without[j][j], 1e-12))
        out.append(
            Refusal(e, start.joint_names[j], float(without[j][j]), float(with_it[j]), on, better[j].words, sliding=slides)
        )
    return out


def has_law(r: Refusal, plain: WrittenArm, before: Mapping[str, float]) -> bool:
    """Whether a friction law of `plain` replaces a friction effect that lowers its joint's RMS error `before`.

    The effect must lose to a refit with laws.
    """
    there = any(law.effect.joint == r.effect.joint for law in plain.laws)
    return r.effect.effect in FORMS and r.instead == REFIT_WITH_LAWS and there and bool(r.with_it < before[r.joint])
