"""The recording process: a regular end loses nothing, and every other end is reported."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from logs import RecorderProcess, State, read_log
from logs.recover import is_recording
from logs.ring import forget
from sim.errors import DeviceError, EmptyLog
from sim.joint_state import JointState, Status

NAMES = ("a", "b")


def sample(k, status=Status.RUNNING, detail=""):
    x = np.array([0.001 * k, 1.0])
    return JointState(5 + 0.002 * k, 0.002 * k, x, x + 1, x + 2, x + 3, x + 30, status=status, detail=detail)


def record(recorder, count, pause=0.0):
    for k in range(count):
        recorder.write(sample(k))
        time.sleep(pause)


def test_what_was_handed_over_is_read(tmp_path):
    with RecorderProcess(tmp_path / "a.mcap", NAMES, {"arm": "x"}) as recorder:
        for k in range(500):
            recorder.write(sample(k), sample(k).q + 9, sample(k).q, sample(k).q)
        recorder.event(30, "guard", "a long text " * 100, 1.0)
        recorder.write(sample(500, Status.FAULT, "joint 2"), *[np.zeros(2)] * 3)
    log = read_log(tmp_path / "a.mcap")
    assert (len(log), log.state, log.metadata["arm"]) == (501, State.CLEAN, "x")
    x = np.array([sample(k).q for k in range(501)])
    np.testing.assert_array_equal(log.q, x)
    np.testing.assert_array_equal(log.temperature, x + 30)
    np.testing.assert_array_equal(log.q_cmd[:500], x[:500] + 9)
    assert log.events[0].message == "a long text " * 100
    assert log.events[1].message == f"{Status.FAULT.value} joint 2"


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this system has no real-time priority to inherit")
def test_the_recording_process_stays_behind_the_control_loop_and_before_other_programs(tmp_path):
    program = """
import os, sys
from logs import RecorderProcess
try:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
except PermissionError:
    pass
with RecorderProcess(sys.argv[1], ("a",)) as recorder:
    print(os.sched_getparam(recorder._process.pid).sched_priority == (1 if os.sched_getscheduler(0) == os.SCHED_FIFO else 0))
"""
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "a.mcap")],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert done.stdout.split() == ["True"]


def test_a_slow_disk_is_counted_and_stops_the_run(tmp_path):
    recorder = RecorderProcess(tmp_path / "a.mcap", NAMES, slots=16)
    os.kill(recorder._process.pid, signal.SIGSTOP)  # like a process that waits for its disk
    with pytest.raises(DeviceError, match="the ring of 16 is full and 1 are lost"):
        record(recorder, 1000)
    handed_over = recorder.samples
    assert 16 <= handed_over < 40
    with pytest.raises(DeviceError, match="the ring of 16 is full"):
        recorder.write(sample(0))
    os.kill(recorder._process.pid, signal.SIGCONT)
    recorder.close()
    log = read_log(tmp_path / "a.mcap", accept_partial=True)
    assert (len(log), log.state) == (handed_over, State.ABORTED)
    assert "1 samples were lost" in log.metadata["end_reason"]


def test_the_recording_process_fails_to_open_its_file(tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"x")
    with pytest.raises(DeviceError, match="never overwritten"):
        RecorderProcess(tmp_path / "a.mcap", NAMES)


def test_a_failed_write_reaches_the_control_loop(tmp_path):
    folder = tmp_path / "small"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=256k", "none", folder], capture_output=True).returncode:
        pytest.skip("a small file system cannot be mounted by this user")
    try:
        recorder = RecorderProcess(folder / "a.mcap", NAMES, reserve=32_768)
        with pytest.raises(DeviceError, match=os.strerror(errno.ENOSPC)):
            record(recorder, 100_000, pause=0.0001)
        with pytest.raises(DeviceError, match=os.strerror(errno.ENOSPC)):
            recorder.close()
        assert len(read_log(folder / "a.mcap", accept_partial=True)) > 100
    finally:
        subprocess.run(["umount", folder], check=True)


def test_the_death_of_the_recording_process_is_seen(tmp_path):
    recorder = RecorderProcess(tmp_path / "a.mcap", NAMES)
    recorder.write(sample(0))
    recorder._process.kill()
    recorder._process.wait()
    with pytest.raises(DeviceError, match=r"is gone.*\(exit code -9\)"):
        recorder.write(sample(1))
    with pytest.raises(DeviceError, match=r"was killed at .* UTC, 1 samples, at most 1 lost"):
        recorder.close()
    assert (len(read_log(tmp_path / "a.mcap")), read_log(tmp_path / "a.mcap").state) == (1, State.KILLED)


PARENT = """
import sys, time, numpy as np
from logs import RecorderProcess
from sim.joint_state import JointState
recorder = RecorderProcess(sys.argv[1], ("a", "b"))
for k in range(300):
    x = np.array([0.001 * k, 1.0])
    recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x))
