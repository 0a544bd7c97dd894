"""Every effect of the catalogue at every joint as columns of torque: what the residual would look like if that effect were missing."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass

import numpy as np

from calib.diagnosis.model import CONTACT, MOST_COLUMNS, LogModel
from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS, Effect, Stage
from sim.effects.effect import Probe

Combine = Callable[[np.ndarray], dict[str, float]]


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint (None: the whole arm) with its columns per log.

    columns  per log {joint index: (R, k) N m per unit of coefficient}
    combine  coefficients (k,) -> parameter values
    spread   (k,) prior standard deviation of the coefficients, where some may not show at all; None: free
    """

    effect: str
    joint: str | None
    columns: list[dict[int, np.ndarray]]
    combine: Combine
    spread: tuple[float, ...] | None = None

    @property
    def key(self) -> tuple[str, str | None]:
        """Effect and joint."""
        return self.effect, self.joint


def candidates(models: list[LogModel]) -> Iterator[Candidate]:
    """All candidates at the present hypothesis, each with every start of its nonlinear parameters."""
    arm = models[0].arm
    for effect in EFFECTS:
        if effect.name == CONTACT:
            continue  # not a property of the arm: calib.diagnosis.contact looks for it in time
        if effect.name in _WHOLE:
            yield from _WHOLE[effect.name](models, arm)
        elif effect.scope == "joint":
            for j, joint in enumerate(arm.joint_names):
                if effect.name == "torque_saturation":
                    yield from _saturation(models, joint, j)
                elif effect.name == "torque_ripple":
                    yield from _ripple(models, joint, j)
                elif effect.stage is Stage.ENCODER:
                    yield from _encoder(models, effect, j, joint)
                elif effect.stage is not Stage.RIGID:
                    yield from _joint(models, effect, j, joint)


def _joint(models: list[LogModel], effect: Effect, j: int, joint: str) -> Iterator[Candidate]:
    """Effects behind the load: the tail of the path with the effect at each probe's points."""
    arm = models[0].arm
    own = arm.effect(effect.name, joint)
    for i, probe in enumerate(effect.probes(own.parameters if own else None)):
        if not probe.points:
            continue
        columns = []
        for model in models:

            def rows(model: LogModel = model, probe: Probe = probe) -> np.ndarray:
                others = [e for e in model.own_effects(j) if e.effect != effect.name]
                absent = own is None and dict(probe.base) == effect.none()
                # an effect that vanishes at the probe's base leaves the torque as it is
                base = (
                    model.tau_hat[:, j] if absent else model.tail(j, [*others, ArmEffect(effect.name, joint, dict(probe.base))])
                )
                moved = [model.tail(j, [*others, ArmEffect(effect.name, joint, dict(p))]) - base for p in probe.points]
                return model.rows(np.stack(moved, axis=1))

            columns.append({j: _kept(model, (effect.name, i, model.joint_key(j)), rows)})
        yield Candidate(effect.name, joint, columns, probe.combine)


def _kept(model: LogModel, key: Hashable, rows: Callable[[], np.ndarray]) -> np.ndarray:
    """Columns that were computed before from the same path, or now."""
    cache = model.side.columns
    return cache[key] if key in cache else model.side.keep(cache, key, rows(), MOST_COLUMNS)


def _encoder(models: list[LogModel], effect: Effect, j: int, joint: str) -> Iterator[Candidate]:
    """Errors of a position reading: the torque of all joints as of a posture that is a little off."""
    own = models[0].arm.effect(effect.name, joint)
    drive = tuple(
        tuple(e.parameters.items())
        for name in ("rotor_inertia", "viscous_friction")
        if (e := models[0].arm.effect(name, joint))
    )
    for i, probe in enumerate(effect.probes(own.parameters if own else None)):
        columns = []
        for model in models:

            def rows(model: LogModel = model, probe: Probe = probe) -> np.ndarray:
                slope, moved = posture_slopes(model, j), []
                for point in probe.points:
                    reading = model.measurement.trajectory.q[:, j]
                    error = effect.reading(reading, point) - effect.reading(reading, probe.base)
                    speed = np.gradient(error, model.link.t)
                    errors = (error, speed, np.gradient(speed, model.link.t))
                    moved.append(
                        -sum((d * e[:, None] for d, e in zip(slope, errors, strict=True)), np.zeros(model.tau_hat.shape))
                    )
                return model.rows(np.stack(moved, axis=2))

            stacked = _kept(model, (effect.name, joint, i, drive, None if own is None else tuple(own.parameters.items())), rows)
            columns.append({k: stacked[:, k] for k in range(model.n)})
        yield Candidate(effect.name, joint, columns, probe.combine)


