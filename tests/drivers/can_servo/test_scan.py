"""A scan finds every drive that answers, reports what it could not query, and switches nothing.

Turning the joints by hand then shows which drive belongs to which joint.
"""

from __future__ import annotations

import math
import tomllib

import can
import numpy as np
import pytest

from drivers.can_servo.by_hand import PERIOD, ByHand
from drivers.can_servo.link import Link
from drivers.can_servo.new_cell import cell_text
from drivers.can_servo.scan import scan
from sim.can_wiring import CanOptions, can_options
from sim.cell import load_cell
from sim.emulated.can.stepped import SteppedBus
from sim.errors import ConfigError, DeviceError

FAST = 5_000_000


def options(data_bitrate=None):
    return CanOptions(interface="virtual", channel="c", data_bitrate=data_bitrate, rate=200.0, brakes=False, servos=[])


@pytest.fixture
def scanned(bench):
    """scanned(bench) -> the result of a scan of its bus, and the link that was used."""

    def run(b, data_bitrate=None, supported=False):
        b.bus.data_bitrate = data_bitrate
        link = Link(SteppedBus(b.bus, b.clock), b.clock, "stepped")
        return scan(link, b.clock, options(data_bitrate), supported), link

    return run


def test_six_mixed_drives_in_less_than_ten_seconds_of_the_bus(bench, scanned):
    b = bench("mixed")
    b.bus.servos[1].fd = True
    for servo in b.bus.servos[:5]:
        servo.watchdog = 0.0
        servo.switch(True)
    live, began = b.bus.body.live.copy(), b.clock.now()
    result, _ = scanned(b, FAST)
    assert b.clock.now() - began < 10.0
    assert [(f.protocol, f.node, f.fd) for f in result.found] == [
        ("damiao", 1, False), ("damiao", 2, True), ("odrive", 5, False), ("odrive", 6, False), ("robstride", 3, False), ("robstride", 4, False),
    ]  # fmt: skip
    assert [f.described.serial for f in result.found] == [
        "410001",
        "410002",
        "000000064195",
        "000000064196",
        "410003",
        "410004",
    ]
    assert [f.described.on for f in result.found[:2]] == [True, True]
    assert result.found[1].described.ranges.tau == 28.0
    assert result.found[0].feedback == 17
    assert all(not f.described.problems for f in result.found)
    assert (b.bus.body.live == live).all()
    assert any("cubemars drives were not asked: they answer only commands" in note for note in result.notes)


def test_what_is_not_there_is_not_found_and_fd_is_missed_without_its_bit_rate(bench, scanned):
    b = bench()
    b.bus.servos[1].fd = True
    b.bus.inject("silent:wrist_3_joint")
    result, _ = scanned(b)
    assert [f.node for f in result.found] == [1, 3, 4, 5]
    assert any("error frames: a drive with another bit rate or with CAN FD" in note for note in result.notes)


def test_cubemars_are_queried_where_nothing_can_fall(bench, scanned):
    b = bench("cubemars")
    assert scanned(b)[0].found == ()
    result, _ = scanned(b, supported=True)
    assert [(f.protocol, f.node, f.feedback) for f in result.found] == [("cubemars", n, n) for n in range(1, 7)]
    assert "its manual states the ranges" in result.found[0].described.problems[0]


def test_what_must_be_set_first_is_reported_for_each_drive(bench, scanned):
    b = bench()
    b.bus.inject("twin:wrist_1_joint")
    b.bus.servos[0].registers[10] = 2
    b.bus.servos[1].registers[21] = 1e-38
    b.bus.servos[2].error = 0xD
    for servo in b.bus.servos[4:]:
        servo.registers[15] = 0
    result, _ = scanned(b)
    problems = {f.node: " ".join(f.described.problems) for f in result.found}
    assert "control mode 2" in problems[1]
    assert "no drive spans that" in problems[2]
    assert "communication lost" in problems[3]
    assert "2 drives answer to this identifier" in problems[4]
    assert problems[5] == ""
    assert any("2 drives report the serial number 0" in note for note in result.notes)


def test_other_traffic_is_reported(bench, scanned):
    b = bench()
    b.bus.inject("babble")
    assert any("identifier 0x123 was on the bus" in note for note in scanned(b)[0].notes)


def test_an_odrive_of_old_firmware_is_known_by_its_heartbeat(bench, scanned):
    b = bench("odrive")
    for servo in b.bus.servos:
        servo._reply = lambda command: []
    result, _ = scanned(b)
    assert result.found == ()
    assert sum("sends heartbeats as an ODrive does" in note for note in result.notes) == 6


