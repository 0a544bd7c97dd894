"""A device has one owner at a time. The next program is refused with the owner's PID, or if the lock cannot be opened."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sim import file_lock
from sim.errors import DeviceError
from sim.file_lock import lock_device

HOLDER = """
import sys, time
from pathlib import Path
from sim import file_lock
file_lock.LOCKS = Path(sys.argv[1])
lock = file_lock.lock_device("can0")
print("locked", flush=True)
time.sleep(60)
"""


@pytest.fixture
def locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(file_lock, "LOCKS", tmp_path)
    return tmp_path


def test_the_owner_is_named_for_as_long_as_it_lives(locks: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(locks)], stdout=subprocess.PIPE) as owner:
        assert owner.stdout is not None
        owner.stdout.readline()
        with pytest.raises(
            DeviceError, match=rf"can0: another program is using it \(PID {owner.pid}\); .* kill -INT {owner.pid}$"
        ):
            lock_device("can0")
        lock_device("can1").close()
        owner.send_signal(signal.SIGKILL)
    with lock_device("can0"), pytest.raises(DeviceError, match=f"PID {os.getpid()}"):
        lock_device("can0")


def test_a_lock_file_of_any_content_is_no_reason_to_fail(locks: Path) -> None:
    lock_device("can0").close()
    (file,) = locks.iterdir()
    for content in (b"", b"\xff\0", b"9" * 100, "\u0661".encode()):
        with lock_device("can0"):
            file.write_bytes(content)
            with pytest.raises(DeviceError, match="is using it"):
                lock_device("can0")
    assert file.stat().st_mode & 0o777 == 0o666  # usable by every user, no matter who created it


def test_a_lock_that_cannot_be_taken_is_a_refusal(locks: Path, tmp_path: Path) -> None:
    lock_device("can0").close()
    (file,) = locks.iterdir()
    file.unlink()
    file.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(DeviceError, match=r"can0: its lock .* cannot be opened"):
        lock_device("can0")
