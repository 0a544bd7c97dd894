"""Bytes of Damiao's serial adapter: written as by the maker's own code, and read despite noise and split frames."""

from __future__ import annotations

import collections
import os
import tty

import can
import numpy as np
import pytest

from drivers.can_servo.damiao_box import DamiaoBox


@pytest.fixture
def ends():
    master, slave = os.openpty()
    tty.setraw(master)
    bus = DamiaoBox(os.ttyname(slave), 1_000_000)
    assert os.read(master, 100) == bytes.fromhex("55 05 00 aa 55")
    yield master, bus
    bus.shutdown()
    os.close(master)
    os.close(slave)


def test_a_frame_as_the_maker_writes_it(ends):
    master, bus = ends
    bus.send(can.Message(arbitration_id=0x107, is_extended_id=False, data=bytes(range(1, 9))))
    assert os.read(master, 100) == bytes.fromhex("55aa1e03 01000000 0a000000 00 07010000 00 08 0000 0102030405060708 00")


def test_frames_are_found_in_noise_and_in_pieces(ends):
    master, bus = ends
    whole = bytes.fromhex("aa 11 08 17000000 0908070605040302 55")
    sent = bytes.fromhex("aa 12 08 01000000 ffffffffffffffff 55")
    os.write(master, b"\x00\xaa\x11" + whole + sent + whole[:7])
    first = bus.recv(1.0)
    assert (first.arbitration_id, bytes(first.data), first.is_extended_id) == (0x17, bytes.fromhex("0908070605040302"), False)
    assert bus.recv(0.01) is None
    os.write(master, whole[7:])
    assert bus.recv(1.0).arbitration_id == 0x17


def test_any_bytes_are_read_without_a_fault(ends):
    master, bus = ends
    rng = np.random.default_rng(1)
    for _ in range(200):
        noise = bytearray(rng.integers(0, 256, 64, dtype=np.uint8).tobytes())
        for k in rng.integers(0, 48, 3):
            noise[k], noise[k + 15] = 0xAA, 0x55
        os.write(master, bytes(noise))
        while (message := bus.recv(0.0)) is not None:
            assert message.dlc <= 8
    os.write(master, bytes(16) + bytes.fromhex("aa 11 c8 01020304 0000000000000000 55"))
    last = None
    while (message := bus.recv(0.05)) is not None:
        last = message
    assert last is not None
    assert (last.arbitration_id, last.is_extended_id, last.is_remote_frame) == (0x04030201, True, True)


def test_a_bit_rate_that_the_adapter_does_not_know():
    with pytest.raises(ValueError, match="bitrate 800000"):
        DamiaoBox("/dev/null", 800_000)


def test_a_port_that_nobody_empties_refuses_and_never_waits(ends):
    _, bus = ends
    frame = can.Message(arbitration_id=0x107, is_extended_id=False, data=bytes(8))
    with pytest.raises(can.CanOperationError, match=r"serial port"):
        collections.deque(map(bus.send, [frame] * 20_000), maxlen=0)