def posture_slopes(model: LogModel, j: int) -> list[np.ndarray]:
    """d tau / d q_j, d tau / d dq_j, d tau / d ddq_j, each (N, n), by central differences in q and dq (tau is quadratic in dq)."""
    if j not in model.side.slopes:
        model.side.slopes[j] = _rigid_slopes(model, j)
    by_angle, by_speed, by_push = model.side.slopes[j]
    own = []
    for name, key, slope in (("rotor_inertia", "inertia", by_push), ("viscous_friction", "viscous", by_speed)):
        item = model.arm.effect(name, model.arm.joint_names[j])
        own.append(slope.copy())
        if item is not None:
            own[-1][:, j] += item.parameters[key]
    return [by_angle, own[1], own[0]]


def _rigid_slopes(model: LogModel, j: int) -> list[np.ndarray]:
    """Of the bodies alone."""
    link = model.link

    def torque(*steps: float) -> np.ndarray:
        moved = [link.q.copy(), link.dq.copy(), link.ddq.copy()]
        for x, step in zip(moved, steps, strict=True):
            x[:, j] += step
        return model.bodies.inverse_dynamics(*moved)

    by_angle = (torque(1e-3, 0, 0) - torque(-1e-3, 0, 0)) / 2e-3
    by_speed = (torque(0, 1e-2, 0) - torque(0, -1e-2, 0)) / 2e-2
    by_push = torque(0, 0, 1.0) - torque(0, 0, 0)
    return [by_angle, by_speed, by_push]


def _whole(model: LogModel, key: Hashable, columns: Callable[[], np.ndarray]) -> dict[int, np.ndarray]:
    """(N, n, k) samples that depend on the link side alone -> rows per joint."""
    rows = _kept(model, key, lambda: model.rows(columns()))
    return {j: rows[:, j] for j in range(model.n)}


# Half the link's mass or 0.1 m of its centre; a tenth of the arm's mass at 0.1 m.
LINK_SPREAD = (5.0, 1.0, 1.0, 1.0)
PAYLOAD_SPREAD = (10.0, 1.0, 1.0, 1.0)


def _payload(models: list[LogModel], arm: Arm) -> Iterator[Candidate]:
    """Linear in m and m c of a point mass; its own moments follow at second order and come with the exact fit."""
    last = 10 * (arm.n - 1)
    scale = 0.01 * float(arm.tree.mass.sum())
    columns = [_whole(m, "payload", lambda m=m: scale * m.regressor[:, :, last : last + 4]) for m in models]  # type: ignore[misc]

    def combine(c: np.ndarray) -> dict[str, float]:
        mass = scale * float(c[0])
        com = scale * c[1:4] / mass if abs(mass) > 1e-9 else np.zeros(3)
        return {"mass": mass, "com_x": float(com[0]), "com_y": float(com[1]), "com_z": float(com[2])}

    yield Candidate("payload", None, columns, combine, PAYLOAD_SPREAD)


def _link(models: list[LogModel], arm: Arm) -> Iterator[Candidate]:
    """Linear in the change of m and m c of one link; the first link's are seen by no joint but its own."""
    for i, joint in enumerate(arm.joint_names[:-1]):
        first = 10 * i
        mass, com = arm.tree.mass[i], arm.tree.com[i]
        size = 0.1 * mass
        columns = [
            _whole(m, ("link", i), lambda m=m, k=first, s=size: s * m.regressor[:, :, k : k + 4])  # type: ignore[misc]
            for m in models
        ]

        def combine(c: np.ndarray, mass: float = mass, com: np.ndarray = com) -> dict[str, float]:
            new = mass * (1.0 + 0.1 * float(c[0]))
            centre = (mass * com + 0.1 * mass * c[1:4]) / new if new > 0 else com
            return {"mass": new, "com_x": float(centre[0]), "com_y": float(centre[1]), "com_z": float(centre[2])}

        yield Candidate("link_inertia", joint, columns, combine, LINK_SPREAD)


def _tilt(models: list[LogModel], arm: Arm) -> Iterator[Candidate]:
    """Linear in roll and pitch."""
    effect = next(e for e in EFFECTS if e.name == "base_tilt")

    def turned_by(model: LogModel) -> np.ndarray:
        link = model.link
        moved = []
        for point in ({"roll": 1e-3, "pitch": 0.0}, {"roll": 0.0, "pitch": 1e-3}):
            turned = effect.bodies(arm.tree, None, point).gravity
            zero = np.zeros_like(link.q)
            change = model.bodies.inverse_dynamics(link.q, zero, zero, turned - arm.gravity)
            moved.append(10.0 * change)
        return np.stack(moved, axis=2)

    columns = [_whole(m, "tilt", lambda m=m: turned_by(m)) for m in models]  # type: ignore[misc]
    yield Candidate("base_tilt", None, columns, lambda c: {"roll": 0.01 * float(c[0]), "pitch": 0.01 * float(c[1])})


