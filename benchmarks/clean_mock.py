"""Mock arms with nothing hidden: is any effect identified, and does identification make the arm worse?

`python -m benchmarks clean_mock`: 100 sessions distributed over the shipped arms. Each has two random motions of 20 s to fit
and one of 20 s held out, recorded through the mock driver. The first session of each arm is also identified. A run continues
where the last one stopped (build/clean_mock.jsonl), for `minutes` at a time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.kept import FOLDER, Kept
from benchmarks.known_truth import fitting_motion
from benchmarks.results import digest
from benchmarks.sliced import findings
from calib.claims.diagnosis_sentences import DISAGREES
from calib.diagnosis.diagnose import diagnose
from calib.identification.identify import identify
from drivers.driver import Driver
from drivers.mock import MockDriver
from logs.log import Log
from sim.arm import Arm, load_arm
from sim.clock import SimulatedClock
from sim.plant import Plant
from sim.resources import shipped_configs
from sim.trajectory import Trajectory

COUNT = 100
RATE = 250.0  # Hz, as in the demo
MEASURES = ("benchmarks.clean_mock",)


def driven(driver: Driver, motion: Trajectory, rate: float) -> Log:
    """Log of a connected driver along a motion, without the guard: the commands are samples of the motion itself."""
    t = np.arange(0.0, motion.t[-1] - motion.t[0], 1 / rate)
    q, dq = (np.stack([np.interp(t, motion.t - motion.t[0], x) for x in wanted.T], axis=1) for wanted in (motion.q, motion.dq))
    states, nothing = [], np.zeros(q.shape[1])
    for k in range(len(t)):
        states.append(driver.read())
        driver.send(q[k], dq[k], nothing)
    keys = ("q", "dq", "tau", "current", "temperature")
    read = [np.array([getattr(state, key) for state in states]) for key in keys]
    when = np.array([state.t_device for state in states])
    return Log(driver.arm.joint_names, when - when[0], when - when[0], *read, q, dq, np.zeros_like(q))


def recorded(truth: Arm, arm: Arm, seed: int) -> list[Log]:
    """Two recordings to fit and one to hold out, of a mock of `truth` whose controller uses the model `arm`."""
    rate, out = min(RATE, arm.sensors.rate), []
    for k in range(3):
        motion = fitting_motion(arm, 1000 + 10 * seed + k)
        driver = MockDriver(Plant(truth, drive=arm, seed=10 * seed + k), arm, rate, SimulatedClock(), start=motion.q[0])
        driver.connect()
        out.append(driven(driver, motion, rate))
    return out


def session(name: str, seed: int, identified: bool) -> dict[str, Any]:
    """Diagnose one session of an arm that matches its file: verdict, effect names, residual over noise.

    If `identified`, `ratio` is the held-out residual RMS of the identified model over that of the nominal one.
    """
    arm = load_arm(name)
    recordings = recorded(arm, arm, seed)
    answer = diagnose(arm, recordings[:2], recordings[2:]).answer
    names = [f"{e['effect']} {e['joint'] or ''}".strip() for e in answer["effects"]]
    first = answer["claims"][0]
    found = {"arm": name, "verdict": answer["verdict"], "names": names, "over_noise": first.get("ratio")}
    if identified:
        held = identify(arm, recordings[:2], recordings[2:]).result.holdout
        assert held is not None
        found["ratio"] = float(np.sqrt(np.mean(np.square(held.after))) / np.sqrt(np.mean(np.square(held.before))))
    return found


def run(minutes: float = 10.0, count: int = COUNT) -> list[dict[str, Any]]:
    """Run sessions for `minutes`; return rows (what, value, unit, bar, note) over all sessions finished so far."""
    kept = Kept(FOLDER / "clean_mock.jsonl", " ".join(digest(path) for path in MEASURES))
    arms = sorted(folder.name for folder in (shipped_configs() / "arms").iterdir())
    jobs = {f"{arms[k % len(arms)]} {k}": partial(session, arms[k % len(arms)], k, k < len(arms)) for k in range(count)}
    return rows(list(findings(jobs, kept, minutes).values()), count, len(arms))


def rows(found: Sequence[Mapping[str, Any]], count: int, arms: int) -> list[dict[str, Any]]:
    """Rows over the finished sessions."""
    named = [f"{f['arm']}: {', '.join(f['names'])}" for f in found if f["names"]]
    other = [f"{f['arm']}: {f['verdict']}" for f in found if f["verdict"] != "no_missing_effect"]
    out: list[dict[str, Any]] = [
        {"what": "nothing hidden: sessions", "value": len(found), "bar": str(count), "note": f"{len({f['arm'] for f in found})} of {arms} shipped arms"},
        {"what": "nothing hidden: effects identified", "value": sum(len(f["names"]) for f in found), "bar": "0", "note": "; ".join(named)},
        {"what": "nothing hidden: sessions not answered `no missing effect`", "value": len(other), "bar": "0", "note": "; ".join(other)},
    ]  # fmt: skip
    far = [(f["over_noise"], f["arm"]) for f in found if f.get("over_noise") is not None]
    if far:
        over, arm = max(far)
        out += [
            {"what": "nothing hidden: sessions whose answer says that the model does not agree", "value": sum(x > DISAGREES for x, _ in far), "bar": "0", "note": f"a residual RMS of over {DISAGREES:g} times the noise at a sliding joint"},
            {"what": "nothing hidden: residual RMS of sliding joints after a refit over the noise, worst joint of all sessions", "value": round(over, 1), "note": f"{arm}; median of the sessions {np.median([x for x, _ in far]):.1f}"},
        ]  # fmt: skip
    ratios = [(f["ratio"], f["arm"]) for f in found if "ratio" in f]
    if ratios:
        worst, arm = max(ratios)
        out.append(
            {"what": "held-out residual RMS, identified over nominal, worst arm", "value": round(worst, 3), "bar": "<= 1", "note": f"{arm}; one session of each of {len(ratios)} arms"}
        )  # fmt: skip
    return out
