"""Speed and accuracy with which a watcher identifies what was attached to the flange, against the plant."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.possible import bound
from benchmarks.shift import moving_at, states, work
from calib.watch.events import Kind
from calib.watch.filter import carrying_scale
from calib.watch.watcher import Watcher, rehearse
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState

LOADS = {
    "ur10e": {"mass": 3.0, "com_x": 0.02, "com_y": 0.0, "com_z": 0.12},
    "servo6": {"mass": 0.3, "com_x": 0.0, "com_y": 0.01, "com_z": 0.05},
}
ATTACHED, WRIST_SECONDS = 22.0, 2.0
ABOUT_LOAD = {Kind.LOAD_CHANGED, Kind.PAYLOAD_ATTACHED, Kind.PAYLOAD_CHANGED, Kind.PAYLOAD_REMOVED}


def row(what: str, value: Any, unit: str = "", bar: str = "", note: str = "") -> dict[str, Any]:
    return {"what": what, "value": value, "unit": unit, "bar": bar, "note": note}


@dataclass
class Attached:
    """One load attached in motion: time to detection and to its name, s, errors of mass and centre, and other events.

    mass: relative error after 0.5 s of motion; com: error of the centre, m, after 2 s of wrist motion. bound: likelihood ratio
    contained in 0.1 s of readings, and the Cramer-Rao std of mass and centre.
    """

    detected: float = np.nan
    named: float = np.nan
    mass: float = np.nan
    com: float = np.nan
    mass_after: int = 0
    com_after: int = 0
    others: int = 0
    costs: list[float] = field(default_factory=list)
    bound: tuple[float, float, float] = (np.nan, np.nan, np.nan)


def attach(arm: Arm, load: dict[str, float], seed: int) -> Attached:
    """Attach a load to the moving arm about 22 s into a shift."""
    motion = work(arm, ATTACHED + 12, seed)
    start = moving_at(arm, motion, ATTACHED)
    heavy = with_effect(arm, ArmEffect("payload", None, load))
    readings = list(states(arm, motion, seed, [(start, heavy)]))
    out = followed(arm, readings, lambda: start, load)
    after = [s for s in readings if s.t_device >= start]
    reach = carrying_scale(arm)[1]
    spans = [round(0.1 * arm.sensors.rate), out.mass_after, out.com_after]
    bounds = [bound(arm, after[: max(n, 3)], load, reach) for n in spans]
    out.bound = (bounds[0][0], bounds[1][1], bounds[2][2])
    return out


def followed(arm: Arm, readings: Iterable[JointState], came: Callable[[], float], load: dict[str, float]) -> Attached:
    """A watcher's reports of a load. `came` returns the time of its attachment, infinity before."""
    watcher, out, moved, wrists, since = Watcher(arm, arm.sensors.rate), Attached(), 0.0, 0.0, 0
    com = np.array([load["com_x"], load["com_y"], load["com_z"]])
    period = 1 / arm.sensors.rate
    for state in readings:
        began = time.thread_time()
        events = watcher.add(state)
        start = came()
        out.costs.append(time.thread_time() - began)
        for event in events:
            if event.kind in (Kind.LOAD_CHANGED, Kind.UNEXPECTED_CONTACT) and event.t >= start and np.isnan(out.detected):
                out.detected = event.t - start
            elif event.kind is Kind.PAYLOAD_ATTACHED and np.isnan(out.named) and event.t >= start:
                out.named = event.t - start
            else:
                out.others += 1
        if state.t_device < start:
            continue
        since += 1
        moved += period * bool(np.all(np.abs(state.dq[1:3]) > 0.05))
        wrists += period * bool(np.any(np.abs(state.dq[3:5]) > 0.1))
        if moved >= 0.5 and np.isnan(out.mass):
            out.mass, out.mass_after = abs(watcher.picture().payload.value / load["mass"] - 1), since
        if wrists >= WRIST_SECONDS and np.isnan(out.com):
            found, out.com_after = watcher.picture().com, since
            out.com = np.inf if found is None else float(np.linalg.norm(np.array([c.value for c in found]) - com))
    return out


def attachments(name: str, repeats: int) -> list[dict[str, Any]]:
    """Figures of an attached load over many shifts."""
    arm, load = load_arm(name), LOADS[name]
    rehearse(arm, arm.sensors.rate)
    found = [attach(arm, load, 100 + seed) for seed in range(repeats)]
    detected, mass, com = (np.array([getattr(f, x) for f in found]) for x in ("detected", "mass", "com"))
    # readings come every few ms: one at exactly 0.1 s counts as within, whatever its rounding
    within = [np.mean(detected <= 0.1 + 1e-6), np.mean(mass <= 0.05), np.mean(com <= 0.01)]
    what = f"mock {name}, {load['mass']:g} kg attached in motion, {repeats} shifts"
    costs = 1e6 * np.concatenate([f.costs for f in found])
    cost = " / ".join(f"{x:.0f}" for x in (costs.mean(), *np.percentile(costs, [50, 99, 99.9]), costs.max()))
    over = f"{np.mean(costs > 300):.2%} above 300"
    ratio, least_mass, least_com = np.array([f.bound for f in found]).T
    return [
        row(f"{what}: detected, median / 90 % / within", quantiles(detected, within[0]), "s", "<= 0.1",
            f"0.1 s hold a likelihood ratio of {ratio.min():.0f} to {ratio.max():.0f}, median {np.median(ratio):.0f}"),
        row(f"{what}: mass after 0.5 s of motion", quantiles(mass, within[1], 100), "%", "<= 5",
            f"RMS {rms(mass, 100)}; nobody does better than {rms(least_mass, 100)}"),
        row(f"{what}: centre of mass after 2 s of wrist motion", quantiles(com, within[2], 1000), "mm", "<= 10",
            f"RMS {rms(com, 1000)}; nobody does better than {rms(least_com, 1000)}"),
        row(f"{what}: events that are none", sum(f.others for f in found), "", "0"),
        row(f"{name}: cost of a cycle, mean / median / 99 % / 99.9 % / most", cost, "us of CPU", "< 300", over),
    ]  # fmt: skip


def rms(x: np.ndarray, scale: float) -> str:
    return f"{scale * np.sqrt(np.mean(x**2)):.3g}"


def quantiles(x: np.ndarray, within: float | np.floating[Any], scale: float = 1.0) -> str:
    x = np.where(np.isfinite(x), x, np.inf) * scale
    middle, most = np.quantile(x, [0.5, 0.9], method="higher")
    return f"{middle:.3g} / {most:.3g} / {within:.0%}"
