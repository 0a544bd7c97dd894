"""Samples of a small arm and a disk that fails, for the tests of recordings."""

import errno
import os

import numpy as np

from logs import Recorder
from logs.journal import Disk
from sim.joint_state import JointState, Status

NAMES = ("a", "bb", "a_long_joint_name")
NAN = np.full(3, np.nan)


def sample(k, status=Status.RUNNING):
    x = np.array([0.001 * k, -0.002 * k, 0.5])
    return JointState(
        t=50 + 0.002 * k, t_device=7 + 0.002 * k, q=x, dq=x + 1, tau=x + 2, current=x + 3, temperature=NAN, status=status
    )


def record(recorder, count, start=0):
    for k in range(start, start + count):
        recorder.write(sample(k), sample(k).q + 0.1, sample(k).dq + 0.1, NAN)


class CountingDisk(Disk):
    """The real disk with its calls counted; the operation `fail` fails from its call `fail_at` on."""

    def __init__(self, fail="", fail_at=10**9, number=errno.EIO):
        self.calls = {"write": 0, "sync": 0, "reserve": 0}
        self.fail, self.fail_at, self.number = fail, fail_at, number

    def _count(self, name):
        self.calls[name] += 1
        if name == self.fail and self.calls[name] >= self.fail_at:
            raise OSError(self.number, os.strerror(self.number))

    def write(self, fd, data):
        self._count("write")
        return super().write(fd, data)

    def sync(self, fd):
        self._count("sync")
        super().sync(fd)

    def reserve(self, fd, start, size):
        self._count("reserve")
        super().reserve(fd, start, size)


def killed(path, change=lambda data: data):
    """Write the journal of a recorder that was killed and holds no lock, after `change`; return its bytes."""
    recorder = Recorder(path, NAMES)
    record(recorder, 30)
    data = change(path.read_bytes())
    recorder.close()
    path.write_bytes(data)
    return data
