"""Watching an arm at work: detection and estimate of a load, false reports in a quiet shift, wear, real recordings, cost."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.real_arm import listed, real
from benchmarks.shift import moving_at, states, work
from benchmarks.watch_load import ABOUT_LOAD, ATTACHED, LOADS, attachments, followed, quantiles, row
from calib.watch.events import Kind
from calib.watch.watcher import Watcher, rehearse
from sim.arm import Arm, ArmEffect, load_arm
from sim.effects import with_effect
from sim.joint_state import JointState


def cost(name: str, passes: int = 5) -> list[dict[str, Any]]:
    """CPU time of a cycle alone: the same shift watched several times; the minimum per cycle excludes what else runs."""
    arm = load_arm(name)
    rehearse(arm, arm.sensors.rate)
    readings = list(states(arm, work(arm, 30.0, 100), 100))
    least = np.full(len(readings), np.inf)
    for _ in range(passes):
        watcher = Watcher(arm, arm.sensors.rate)
        for k, state in enumerate(readings):
            began = time.thread_time()
            watcher.add(state)
            least[k] = min(least[k], time.thread_time() - began)
    text = " / ".join(f"{1e6 * x:.0f}" for x in (least.mean(), *np.percentile(least, [50, 99, 99.9]), least.max()))
    what = f"{name}: cost of a cycle, least of {passes} passes, mean / median / 99 % / 99.9 % / most"
    return [row(what, text, "us of CPU", "< 300", f"{np.mean(least > 3e-4):.2%} above 300")]


def quiet(name: str, minutes: float, rate: float | None = None, seed: int = 7) -> list[dict[str, Any]]:
    """A shift in which all friction falls by 30 % as the joints warm up: nothing may be reported."""
    arm = at_rate(load_arm(name), rate)
    warming = [(t, warmed(arm, 1 - 0.3 * -np.expm1(-t / 600.0))) for t in np.arange(5.0, 60 * minutes, 5.0)]
    watcher = Watcher(arm, arm.sensors.rate)
    events = [e for s in states(arm, work(arm, 60 * minutes, seed), seed, warming) for e in watcher.add(s)]
    what = f"mock {name} at {arm.sensors.rate:g} Hz, {minutes:g} minutes of work while friction falls by 30 %: events"
    return [row(what, len(events), "", "0", f"NIS {watcher.picture().nis:.2f}; {listed(events)}")]


def at_rate(arm: Arm, rate: float | None) -> Arm:
    """The arm read at another rate, Hz."""
    return arm if rate is None else replace(arm, sensors=arm.sensors.model_copy(update={"rate": rate}))


def warmed(arm: Arm, share: float) -> Arm:
    """The arm with `share` of its friction."""
    for item in arm.effects:
        if item.effect in ("coulomb_friction", "viscous_friction"):
            arm = with_effect(
                arm, ArmEffect(item.effect, item.joint, {k: float(share * v) for k, v in item.parameters.items()})
            )
    return arm


def wear(
    name: str, minutes: float, rate: float | None = None, joint: str = "elbow_joint", seed: int = 8
) -> list[dict[str, Any]]:
    """Viscous friction of one joint grows to 1.5 times its initial value."""
    arm = at_rate(load_arm(name), rate)
    own = arm.effect("viscous_friction", joint)
    assert own is not None
    end = 60 * minutes
    grown = [
        (
            t,
            with_effect(
                arm, ArmEffect("viscous_friction", joint, {"viscous": float(own.parameters["viscous"] * (1 + 0.5 * t / end))})
            ),
        )
        for t in np.arange(5.0, end, 5.0)
    ]
    watcher = Watcher(arm, arm.sensors.rate)
    events = [e for s in states(arm, work(arm, end + 30, seed), seed, grown) for e in watcher.add(s)]
    right = [e for e in events if e.kind is Kind.FRICTION_DRIFT and e.joint == joint]
    payloads = [e for e in events if e.kind in ABOUT_LOAD]
    f = watcher.picture().friction[arm.joint_index(joint)].viscous
    note = f"{right[0].message[:70]}" if right else listed(events)
    return [
        row(f"mock {name}, viscous friction of {joint} grows 1.5 times in {minutes:g} minutes: drift reported after", f"{right[0].t:.0f}" if right else "never", "s", "told", note),
        row(f"... found at the end, true {1.5 * own.parameters['viscous']:.3g}", str(f)),
        row("... called a payload", len(payloads), "", "0"),
        row("... other events", len(events) - len(right) - len(payloads), "", "0"),
    ]  # fmt: skip


def wire(repeats: int, address: str = "127.0.0.31") -> list[dict[str, Any]]:
    """The emulated UR over the wire: its robot works and picks up 3 kg while the driver only listens."""
    from drivers.ur_rtde.driver import UrDriver
    from drivers.ur_rtde.options import UrOptions
    from sim.emulated.ur.emulator import UrEmulator
    from sim.emulated.ur.robot import Robot
    from sim.plant import Plant

    arm, load = load_arm("ur10e"), LOADS["ur10e"]
    heavy = with_effect(arm, ArmEffect("payload", None, load))
    out = []
    for seed in range(repeats):
        motion = work(arm, ATTACHED + 12, 200 + seed)
        start = moving_at(arm, motion, ATTACHED)
        plant = Plant(arm, seed=seed)
        robot = Robot(plant, motion[0][0], torque_constant=arm.torque_constant)
        played = _Played(robot, plant, motion, start, heavy)
        robot.motion.step = played  # type: ignore[method-assign]
        emulator = UrEmulator(robot, address)
        emulator.start()
        driver = UrDriver(arm, UrOptions(host=address, frame_timeout=0.5))
        try:
            driver.listen()

            def readings(driver: UrDriver = driver, played: _Played = played) -> Iterable[JointState]:
                while (state := driver.read()).t_device < played.came + 9:
                    yield state

            out.append(followed(arm, readings(), lambda played=played: played.came, load))  # type: ignore[misc]
        finally:
            driver.close()
            emulator.stop()
    detected, mass, com = (np.array([getattr(f, x) for f in out]) for x in ("detected", "mass", "com"))
    what = f"emulated UR10e over the wire, 3 kg attached in motion, {repeats} shifts"
    return [
        row(
            f"{what}: detected, median / 90 % / within",
            quantiles(detected, np.mean(detected <= 0.1 + 1e-6)),
            "s of the device",
            "<= 0.1",
        ),
        row(f"{what}: mass after 0.5 s of motion", quantiles(mass, np.mean(mass <= 0.05), 100), "%", "<= 5"),
        row(f"{what}: centre of mass after 2 s of wrist motion", quantiles(com, np.mean(com <= 0.01), 1000), "mm", "<= 10"),
        row(f"{what}: events that are none", sum(f.others for f in out), "", "0", f"threads {threading.active_count()}"),
    ]


class _Played:
    """The emulated robot's program: the motion of a shift, with the load at its sample; `came` is when, by its clock."""

    def __init__(self, robot: Any, plant: Any, motion: tuple[np.ndarray, np.ndarray], start: float, heavy: Arm) -> None:
        self._robot, self._plant, self._motion, self._heavy = robot, plant, motion, heavy
        self._k, self._first = 0, round(start * robot.rate)
        self.came = np.inf

    def __call__(self) -> None:
        k = min(self._k, len(self._motion[0]) - 1)
        self._robot.motion.q, self._robot.motion.dq = self._motion[0][k].copy(), self._motion[1][k].copy()
        if self._k == self._first:
            self._plant.become(self._heavy)
            self.came = self._robot.time
        self._k += 1


