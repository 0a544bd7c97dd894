"""A drive whose heartbeat has ended counts neither as on nor as off."""

from __future__ import annotations

import pytest

from sim.errors import DeviceError


def without_heartbeat(b, joint):
    """The emulated ODrive sends no more heartbeats; everything else goes on."""
    servo, sent = b.bus.servos[joint], b.bus.servos[joint].spontaneous
    servo.spontaneous = lambda now: [m for m in sent(now) if m.arbitration_id & 0x1F != 1]


def test_an_old_heartbeat_is_none(bench):
    b = bench("odrive")
    b.driver.connect()
    b.stream(40)
    without_heartbeat(b, 3)
    begin = b.clock.now()
    with pytest.raises(DeviceError, match=r"wrist_1_joint.*no heartbeat for more than 0\.3 s"):
        b.stream(100)
    assert 0.2 < b.clock.now() - begin < 0.31
    b.bus.servos[3].on = False  # nor does it count as off
    with pytest.raises(DeviceError, match=r"wrist_1_joint \(node 4\): torque was switched off, but the drive does not say so"):
        b.driver.release()
