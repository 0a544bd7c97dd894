"""A program that is killed while recording leaves every sample whose write had returned."""

import mmap
import random
import signal
import struct
import subprocess
import sys
import time

import numpy as np
import pytest

from logs import read_log

VICTIM = """
import mmap, struct, sys, numpy as np
from logs import Recorder
from sim.joint_state import JointState
file = open(sys.argv[2], "r+b")
board = mmap.mmap(file.fileno(), 8)
recorder = Recorder(sys.argv[1], ("a", "b", "c"))
nan = np.full(3, np.nan)
k = 0
while True:
    x = np.array([0.001 * k, 0.0, 1.0])
    recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, nan), x, x, nan)
    k += 1
    struct.pack_into("<q", board, 0, k)
"""


def killed_recording(folder, delay):
    """Number of samples whose write had returned when the program was killed, and the log that remains."""
    board, path = folder / "board", folder / "a.mcap"
    board.write_bytes(bytes(8))
    path.unlink(missing_ok=True)
    victim = subprocess.Popen([sys.executable, "-c", VICTIM, str(path), str(board)])
    try:
        with board.open("rb") as file, mmap.mmap(file.fileno(), 8, prot=mmap.PROT_READ) as view:
            deadline = time.monotonic() + 60
            while not struct.unpack_from("<q", view)[0] and victim.poll() is None and time.monotonic() < deadline:
                time.sleep(0.005)
            time.sleep(delay)
            victim.send_signal(signal.SIGKILL)
            victim.wait()
            known = struct.unpack_from("<q", view)[0]
    finally:
        victim.kill()
        victim.wait()
    return known, read_log(path, accept_partial=True)


@pytest.mark.parametrize("kills", [2, pytest.param(60, marks=pytest.mark.slow)])
def test_a_kill_at_any_moment_loses_at_most_one_sample(tmp_path, kills):
    rng = random.Random(5)
    for _ in range(kills):
        known, log = killed_recording(tmp_path, rng.uniform(0.0, 0.05))
        assert known > 0
        assert known <= len(log) <= known + 1
        np.testing.assert_allclose(log.q[:, 0], 0.001 * np.arange(len(log)))
