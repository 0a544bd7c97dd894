"""Motion that separates two explanations: a torque of one that the other, together with a refit, cannot imitate.

separation^2 = min over theta, c of |s_a - Y theta - S_b c|^2 / sigma^2, with s_a the torque that effect a adds along the
motion, Y the regressor of rigid bodies and friction, S_b what effect b can add at its typical values, and sigma the torque
noise.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims.diagnosis_sentences import words
from calib.excitation.design import coarse, fitted_to_room, noise_of
from calib.excitation.fourier import Basis, Fourier, random_fourier
from calib.excitation.objective import Objective
from calib.excitation.optimise import lowest
from calib.excitation.room import Room
from calib.identification.model import TorqueModel
from drivers.driver import DeviceStop
from sim.arm import Arm, ArmEffect
from sim.effects import effect_named, with_effect
from sim.errors import AnswerIsNo, ConfigError
from sim.prediction import predict
from sim.rigid_body import RigidBody
from sim.torque_path import Stage
from sim.trajectory import Trajectory

Pair = tuple[ArmEffect, tuple[str, str | None]]
MOST_PROBES = 12
SLOWER = (1.0, 2.0)  # periods tried, relative to the session's: slow motion separates friction, fast motion inertia
ENOUGH = 5.0  # sigma, over the whole motion
WORTH, LIMITS = 30.0, 1000.0  # weights of the separation and of exceeded limits
# sigma below which two effects are the same on every motion of the arm; rounding alone gives 6e-12 for a load and a link of a
# SCARA
SAME = 0.01
STEP, TINY = 1e-4, 1e-9


def pairs_of(run: Path, arm: Arm) -> list[Pair]:
    """Pairs (effect found, rival) that a diagnosis could not distinguish; `run` is its folder or diagnosis.json."""
    file = run / "diagnosis.json" if run.is_dir() else run
    try:
        answer: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        named = [
            (
                ArmEffect(e["effect"], e["joint"], {k: float(p["value"]) for k, p in e["parameters"].items()}),
                [(r["effect"], r["joint"]) for r in e["indistinguishable_from"]],
            )
            for e in answer["effects"]
        ]
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read ({error.strerror}); give the run folder of `calib diagnose`") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{file}: not a diagnosis ({error!r}); give the run folder of `calib diagnose`") from error
    found = [(effect, rival) for effect, rivals in named for rival in rivals]
    for effect, (name, joint) in found:
        for where in (effect.joint, joint):
            if where is not None:
                arm.joint_index(where)
        effect_named(effect.effect), effect_named(name)
    if not found:
        raise ConfigError(f"{file}: names no indistinguishable effects, so there is nothing to discriminate")
    return found


def discriminating(
    room: Room, pairs: Sequence[Pair], basis: Basis, home: np.ndarray, rng: np.random.Generator, tries: int,
    stop: DeviceStop | None = None, iterations: int = 20,
) -> tuple[Fourier, float]:  # fmt: skip
    """Return the motion whose least separation over the pairs is largest, and that separation.

    The best of `tries` random motions is improved by the descent that the excitation uses, under the same limits, in the
    coefficients of the joints that the pairs name. AnswerIsNo if no motion fits, or if none separates one of the pairs at all.
    """
    best: tuple[Fourier, float] | None = None
    for k in range(tries):
        longer = Basis(basis.harmonics, basis.period * SLOWER[k % len(SLOWER)])
        found = fitted_to_room(room, random_fourier(longer, home, rng))
        if found is None:
            continue
        least = min(separation(room.arm, coarse(found), effect, rival) for effect, rival in pairs)
        if best is None or least > best[1]:
            best = (found, least)
    if best is None:
        raise AnswerIsNo(
            f"{room.arm.name}: no motion fits that could distinguish these effects; give a roomier posture with --home"
        )
    for pair in pairs:
        _require_different(room.arm, coarse(best[0]), *pair)
    if iterations:
        apart = Apart(room, pairs, best[0], stop)
        x, *_ = lowest(apart, best[0].x, iterations)
        found = fitted_to_room(room, Fourier(best[0].basis, home, x), grow=False)
        least = apart.separation(found) if found else 0.0
        if found and least > best[1]:
            best = (found, least)
    return best


def _require_different(arm: Arm, motion: Trajectory, effect: ArmEffect, rival: tuple[str, str | None]) -> None:
    """AnswerIsNo if neither effect differs from what the other and a refit can imitate; any one motion shows this."""
    own = effect.effect, effect.joint
    pairs = [(effect, rival), *((item, own) for item in typical(arm, rival))]
    most = max(separation(arm, motion, *pair) for pair in pairs)
    if most < SAME:
        names = " and ".join(words(*key) for key in (own, rival))
        raise AnswerIsNo(
            f"{arm.name}: no motion separates {names} from each other and from a refit of the arm's parameters ({most:.2g} standard deviations; "
            f"{ENOUGH:g} are needed); decide by other means: {effect_named(effect.effect).experiment or 'measure one of them by itself'}, or weigh the "
            "part; then plan without --discriminate"
        )


class Apart:
    """-WORTH log separation of the least separated pair, plus the penalty for exceeded limits.

    The gradient of the separation is by finite differences.
    """

    def __init__(self, room: Room, pairs: Sequence[Pair], start: Fourier, stop: DeviceStop | None) -> None:
        model = TorqueModel.of_arm(room.arm)
        self._arm, self._pairs, self._start = room.arm, pairs, start
        self._limits = Objective(
            room, model, noise_of(model.arm), start, weight=LIMITS, capped=False, stop=stop, slope=0.0, fine=True
        )
        named = {joint for effect, rival in pairs for joint in (effect.joint, rival[1])}
        joints = room.arm.joint_names if None in named else [j for j in room.arm.joint_names if j in named]
        self._joints = [room.arm.joint_index(j) for j in joints]

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and gradient (n, f)."""
        value, gradient = self._limits(x)
        here, pair = self._least(self._moved(x))
        for j in self._joints:
            for k in range(x.shape[1]):
                there = x.copy()
                there[j, k] += STEP
                rise = separation(self._arm, coarse(self._moved(there)), *pair) / max(here, TINY)
                gradient[j, k] -= WORTH * np.log(max(rise, TINY)) / STEP
        return value - WORTH * float(np.log(max(here, TINY))), gradient

    def separation(self, motion: Fourier) -> float:
        """Least separation over the pairs."""
        return self._least(motion)[0]

    def _moved(self, x: np.ndarray) -> Fourier:
        return Fourier(self._start.basis, self._start.home, x)

    def _least(self, motion: Fourier) -> tuple[float, Pair]:
        found = [separation(self._arm, coarse(motion), effect, rival) for effect, rival in self._pairs]
        return min(found), self._pairs[int(np.argmin(found))]