print("handed over", flush=True)
time.sleep(60)
"""


def test_the_death_of_the_control_loop_ends_the_file_as_killed(tmp_path):
    path = tmp_path / "a.mcap"
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(path)], stdout=subprocess.PIPE)
    assert parent.stdout.readline() == b"handed over\n"
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 60
    log = read_log(path, accept_partial=True)
    while log.state is not State.KILLED and time.monotonic() < deadline:
        time.sleep(0.02)
        log = read_log(path, accept_partial=True)
    assert (len(log), log.state) == (300, State.KILLED)
    assert log.metadata["end_reason"].endswith("300 samples, at most 1 lost")


BURST = """
import os, signal, sys, numpy as np
from logs import RecorderProcess
from logs.about import About
from sim.errors import DeviceError
from sim.joint_state import JointState
recorder = RecorderProcess(sys.argv[1], ("a", "b"), {}, About("<robot/>", {"cell.toml": b"x"}))
print(recorder._process.pid, flush=True)
k = 0
while True:
    x = np.array([0.001 * k, 1.0])
    try:
        recorder.write(JointState(0.002 * k, 0.002 * k, x, x, x, x, x))
    except DeviceError:
        print(k, flush=True)
        break
    k += 1
    if k == 10:
        os.kill(recorder._process.pid, signal.SIGSTOP)
    if k == 400:
        print(k, flush=True)
        sys.stdin.readline()
"""


@pytest.mark.parametrize("victims", ["recorder", "control", "both"])
def test_a_kill_loses_nothing_that_was_handed_over(tmp_path, victims):
    """The recorder is suspended after 10 of 400 samples, as if waiting for its disk, so most are in the ring at the kill."""
    path = tmp_path / "a.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", BURST, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as parent:
        recorder = int(parent.stdout.readline())
        assert parent.stdout.readline() == "400\n"
        ring = re.search(rb"arm-calib-[0-9a-f]{32}", path.read_bytes())
        assert ring is not None
        assert Path("/dev/shm", ring[0].decode()).exists()
        if victims != "control":
            os.kill(recorder, signal.SIGKILL)
        if victims == "recorder":
            parent.stdin.write("go on\n")  # its next write finds the recorder gone
            parent.stdin.flush()
        else:
            parent.kill()
        if victims == "control":
            os.kill(recorder, signal.SIGCONT)
        handed_over = int(parent.stdout.readline() or 400)
        parent.wait()
    deadline = time.monotonic() + 60
    while is_recording(path) and time.monotonic() < deadline:
        time.sleep(0.02)
    log = read_log(path)
    assert (len(log), log.state) == (handed_over, State.KILLED)
    np.testing.assert_allclose(log.t, 0.002 * np.arange(handed_over), atol=1e-9)
    np.testing.assert_allclose(log.t_host, log.t, atol=1e-9)
    assert log.metadata["end_reason"].endswith(f"{handed_over:,} samples, at most 1 lost")
    assert not Path("/dev/shm", ring[0].decode()).exists()
    assert read_log(path).metadata["end_reason"] == log.metadata["end_reason"]


def test_a_ring_that_is_gone_is_reported(tmp_path):
    recorder = RecorderProcess(tmp_path / "a.mcap", NAMES)
    record(recorder, 20)
    while len(read_log(tmp_path / "a.mcap", accept_partial=True)) < 20:
        time.sleep(0.01)
    recorder._process.kill()
    recorder._process.wait()
    forget(recorder._ring_name)
    log = read_log(tmp_path / "a.mcap")
    assert len(log) == 20
    assert "at most 1 lost and what its ring still held, which is gone" in log.findings[0]


def test_a_motion_that_never_began_is_no_damage(tmp_path):
    recorder = RecorderProcess(tmp_path / "a.mcap", NAMES)
    recorder._process.kill()
    recorder._process.wait()
    for _ in range(2):
        with pytest.raises(EmptyLog, match="holds no sample: the motion had not begun"):
            read_log(tmp_path / "a.mcap")