def force_rows(model: LogModel) -> np.ndarray:
    """(R, n, 3) N m for 1 N along each axis of the base at the last link's origin."""

    def rows() -> np.ndarray:
        linear, _ = model.bodies.jacobian(model.link.q)
        return model.rows(-np.swapaxes(linear, 1, 2))

    return _kept(model, "force", rows)


def _force(models: list[LogModel], arm: Arm) -> Iterator[Candidate]:
    columns = [{j: force_rows(m)[:, j] for j in range(m.n)} for m in models]
    yield Candidate("tool_force", None, columns, _named("force_x", "force_y", "force_z"))


DELAYS = (1e-3, 5e-3, 10e-3, 20e-3)  # s: beyond a few milliseconds the change of the torque is not its slope times the delay


def _delay(models: list[LogModel], arm: Arm) -> Iterator[Candidate]:
    """The predicted torque later by each of DELAYS, less the torque itself."""
    own = arm.effect("time_delay")
    before = own.parameters["delay"] if own else 0.0
    for late in DELAYS:
        columns = [{j: _late(m, j, late) for j in range(m.n)} for m in models]
        yield Candidate("time_delay", None, columns, lambda c, late=late: {"delay": before + late * float(c[0])})  # type: ignore[misc]


def _late(m: LogModel, j: int, late: float) -> np.ndarray:
    def rows() -> np.ndarray:
        t, tau = m.link.t, m.tau_hat[:, j]
        pairs = itertools.pairwise(m.measurement.starts)
        then = np.concatenate([np.interp(t[a:b] - late, t[a:b], tau[a:b]) for a, b in pairs])
        return m.rows((then - tau)[:, None])

    return _kept(m, ("late", late, m.joint_key(j)), rows)


# Every gear has a mesh of forty and more teeth, whose weak ripple is in every log; a ripple that is worth a name is slower.
RIPPLE_CYCLES = 24


def _ripple(models: list[LogModel], joint: str, j: int) -> Iterator[Candidate]:
    """Sine and cosine of every whole number of cycles along the joint's angle."""
    if models[0].arm.effect("torque_ripple", joint) is not None:
        return
    cycles = np.arange(1, RIPPLE_CYCLES + 1)
    waves = []
    for m in models:

        def both(m: LogModel = m) -> np.ndarray:
            angle = m.link.q[:, j, None] * cycles
            return m.rows(np.stack([-np.sin(angle), -np.cos(angle)], axis=2))

        wave = _kept(m, ("ripple", j), both)
        waves.append((wave[:, :, 0], wave[:, :, 1]))
    for k, n in enumerate(cycles):
        columns = [{j: np.stack([s[:, k], c[:, k]], axis=1)} for s, c in waves]
        yield Candidate("torque_ripple", joint, columns, _wave(float(n)))


def _wave(cycles: float) -> Combine:
    return lambda c: {
        "amplitude": float(np.hypot(c[0], c[1])),
        "cycles": cycles,
        "phase": float(np.arctan2(c[1], c[0])),
    }


# A drive's limit shows where the model asks for more than is measured: tried from just under the largest torque asked for.
LIMITS = tuple(0.97 * 0.94**k for k in range(14))


def _saturation(models: list[LogModel], joint: str, j: int) -> Iterator[Candidate]:
    """The model's torque cut at fractions of its largest; a coefficient of 1 is a cut as the model has it."""
    own = models[0].arm.effect("torque_saturation", joint)
    most = max(float(np.quantile(np.abs(m.tau_hat[:, j]), 0.999)) for m in models)
    for fraction in LIMITS:
        limit = fraction * most
        columns = [{j: _cut(m, j, limit)} for m in models]
        if own is None and limit > 0 and any(np.any(c[j]) for c in columns):
            yield Candidate("torque_saturation", joint, columns, _limited(limit))


def _cut(m: LogModel, j: int, limit: float) -> np.ndarray:
    tau = m.tau_hat[:, j]
    return _kept(m, ("cut", limit, m.joint_key(j)), lambda: m.rows((np.clip(tau, -limit, limit) - tau)[:, None]))


def _limited(limit: float) -> Combine:
    # Half a cut is no cut: coefficients far from 1 give a limit that is refused as unphysical.
    return lambda c: {"limit": limit if 0.6 < float(c[0]) < 1.6 else float("nan")}


def _named(*names: str) -> Combine:
    return lambda c: {name: float(x) for name, x in zip(names, c, strict=True)}


_WHOLE: dict[str, Callable[[list[LogModel], Arm], Iterator[Candidate]]] = {
    "payload": _payload,
    "link_inertia": _link,
    "base_tilt": _tilt,
    "tool_force": _force,
    "time_delay": _delay,
}
