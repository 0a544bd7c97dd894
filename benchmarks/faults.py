"""The fault matrix: each fault injected into the mock many times. How soon does the arm slow down, and how far does it turn?

A run continues where the last one stopped (build/faults.jsonl), for `minutes` at a time, until every fault was injected
`repeats` times: `make faults`. Faults change readings or the plant (MuJoCo, simulated clock), so a busy computer changes no
figure.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np

from benchmarks.forked import forked
from benchmarks.hidden import BOX, LOAD, HiddenBox, load_lost, with_load, without_box
from benchmarks.injection import Injection
from benchmarks.kept import FOLDER, Kept
from benchmarks.reaction import Run, Trouble, Watched
from benchmarks.results import digest
from drivers.mock import MockDriver
from sim.arm import Arm
from sim.cell import Cell, load_arm_of, load_cell
from sim.errors import DeviceError
from sim.joint_state import JointState


def once(change: Callable[[JointState, int], JointState]) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        driver.show()
        return change(state, driver.joint) if driver.reads == driver.at else state

    return apply


def always(change: Callable[[JointState, int], JointState]) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        driver.show()
        return change(state, driver.joint)

    return apply


def with_joint(values: np.ndarray, joint: int, value: float) -> np.ndarray:
    out = values.copy()
    out[joint] = value
    return out


def frozen(driver: Watched, state: JointState) -> JointState:
    """Visible from the first reading that repeats the previous one."""
    driver.kept = driver.kept or state
    if driver.reads > driver.at:
        driver.show()
    j = driver.joint
    return replace(state, q=with_joint(state.q, j, driver.kept.q[j]), dq=with_joint(state.dq, j, driver.kept.dq[j]))


def stale(driver: Watched, state: JointState) -> JointState:
    driver.kept = driver.kept or state
    if driver.reads > driver.at:
        driver.show()
    return replace(driver.kept, t=state.t)


def lost(count: int) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        if driver.reads == driver.at:
            for _ in range(count):
                state = MockDriver.read(driver)
            driver.show()
        return state

    return apply


def cable_out(driver: Watched, state: JointState) -> JointState:
    driver.show()
    raise DeviceError("no reading within three periods")


def stalled(seconds: float) -> Callable[[Watched, JointState], JointState]:
    def apply(driver: Watched, state: JointState) -> JointState:
        if driver.reads == driver.at:
            driver.show()
            driver.clock.sleep_until(driver.clock.now() + seconds)
        return state

    return apply


def nothing(driver: Watched, state: JointState) -> JointState:
    """Leave the reading unchanged: the plant itself shows the fault."""
    return state


HOT = 90.0
TROUBLES = (
    Trouble("over-temperature", always(lambda s, j: replace(s, temperature=with_joint(s.temperature, j, HOT)))),
    Trouble("jump of one turn", once(lambda s, j: replace(s, q=with_joint(s.q, j, s.q[j] + 2 * np.pi)))),
    Trouble("sign flip of a position", once(lambda s, j: replace(s, q=with_joint(s.q, j, -s.q[j])))),
    Trouble("sign flip of a speed", always(lambda s, j: replace(s, dq=with_joint(s.dq, j, -s.dq[j]))), "five readings are averaged", moving=0.5),
    Trouble("frozen position and speed of a joint", frozen, "seen by a value that comes late: three readings"),
    Trouble("stale readings", stale),
    Trouble("2 lost packets", lost(2), "no stop: within 3.5 periods", stops=False),
    Trouble("5 lost packets", lost(5)),
    Trouble("cable out", cable_out, "the device's own stop"),
    Trouble("stall of 5 ms", stalled(0.005), "no stop: within 3.5 periods", stops=False),
    Trouble("stall of 50 ms", stalled(0.05)),
    Trouble("stall of 500 ms", stalled(0.5)),
    Trouble("contact with a hidden box", nothing, f"a box of {BOX:g} m, met by a face; seen by the residual of torque; what holds against a push is the angle of each joint, stop and room", plant=HiddenBox(), twin=without_box, pushed=True),
    Trouble(f"payload of {LOAD.mass:g} kg lost", load_lost, "its drive lets go of the torque as the arm rises; while the shoulder turns round its friction may hide that for up to 0.2 s", plant=with_load, twin=with_load, payload=LOAD),
)  # fmt: skip
CELL = "mock-ur10e"
LONGEST = 60.0  # s, time limit of a run
MEASURES = ("benchmarks.faults",)


def run(minutes: float = 10.0, repeats: int = 200) -> list[dict[str, Any]]:
    """Inject faults for `minutes`; return rows (what, value, unit, bar, note) over all runs so far."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "faults.jsonl", " ".join(digest(path) for path in MEASURES))
    cell = load_cell(CELL)
    arm = load_arm_of(cell)
    for done in forked(_missing(kept, arm, cell, repeats), LONGEST, end):
        if done.fault:
            raise RuntimeError(f"{done.key}: {done.fault}")
        kept.keep(done.key, done.value)
    return [
        row
        for trouble in TROUBLES
        for row in rows(
            trouble, [Run(**f) for what, f in kept.found.items() if what.rpartition(" ")[0] == trouble.name], repeats
        )
    ]


