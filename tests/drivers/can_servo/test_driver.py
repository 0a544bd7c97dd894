"""The driver on emulated drives of every protocol: it finds, moves and releases them."""

from __future__ import annotations

import numpy as np
import pytest

from sim import recursion_kernels
from sim.joint_state import Status

PROTOCOLS = ("damiao", "cubemars", "robstride", "odrive")


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_an_arm_is_found_moved_and_released(bench, protocol):
    b = bench(protocol)
    with b.driver as driver:
        assert driver.info.rate == 200.0
        idle = driver.read()
        assert idle.status is Status.IDLE
        assert np.allclose(idle.q, b.rest, atol=0.02)
        assert not b.bus.body.live.any()
        states = b.stream(200, amplitude=0.2, frequency=1.0)
        peak = max(s.q[0] for s in states)
        assert peak == pytest.approx(b.rest[0] + 0.2, abs=0.03)
        assert states[-1].status is Status.RUNNING
        assert driver.joints.lost == 0
    assert not b.bus.body.live.any()


def test_time_is_the_schedule(bench):
    b = bench()
    with b.driver:
        states = b.stream(400)
    device = np.array([s.t_device for s in states])
    assert np.diff(device) == pytest.approx(1 / 200, abs=1e-9)
    host = np.array([s.t for s in states])
    assert np.all((host - device > 0.0005) & (host - device < 0.005))  # twelve frames take 1.4 ms on the wire


def test_nothing_is_compiled_while_the_drives_wait_for_a_command(bench):
    """Compiling a kernel for read-only arrays once took 1.5 s, long enough for the drives to switch off."""
    b = bench()
    b.driver.connect()
    compiled = list(recursion_kernels.torque.signatures)
    assert compiled
    b.driver.engage()
    q, still = b.driver.read().q.copy(), np.zeros(6)
    for array in (q, still):
        array.setflags(write=False)
    for _ in range(3):
        b.driver.send(q, still, still)
        b.driver.read()
    assert recursion_kernels.torque.signatures == compiled
