"""The catalogue's form explains an effect of a plant of another form, but does not fit a plant without the effect.

The other plant is that of the blind cases, `benchmarks.exam`. It has its own rigid dynamics and integrator, bristles instead
of Dahl's law, two masses instead of a twist, and powers and exponents that the catalogue does not have. Here it has no
scatter and no noise.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from benchmarks.exam import motions
from benchmarks.exam.arms import HARDWARE, write_model
from benchmarks.exam.effects import EFFECTS as HIDDEN
from benchmarks.exam.hidden import Hidden
from benchmarks.exam.recording import encoder, torque_reading
from benchmarks.exam.true_arm import AMBIENT, TrueArm, build, feed_forward, run
from sim.arm import Arm, ArmEffect
from sim.effects import EFFECTS, effect_named, with_effect
from sim.prediction import predict
from sim.trajectory import Trajectory

BAND, SMOOTH, STEP, THIN = 10.0, 25.0, 1e-3, 4  # Hz, bandwidths of torque and position in a diagnosis; s; one sample in four
SLIDING = 0.05  # rad/s; a joint at rest holds any torque within its dry friction
# parameters that an answer does not state are searched, as by a diagnosis
SEARCHED = {
    "phase": np.linspace(-np.pi, np.pi, 25),
    "relative_drop": np.linspace(0.05, 0.6, 12),
    "time_constant": np.array([10.0, 20.0, 50.0, 100.0, 200.0]),
}
SEEN_OTHERWISE = ("torque_saturation",)  # a clipped torque is still the torque of the resulting motion


@dataclass(frozen=True)
class Recording:
    """A motion and the torque (N, 6) N m reported along it, both low-passed."""

    motion: Trajectory
    tau: np.ndarray


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> tuple[Arm, TrueArm]:
    """The model of a UR10e, and the true arm with exactly the model's parameters."""
    nominal = write_model("ur10e", Path(tmp_path_factory.mktemp("arm")) / "arm.xml")
    true = build("ur10e", nominal.tree, nominal.tau_max, HARDWARE["ur10e"], motions.HOME, np.random.default_rng(0), False)
    true.chain = true.nominal
    for name in ("coulomb", "viscous", "rotor"):
        true.joints[name] = true.nominal_joints[name]
    true.joints["warm_drop"] = true.joints["mesh"] = 0.0
    true.sensors.delay = 0.0
    true.peak = np.abs(feed_forward(true, reference())).max(axis=0)
    return nominal, true


@pytest.fixture(scope="module")
def without(arms: tuple[Arm, TrueArm]) -> tuple[Recording, float]:
    """A recording of the arm without a hidden effect, and the gap that the model leaves in it."""
    nominal, true = arms
    made = recorded(true)
    return made, gap(nominal, made)


@cache
def reference() -> motions.Reference:
    return motions.fourier_motion(np.random.default_rng(5), motions.HOME, 1.0, 6.0, 5, 0.002)


def recorded(true: TrueArm) -> Recording:
    happened = run(true, reference(), motions.SETTLE, np.full(6, AMBIENT), STEP)
    t = happened.t[happened.t >= 0]
    q = sosfiltfilt(butter(2, SMOOTH, fs=1 / STEP, output="sos"), encoder(true.joints, happened.q[happened.t >= 0]), axis=0)
    dq = np.gradient(q, STEP, axis=0)
    motion = Trajectory(t[::THIN], q[::THIN], dq[::THIN], np.gradient(dq, STEP, axis=0)[::THIN])
    tau = torque_reading(true, happened, t, np.random.default_rng(0))
    return Recording(motion, sosfiltfilt(butter(4, BAND, fs=1 / STEP, output="sos"), tau, axis=0)[::THIN])


def gap(arm: Arm, made: Recording) -> float:
    """RMS over joints and sliding samples of reported minus predicted torque, relative to each joint's RMS."""
    expected = sosfiltfilt(butter(4, BAND, fs=1 / STEP / THIN, output="sos"), predict(arm, made.motion), axis=0)
    rest = (made.tau - expected) / np.sqrt(np.mean(made.tau**2, axis=0))
    sliding = np.abs(made.motion.dq) > SLIDING
    return float(np.sqrt(np.mean(rest[100:-100][sliding[100:-100]] ** 2)))


def hidden_in(true: TrueArm, hidden: Hidden, form: int) -> tuple[TrueArm, dict[str, float], int]:
    """Return the arm with a strong dose of the effect, the answer, and the joint or -1."""
    # a joint that gravity loads; for backlash, one whose load changes sign, with a gap too narrow for the gear to bounce
    place, share = (0, 0.3) if hidden.name == "backlash" else (1, 0.6)
    joint = hidden.joints[min(place, len(hidden.joints) - 1)] if hidden.joints else -1
    changed = true.copy()
    answer = hidden.put(changed, joint, share * hidden.most(true, joint), form, np.random.default_rng(1))
    if hidden.name == "external_contact":
        changed.force["start"] = answer["start"] = 4.0
    return changed, answer, joint


def test_every_effect_of_the_catalogue_can_be_hidden() -> None:
    assert [h.name for h in HIDDEN] == [e.name for e in EFFECTS]
    for h in HIDDEN:
        assert bool(h.joints) == (effect_named(h.name).scope == "joint")


@pytest.mark.parametrize("form", [0, 1])
@pytest.mark.parametrize("hidden", [h for h in HIDDEN if h.name not in SEEN_OTHERWISE], ids=lambda h: h.name)
def test_what_another_plant_does_is_explained(
    hidden: Hidden, form: int, arms: tuple[Arm, TrueArm], without: tuple[Recording, float]
) -> None:
    """With the answer's parameters, the catalogue's form explains three quarters of what the effect adds to the squared gap."""
    nominal, true = arms
    changed, answer, joint = hidden_in(true, hidden, form)
    with_it, (without_it, clean) = recorded(changed), without
    names = [p.name for p in effect_named(hidden.name).parameters]
    unknown = [n for n in names if n not in answer]
    best, item = np.inf, nominal
    for values in itertools.product(*(SEARCHED[n] for n in unknown)):
        given = answer | dict(zip(unknown, map(float, values), strict=True))
        where = nominal.joint_names[joint] if joint >= 0 else None
        tried = with_effect(nominal, ArmEffect(hidden.name, where, {n: given[n] for n in names}))
        found = gap(tried, with_it)
        if found < best:
            best, item = found, tried
    before = gap(nominal, with_it)
    assert before > 1.02 * clean
    assert best**2 - clean**2 < 0.25 * (before**2 - clean**2)
    assert gap(item, without_it) > 1.01 * clean
