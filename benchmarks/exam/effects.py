"""The catalogue's effects as nature might have them: no form here is the catalogue's own.

Each effect changes a `TrueArm` by a dose and returns the answer, the catalogue's parameters at their true values. `form` 0 and 1
are the truth's forms; 1 is farther from the textbook and is drawn for the hard cases. Doses are physical: `first` guesses one for
an arm, `severity.py` scales it to be as visible as is requested.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.exam import plant, records
from benchmarks.exam.dynamics import inertia_at, torque_along
from benchmarks.exam.true_arm import TrueArm

PAN, LIFT, ELBOW, WRIST_1, WRIST_2, WRIST_3 = range(6)
ALL = tuple(range(6))
LOADED = (LIFT, ELBOW, WRIST_1)  # joints that gravity loads enough for its angle or size to show
Answer = dict[str, float]
Put = Callable[[TrueArm, int, float, int, np.random.Generator], Answer]


@dataclass(frozen=True)
class Hidden:
    """An effect of the exam. joints: where it may be hidden, () for the whole arm; most: the largest dose that is still plausible.

    ladder: doses of the three severities where every arm has something of the effect and its scatter sets the scale; else ().
    """

    name: str
    put: Put
    joints: tuple[int, ...]
    first: Callable[[TrueArm, int], float]
    most: Callable[[TrueArm, int], float]
    ladder: tuple[float, ...] = ()


def _noise(arm: TrueArm, j: int) -> float:
    return float(arm.hardware.torque_noise[j])


def _dry(arm: TrueArm, j: int) -> float:
    return float(arm.nominal_joints["coulomb"][j])


def _gravity(arm: TrueArm, j: int) -> float:
    """The order of the torque that gravity brings to a joint, N m."""
    still = np.zeros((1, 6))
    stretched = np.array([[0.0, 0.0, 0.0, 0.0, -1.2, 0.3], arm.home])
    torque = [torque_along(arm.nominal, np.array([0, 0, -9.81]), q[None], still, still)[0] for q in stretched]
    return float(max(np.abs(torque)[:, j].max(), 0.3 * _dry(arm, j)))


def _inertia(arm: TrueArm, j: int) -> float:
    return float(inertia_at(arm.nominal, arm.home)[j, j] + arm.nominal_joints["rotor"][j])


def _softest(arm: TrueArm, j: int) -> float:
    """The compliance, rad/(N m), that puts the joint's resonance at 45 rad/s, where its drive still holds it."""
    return 1 / (_inertia(arm, j) * 45.0**2)


def _direction(rng: np.random.Generator, size: int) -> np.ndarray:
    v = rng.standard_normal(size)
    return v / np.linalg.norm(v)


