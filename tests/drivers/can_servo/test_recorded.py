"""A plan recorded over the bus, on a simulated clock: every sample, or a bounded stop, a closed log and a message."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest

from logs import read_log
from safety import audit
from safety.approach import move
from safety.approval import approve
from safety.execution import execute
from safety.plan import Motion, write_plan
from safety.trip import MotionStopped

NOON = datetime(2026, 11, 21, 12, 0, tzinfo=UTC)
FAULTS = {
    "silent:elbow_joint": "elbow_joint.*silent for",
    "frozen:elbow_joint": "elbow_joint.*frozen",
    "bus-off": "bus-off",
    "unplugged": "unplugged|sending failed",
}
MORE = {
    "over-temperature:elbow_joint": "elbow_joint.*over-temperature",
    "restarted:elbow_joint": "elbow_joint.*switched itself off or restarted",
    "twin:elbow_joint": "elbow_joint.*answers twice",
    "second-host": "another host commands",
    "babble": "crowds the bus",
    "error-passive": "error-passive",
    "error-frames": "error frames within",
    "tx-full": "transmit queue is full",
}
CASES = [*FAULTS.items(), *(pytest.param(*item, marks=pytest.mark.slow) for item in MORE.items())]


@pytest.fixture
def recording(bench, servo6, tmp_path):
    """The bench, and a function that records an approved plan of one motion of two seconds on it."""
    b = bench(options={"interface": "virtual", "channel": "in-memory"})
    motion = move(b.rest, b.rest + np.array([0.3, 0.1, 0.2, 0.2, 0.2, 0.3]), servo6, b.driver.rate, 0.3)
    plan = write_plan(tmp_path / "plan", servo6, [Motion("excitation", "excitation", motion)], b.cell)
    approve(plan, servo6, b.cell, "operator", NOON)

    def run(watch=lambda progress: None):
        return execute(
            plan, b.cell, servo6, lambda cell, arm: b.driver, tmp_path / "run", audit=tmp_path / "audit.jsonl", watch=watch,
            now=lambda: NOON,
        )  # fmt: skip

    return b, run, tmp_path


def test_a_plan_becomes_a_log_with_every_sample_and_the_arm_ends_at_rest(recording):
    b, run, _ = recording
    done = run()
    log = read_log(done.logs["excitation"])
    assert log.metadata["state"] == "clean"
    assert np.rint(np.diff(log.t) * b.driver.rate).tolist() == [1.0] * (len(log) - 1)
    assert np.all(np.isfinite(log.tau))
    assert b.bus.body.plant.read().q == pytest.approx(b.rest, abs=0.05)
    assert not b.bus.body.live.any()


@pytest.mark.parametrize(("fault", "message"), CASES)
def test_what_happens_on_the_bus_is_a_bounded_stop_and_a_closed_log(recording, fault, message):
    b, run, folder = recording
    begun = []

    def watch(progress):
        cycle = progress.cycle
        if cycle is not None and "excitation" in progress.what and cycle.k > 0.4 * cycle.count and not begun:
            begun.append(fault)
            b.bus.inject(fault)

    with pytest.raises(MotionStopped, match=message) as stopped:
        run(watch)
    assert stopped.value.exit_code == 3
    log = read_log(folder / "run" / "excitation.mcap", accept_partial=True)
    assert log.metadata["state"] == "aborted"
    assert len(log) > 20
    assert [e["event"] for e in audit.verify(folder / "audit.jsonl")] == ["run begins", "device", "run stopped"]