def separation(arm: Arm, motion: Trajectory, effect: ArmEffect, rival: tuple[str, str | None]) -> float:
    """Distance, in sigma, of the torque of `effect` along the motion from all that `rival` and a refit can imitate."""
    quiet = predict(arm, motion)
    wanted = predict(with_effect(arm, effect), motion) - quiet
    columns = [predict(with_effect(arm, item), motion) - quiet for item in typical(arm, rival)]
    ordinary = RigidBody(arm).regressor(motion.q, motion.dq, motion.ddq)
    own = [np.einsum("nj,jk->njk", x, np.eye(arm.n)) for x in (np.sign(motion.dq), motion.dq, motion.ddq)]
    imitated = np.concatenate([ordinary, *own, np.stack(columns, axis=2)], axis=2)
    sigma = noise_of(arm)
    x = (imitated / sigma[:, None]).reshape(-1, imitated.shape[2])
    y = (wanted / sigma).reshape(-1)
    size = np.linalg.norm(x, axis=0)
    x = x[:, size > 1e-9] / size[size > 1e-9]
    return float(np.linalg.norm(y - x @ np.linalg.lstsq(x, y, rcond=1e-8)[0]))


def typical(arm: Arm, key: tuple[str, str | None]) -> list[ArmEffect]:
    """The effect at its typical values."""
    effect, joint = effect_named(key[0]), key[1]
    own = arm.effect(effect.name, joint)
    if effect.stage is Stage.RIGID and joint is not None:
        j = arm.joint_index(joint)
        mass, com = float(arm.tree.mass[j]), arm.tree.com[j]
        moves = [(1.1 * mass, com), *((mass, com + 0.02 * axis) for axis in np.eye(3))]
        return [ArmEffect(effect.name, joint, {"mass": m, "com_x": c[0], "com_y": c[1], "com_z": c[2]}) for m, c in moves]
    points = [p for probe in effect.probes(own.parameters if own else None) for p in probe.points]
    if not points:
        points = [{p.name: p.grid[0] for p in effect.parameters}]
    step = max(1, len(points) // MOST_PROBES)
    return [ArmEffect(effect.name, joint, dict(p)) for p in points[::step]]