def coulomb(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Another level; form 1 with a wider bristle."""
    sign = -0.6 if rng.uniform() < 0.3 else 1.0
    arm.joints["coulomb"][j] *= 1 + sign * min(dose, 1.2)
    arm.joints["width"][j] *= 1 + 1.0 * form
    return {"coulomb": float(arm.joints["coulomb"][j])}


def viscous(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Another slope; form 1 a little steeper at high speed."""
    sign = -0.6 if rng.uniform() < 0.3 else 1.0
    change = arm.joints["viscous"][j] * sign * dose
    arm.joints["viscous"][j] += change * (1 - 0.15 * form)
    if form:
        row = arm.joints[j : j + 1]
        row["speed_torque"], row["speed_power"] = 0.15 * change, 1.3
    return {"viscous": float(arm.joints["viscous"][j] + 0.15 * form * change)}


def asymmetric(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """One direction is harder, over the bristle's build-up."""
    arm.joints["asymmetry"][j] = rng.choice([-1.0, 1.0]) * dose
    arm.joints["width"][j] *= 1 + 1.0 * form
    return {"half_difference": float(arm.joints["asymmetry"][j])}


def stribeck(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """An exponent that is not two, or a hyperbola."""
    row, velocity = arm.joints[j : j + 1], rng.uniform(0.06, 0.22)
    row["stiction"], row["stribeck_velocity"] = dose, velocity
    row["stribeck_shape"] = records.HYPERBOLIC if form else records.EXPONENTIAL
    row["stribeck_power"] = 2.2 if form else rng.choice([rng.uniform(0.9, 1.6), rng.uniform(2.4, 3.0)])
    return {"stiction_excess": dose, "stribeck_velocity": velocity}


def speed_law(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Grease (an inverse hyperbolic sine) or a polynomial; the answer is the power law nearest to it over the speeds driven."""
    row = arm.joints[j : j + 1]
    row["speed_torque"] = dose
    row["speed_shape"] = records.POLYNOMIAL if rng.uniform() < 0.5 else records.GREASE
    row["speed_knee"] = rng.uniform(0.05, 0.3) if row["speed_shape"][0] == records.GREASE else 0.3 + 0.5 * form
    joint = row.view(np.recarray)[0]
    speeds = np.linspace(0.05, 1.2, 60)
    torque = np.array([plant.speed_friction.py_func(joint, v) for v in speeds])
    powers = np.arange(0.2, 3.5, 0.01)
    basis = speeds[None, :] ** powers[:, None]
    size = basis @ torque / np.sum(basis**2, axis=1)
    best = int(np.argmin(np.sum((size[:, None] * basis - torque) ** 2, axis=1)))
    return {"coefficient": float(size[best]), "exponent": float(powers[best])}


def load_friction(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A power of the load; the coefficient is right at the load that the arm carries."""
    row = arm.joints[j : j + 1]
    row["load_share"], row["load_scale"] = dose, 0.6 * _gravity(arm, j)
    row["load_power"] = rng.uniform(1.25, 1.45) if form else rng.choice([rng.uniform(0.8, 0.92), rng.uniform(1.08, 1.25)])
    return {"coefficient": dose}


def thermal(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Friction follows the joint's own temperature, which follows its work through pauses and from log to log."""
    row = arm.joints[j : j + 1]
    row["warm_drop"], row["warm_rise"] = dose, arm.hardware.heating * (0.35 + 0.3 * form)
    row["heat_time"] *= rng.uniform(0.6, 1.2)
    return {}


def presliding(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Bristles (form 1: that give way late) where the catalogue has a play element; dose is the width, rad."""
    row = arm.joints[j : j + 1]
    row["width"], row["bristle_power"] = dose, 2.0 if form else 1.0
    row["bristle_damping"] = 0.2 * np.sqrt(row["coulomb"] / dose * row["rotor"])
    return {"stiffness": float(row["coulomb"][0] / dose)}


def rotor(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Another rotor."""
    arm.joints["rotor"][j] *= 1 + (-0.6 if rng.uniform() < 0.3 else 1.0) * dose
    return {"inertia": float(arm.joints["rotor"][j])}


def elasticity(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Two masses with damping between; form 1 stiffens with load. Dose is the compliance, rad/(N m)."""
    row = arm.joints[j : j + 1]
    link = max(_inertia(arm, j) - row["rotor"][0], 0.2 * row["rotor"][0])
    share = row["rotor"][0] * link / (row["rotor"][0] + link)
    row["stiffness"] = 1 / dose
    row["gear_damping"] = 2 * rng.uniform(0.03, 0.1) * np.sqrt(share / dose)
    usual = 0.6 * _gravity(arm, j) * dose
    if form:
        row["stiffening"] = 0.15 / usual**2
        row["stiffness"] /= 1.15
    return {"stiffness": 1 / dose}


def backlash(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A gap with stiff sides between motor and link; form 1 with softer ones."""
    row = arm.joints[j : j + 1]
    link = max(_inertia(arm, j) - row["rotor"][0], 0.2 * row["rotor"][0])
    share = row["rotor"][0] * link / (row["rotor"][0] + link)
    row["gap"], row["stiffness"] = dose, share * (300.0 - 120.0 * form) ** 2
    row["gear_damping"] = 2 * rng.uniform(0.1, 0.25) * np.sqrt(share * row["stiffness"])
    return {"half_gap": dose}


def ripple(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A wave with a second harmonic."""
    row, cycles = arm.joints[j : j + 1], float(rng.choice([2, 3, 4, 6, 8, 12, 20]))
    row["ripple"], row["ripple_cycles"], row["ripple_phase"] = dose, cycles, rng.uniform(-np.pi, np.pi)
    row["ripple_second"] = rng.uniform(0.05, 0.12) * (1 + form)
    return {"amplitude": dose, "cycles": cycles}


def spring(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A spring that hardens, or yields, away from its rest."""
    row, rest = arm.joints[j : j + 1], arm.home[j] + rng.uniform(-0.8, 0.8)
    row["spring"], row["spring_rest"] = dose, rest
    row["spring_hardening"] = rng.choice([-0.03, 0.05]) * (1 + form)
    return {"stiffness": dose, "rest_angle": float(rest)}


def gain(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A gain that falls a little with load, as iron saturates."""
    value = 1 + rng.choice([-1.0, 1.0]) * dose
    arm.sensors.gain[j], arm.sensors.gain_fade[j] = value, 0.1 * dose * (1 + form)
    return {"gain": float(value * (1 - 0.5 * arm.sensors.gain_fade[j]))}


def offset(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """An offset that wanders by a few per cent during a log."""
    arm.sensors.offset[j] = rng.choice([-1.0, 1.0]) * dose
    arm.sensors.drift[j] = 0.06 * (1 + form) * dose
    return {"offset": float(arm.sensors.offset[j])}


def saturation(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A limit with a knee before it; dose is the share of the peak torque that is cut off."""
    row = arm.joints[j : j + 1]
    row["limit"], row["knee"] = (1 - dose) * arm.peak[j], 0.01 + 0.03 * form
    return {"limit": float(row["limit"][0])}


def encoder_offset(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """reading = angle + offset."""
    arm.joints["encoder_offset"][j] = rng.choice([-1.0, 1.0]) * dose
    return {"offset": float(arm.joints["encoder_offset"][j])}


def eccentricity(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A wave with a second harmonic on the reading."""
    row, cycles = arm.joints[j : j + 1], float(rng.choice([1.0, 2.0]))
    row["wobble"], row["wobble_cycles"], row["wobble_phase"] = dose, cycles, rng.uniform(-np.pi, np.pi)
    row["wobble_second"] = rng.uniform(0.04, 0.1) * (1 + form)
    return {"amplitude": dose, "cycles": cycles}


def delay(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A delay with jitter; form 1 is in half a first-order lag."""
    arm.sensors.lag = 0.5 * dose * form
    arm.sensors.delay += dose * (1 - 0.5 * form)
    arm.sensors.delay_jitter = 0.25 * dose
    return {"delay": float(dose)}


def payload(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A body with its own moments of inertia; dose is its mass, kg."""
    rotation, position, axis, mass, com, inertia = arm.chain
    reach = 0.25 * np.linalg.norm(arm.nominal[1][2])
    at = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0.2, 1.0)]) * reach
    size = 0.2 * reach * (1 + form)
    total = mass[-1] + dose
    middle = (mass[-1] * com[-1] + dose * at) / total
    both = inertia[-1] + dose * size**2 * np.diag([1.0, 0.8, 0.5])
    for m, c in ((mass[-1], com[-1]), (dose, at)):
        d = c - middle
        both = both + m * (d @ d * np.eye(3) - np.outer(d, d))
    mass, com, inertia = mass.copy(), com.copy(), inertia.copy()
    mass[-1], com[-1], inertia[-1] = total, middle, both
    arm.chain = (rotation, position, axis, mass, com, inertia)
    return {"mass": dose, "com_x": float(at[0]), "com_y": float(at[1]), "com_z": float(at[2])}


def link(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """Another mass, and a centre of mass elsewhere; the moments do not follow the mass."""
    rotation, position, axis, mass, com, inertia = arm.chain
    mass, com = mass.copy(), com.copy()
    sign = rng.choice([-1.0, 1.0])
    mass[j] *= 1 + sign * min(dose, 0.6 if sign < 0 else 2.0)
    com[j] = com[j] + 0.4 * dose * np.linalg.norm(com[j]) * _direction(rng, 3)
    arm.chain = (rotation, position, axis, mass, com, inertia)
    x, y, z = com[j]
    return {"mass": float(mass[j]), "com_x": float(x), "com_y": float(y), "com_z": float(z)}


def tilt(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """The base stands askew."""
    roll, pitch = dose * _direction(rng, 2)
    cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    # the third row of R(roll, pitch): the world's vertical in the base frame
    arm.gravity = -9.81 * np.array([-sp, cp * sr, cp * cr])
    return {"roll": float(roll), "pitch": float(pitch)}


def pull(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A pull that sways by a few per cent."""
    force = dose * _direction(rng, 3)
    arm.force["pull"][0], arm.force["sway"] = force, 0.04 * (1 + form)
    return dict(zip(("force_x", "force_y", "force_z"), map(float, force), strict=True))


def contact(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A half sine, a trapezoid or a triangle; in the excitation only (`cases` takes it out of the other motions)."""
    force, start, duration = dose * _direction(rng, 3), rng.uniform(5.0, 25.0), rng.uniform(0.6, 2.0)
    arm.force["touch"][0], arm.force["start"], arm.force["duration"] = force, start, duration
    arm.force["shape"] = rng.choice([records.TRAPEZOID, records.TRIANGLE]) if form else records.HALF_SINE
    return {
        "start": start,
        "duration": duration,
        **dict(zip(("force_x", "force_y", "force_z"), map(float, force), strict=True)),
    }


def coupling(arm: TrueArm, j: int, dose: float, form: int, rng: np.random.Generator) -> Answer:
    """A motor that the joint before turns too; form 1 harder to start, its drag below proportion. Dose is over the joints' own friction."""
    row, pair, ratio = arm.joints[j : j + 1], arm.nominal_joints[j - 1 : j + 1], float(rng.choice([-1.0, 1.0]))
    size = {name: dose * float(pair[name].min()) for name in ("rotor", "viscous", "coulomb")}
    row["couple_ratio"], row["couple_inertia"], row["couple_coulomb"] = ratio, size["rotor"], size["coulomb"]
    row["couple_viscous"], row["couple_power"] = size["viscous"], 0.8 if form else 0.95
    row["couple_width"], row["couple_rise"] = 3e-4, 0.3 if form else 0.1
    return {"ratio": ratio, "inertia": size["rotor"], "viscous": size["viscous"], "coulomb": size["coulomb"]}


def _always(value: float) -> Callable[[TrueArm, int], float]:
    return lambda arm, j: value


def _per_noise(factor: float) -> Callable[[TrueArm, int], float]:
    return lambda arm, j: factor * _noise(arm, j)


def _mass(share: float) -> Callable[[TrueArm, int], float]:
    return lambda arm, j: share * float(arm.nominal[3].sum())


CHANGES = (0.25, 0.5, 0.9)
EFFECTS = (
    Hidden("coulomb_friction", coulomb, ALL, _always(0.3), _always(1.2), CHANGES),
    Hidden("viscous_friction", viscous, ALL, _always(0.3), _always(1.8), CHANGES),
    Hidden("asymmetric_friction", asymmetric, ALL, _per_noise(1.0), lambda a, j: 0.45 * _dry(a, j)),
    Hidden("stribeck_friction", stribeck, ALL, _per_noise(2.0), lambda a, j: 1.2 * _dry(a, j)),
    Hidden("nonlinear_viscous_friction", speed_law, ALL, _per_noise(2.0), lambda a, j: 1.2 * _dry(a, j)),
    Hidden("load_dependent_friction", load_friction, LOADED, _always(0.08), _always(0.35)),
    Hidden("thermal_friction", thermal, ALL, _always(0.2), _always(0.55)),
    Hidden("presliding_friction", presliding, ALL, _always(4e-3), _always(2.5e-2), (1.2e-3, 3e-3, 6e-3)),
    Hidden("rotor_inertia", rotor, ALL, _always(0.3), _always(1.5), CHANGES),
    Hidden("joint_elasticity", elasticity, (PAN, LIFT, ELBOW, WRIST_1), lambda a, j: 0.3 * _softest(a, j), lambda a, j: _softest(a, j)),
    Hidden("backlash", backlash, (PAN, WRIST_1, WRIST_2), _always(2e-3), lambda a, j: 0.012 if a.name == "servo6" else 0.006),
    Hidden("torque_ripple", ripple, ALL, _per_noise(1.0), lambda a, j: 0.6 * _dry(a, j)),
    Hidden("joint_spring", spring, ALL, _per_noise(2.0), lambda a, j: 1.5 * _dry(a, j)),
    Hidden("torque_gain", gain, ALL, _always(0.08), _always(0.3)),
    Hidden("torque_offset", offset, ALL, _per_noise(1.0), lambda a, j: 0.8 * _dry(a, j)),
    Hidden("torque_saturation", saturation, (PAN, LIFT, ELBOW), _always(0.15), _always(0.4)),
    Hidden("encoder_offset", encoder_offset, LOADED, _always(0.02), _always(0.08)),
    Hidden("encoder_eccentricity", eccentricity, LOADED, _always(0.02), _always(0.08)),
    Hidden("time_delay", delay, (), _always(3e-3), _always(0.02), (2e-3, 4e-3, 8e-3)),
    Hidden("payload", payload, (), _mass(0.02), _mass(0.4)),
    Hidden("link_inertia", link, LOADED, _always(0.15), _always(1.0), (0.1, 0.18, 0.3)),
    Hidden("base_tilt", tilt, (), _always(0.02), _always(0.07)),
    Hidden("tool_force", pull, (), lambda a, j: 3 * _noise(a, LIFT), lambda a, j: 60 * _noise(a, LIFT)),
    Hidden("external_contact", contact, (), lambda a, j: 6 * _noise(a, LIFT), lambda a, j: 90 * _noise(a, LIFT)),
    Hidden("transmission_coupling", coupling, (WRIST_1, WRIST_2, WRIST_3), _always(0.3), _always(1.2)),
)  # fmt: skip