class Hand:
    """Turns joints of an arm without torque as time passes, by changing what its drives read."""

    def __init__(self, b):
        self.b, self.moves = b, []
        for servo in b.bus.servos:
            servo.frozen = servo.reading()
        b.clock.sleep_until = self._sleep(b.clock.sleep_until)

    def _sleep(self, plain):
        def sleep(until):
            while self.moves and self.b.clock.now() >= self.moves[0][0]:
                _, joint, angle = self.moves.pop(0)
                servo = next(s for s in self.b.bus.servos if s.joint == joint)
                q, *others = servo.frozen
                servo.frozen = (q + servo.direction * angle, *others)
            plain(until)

        return sleep

    def turn(self, joint, angle, after):
        self.moves += [(self.b.clock.now() + after + PERIOD * k, joint, angle / 20) for k in range(20)]
        self.moves.sort()


def test_hands_show_order_and_direction_and_the_cell_loads(bench, scanned, servo6, tmp_path):
    b = bench("mixed")
    order = [3, 0, 5, 1, 4, 2]
    for servo, joint in zip(b.bus.servos, order, strict=True):
        servo.joint = joint
        servo.direction = -1 if joint % 2 else 1
        servo.zero = 0.0
    result, link = scanned(b)
    hand, hands = Hand(b), ByHand([f.drive for f in result.found], link, b.clock, patience=10.0)
    joints = {}
    for j, name in enumerate(servo6.joint_names):
        hand.turn(j, 0.35, after=1.5)
        which, sign = hands.turned()
        joints[name] = (result.found[which], sign)
        b.clock.sleep_until(b.clock.now() + 0.5)
    nodes = {servo.joint: servo.node for servo in b.bus.servos}
    assert [joints[name][0].node for name in servo6.joint_names] == [nodes[j] for j in range(6)]
    assert [joints[name][1] for name in servo6.joint_names] == [1, -1, 1, -1, 1, -1]
    assert not b.bus.body.live.any()
    text = cell_text("my-arm", "servo6", options(), joints)
    assert not math.isnan(tomllib.loads(text.replace("# TODO rest", "rest"))["rest"][0]) or "# TODO rest" in text
    path = tmp_path / "my-arm.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"needs kp and kd above zero|has no ranges"):
        can_options(load_cell(path), servo6)
    filled = text.replace("# TODO kp = 0.0", "kp = 60.0").replace("# TODO kd = 0.0", "kd = 1.5")
    path.write_text(
        filled.replace("# TODO ranges = { q = 12.5, dq = 0.0, tau = 0.0 }", "ranges = { q = 12.57, dq = 20.0, tau = 60.0 }")
    )
    wired = can_options(load_cell(path), servo6)
    assert [s.node for s in wired.servos] == [nodes[j] for j in range(6)]
    assert {s.protocol for s in wired.servos} == {"damiao", "robstride", "odrive"}


def test_two_joints_together_are_not_taken_for_one(bench, scanned):
    b = bench()
    result, link = scanned(b)
    hand, hands = Hand(b), ByHand([f.drive for f in result.found], link, b.clock)
    hand.turn(1, 0.35, after=1.5)
    hand.turn(2, -0.35, after=1.5)
    with pytest.raises(
        DeviceError, match=r"damiao node 2.* and .*node 3.* moved together|damiao node 3.* and .*node 2.* moved together"
    ):
        hands.turned()


def test_hands_need_support_where_only_the_order_off_says_where_a_drive_stands(bench, scanned):
    b = bench()
    b.bus.servos[2].answers_refresh = False
    b.bus.servos[2].switch(True)
    result, link = scanned(b)
    with pytest.raises(DeviceError, match=r"damiao node 3.*answers only the order off.*--supported"):
        ByHand([f.drive for f in result.found], link, b.clock).look()
    assert b.bus.servos[2].on
    result, link = scanned(b, supported=True)
    assert np.isfinite(ByHand([f.drive for f in result.found], link, b.clock).look()).all()
    assert not b.bus.servos[2].on


def test_nobody_turns_anything(bench, scanned):
    b = bench()
    result, link = scanned(b)
    with pytest.raises(DeviceError, match=r"no joint was turned far enough within 3 s"):
        ByHand([f.drive for f in result.found], link, b.clock, patience=3.0).turned()


def test_a_scan_reads_any_bytes(bench, scanned):
    rng = np.random.default_rng(3)
    b = bench()

    def noise(message, now):
        return [can.Message(
            arbitration_id=int(rng.integers(0, 1 << 29 if wide else 1 << 11)), is_extended_id=bool(wide),
            data=rng.integers(0, 256, int(rng.integers(0, 9)), dtype=np.uint8).tobytes(),
        ) for wide in rng.integers(0, 2, 3)]  # fmt: skip

    b.bus.servos[0].receive = noise
    result, _ = scanned(b, supported=True)
    assert isinstance(result.found, tuple)