def parts(repeats: int, minutes: float, data: str | None) -> dict[str, Callable[[], list[dict[str, Any]]]]:
    """All measurements by name: `python -m benchmarks.watch NAME...` runs one or several of them."""
    out: dict[str, Callable[[], list[dict[str, Any]]]] = {}
    for name in LOADS:
        out[f"attach-{name}"] = lambda name=name: attachments(name, repeats)  # type: ignore[misc]
        out[f"cost-{name}"] = lambda name=name: cost(name)  # type: ignore[misc]
        out[f"quiet-{name}"] = lambda name=name: quiet(name, minutes)  # type: ignore[misc]
        out[f"wear-{name}"] = lambda name=name: wear(name, minutes * 2 / 3)  # type: ignore[misc]
    out["wire"] = lambda: wire(min(repeats, 3))
    if data:
        out["real"] = lambda: real(Path(data) / "ur10e")
    return out


def run(
    repeats: int = int(os.environ.get("WATCH_REPEATS", "4")),
    minutes: float = float(os.environ.get("WATCH_MINUTES", "3")),
    names: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """Figures of the given parts, or of all.

    repeats: shifts with an attached load. minutes: length of the quiet shift; the wear shift has two thirds of it.
    """
    all_ = parts(repeats, minutes, os.environ.get("ARM_CALIB_DATA"))
    return [r for name in names or all_ for r in all_[name]()]


if __name__ == "__main__":
    for line in run(names=sys.argv[1:]):
        print(" | ".join(str(line[key]) for key in ("what", "value", "unit", "bar", "note")), flush=True)
