"""A mock arm with nothing hidden: does any effect get a name, and is the identified arm worse than the nominal one?

`python -m benchmarks clean_mock`: for each arm, motions of two times 20 s to fit and 20 s held out, through the mock driver.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np

from benchmarks.known_truth import fitting_motion
from calib.diagnosis.diagnose import diagnose
from calib.identification.identify import identify
from drivers.mock import MockDriver
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.clock import SimulatedClock
from sim.plant import Plant
from sim.trajectory import Trajectory

ARMS = ("ur10e", "servo6")
RATE = 250.0  # Hz, of the demo


def recorded(arm: Arm, motion: Trajectory, seed: int, rate: float) -> Log:
    """What the mock driver of an arm that is exactly as its file says reports along a motion."""
    driver = MockDriver(Plant(arm, seed=seed), arm, rate, SimulatedClock(), start=motion.q[0])
    driver.connect()
    t = np.arange(0.0, motion.t[-1], 1 / rate)
    q, dq = (np.stack([np.interp(t, motion.t, x) for x in wanted.T], axis=1) for wanted in (motion.q, motion.dq))
    states = []
    for k in range(len(t)):
        states.append(driver.read())
        driver.send(q[k], dq[k], np.zeros(arm.n))
    keys = ("q", "dq", "tau", "current", "temperature")
    read = [np.array([getattr(state, key) for state in states]) for key in keys]
    when = np.array([state.t_device for state in states])
    return Log(arm.joint_names, when, when, *read, q, dq, np.zeros_like(q))


def run(seeds: int = 10, arms: tuple[str, ...] = ARMS) -> list[dict[str, Any]]:
    """Rows of what, value, unit, bar, note."""
    rows = []
    for name in arms:
        arm = load_arm(name)
        named, ratios, bad = [], [], 0
        for seed in range(seeds):
            logs = [
                recorded(arm, fitting_motion(arm, 1000 + 10 * seed + k), 10 * seed + k, min(RATE, arm.sensors.rate))
                for k in range(3)
            ]
            held = identify(arm, logs[:2], logs[2:]).result.holdout
            assert held is not None
            ratios.append(np.sqrt(np.mean(np.square(held.after))) / np.sqrt(np.mean(np.square(held.before))))
            answer = diagnose(arm, logs[:2], logs[2:]).answer
            named += [f"{e['effect']} {e['joint'] or ''}".strip() for e in answer["effects"]]
            bad += answer["verdict"] != "no_missing_effect"
            print(name, seed, answer["verdict"], named[-1:], f"{ratios[-1]:.4f}", file=sys.stderr, flush=True)
        rows += [
            {"what": f"{name}, nothing hidden: effects identified in {seeds} sessions", "value": len(named), "bar": "0", "note": ", ".join(named)},
            {"what": f"{name}, nothing hidden: sessions not answered `no missing effect`", "value": f"{bad} of {seeds}", "bar": "0"},
            {"what": f"{name}: held-out residual RMS, identified over nominal, worst session", "value": round(float(max(ratios)), 3), "bar": "<= 1"},
        ]  # fmt: skip
    return rows