def _missing(kept: Kept, arm: Arm, cell: Cell, repeats: int) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Runs not yet done, each with its key."""
    ready: dict[bool, Injection] = {}
    for number in range(repeats):
        for trouble in TROUBLES:
            if (what := f"{trouble.name} {number}") not in kept.found:
                heavy = trouble.payload is not None
                if heavy not in ready:
                    ready[heavy] = Injection(trouble, arm, cell, (0.12,) if heavy else (0.3,))
                    ready[heavy].run(number)  # compile here, so that no child has to
                yield what, partial(_injected, ready[heavy].of(trouble), number)


def _injected(injection: Injection, number: int) -> dict[str, Any]:
    return asdict(injection.run(number))


def rows(trouble: Trouble, runs: list[Run], wanted: int) -> list[dict[str, Any]]:
    """Reaction and angles of one fault over its runs."""
    stops = [r for r in runs if r.reaction is not None]
    missed = [r.missed for r in runs if r.missed]
    counts = f"{len(runs)} of {wanted} runs, {len(stops)} stops, {len(missed)} missed"
    note = "; ".join(x for x in (counts, trouble.note, f"first missed: {missed[0][:160]}" if missed else "") if x)
    if not trouble.stops:
        return [{"what": f"{trouble.name}: stops", "value": len(stops), "bar": "0", "note": note}]
    if not stops:
        return [{"what": f"{trouble.name}: stops", "value": 0, "bar": str(len(runs)), "note": note}]
    if stops[0].from_visible is not None:
        seen = spread([r.from_visible or 0 for r in stops])
        note += f"; from the first reading that leaves the noise of the sensors: {seen} readings"
    angles = np.degrees([r.angle for r in stops])
    value = (
        f"{spread([r.reaction or 0 for r in stops])} readings; {np.median(angles):.2f}/{angles.max():.2f} deg; "
        f"{max(r.share for r in stops):.2f}; {max(r.beside for r in stops):.2f}; {1e3 * max(r.time for r in stops):.0f} ms"
    )
    note += f"; at most {np.degrees(max(r.beyond for r in stops)):.2f} deg beyond the commanded stop"
    what = f"{trouble.name}: reaction p50/p99.9, angle p50/max, stop angle / verified, beside the path / verified room, time"
    bar = "<= 2 readings; <= 1" if trouble.pushed else "<= 2 readings; <= 1; <= 1"
    return [{"what": what, "value": value, "bar": bar, "note": note}]


def spread(counts: list[int]) -> str:
    return f"{np.percentile(counts, 50):.0f}/{np.percentile(counts, 99.9):.0f}"
