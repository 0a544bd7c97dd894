"""Recordings, workers and outsiders are not trusted: identities stay apart, and one fault affects one row only."""

from __future__ import annotations

import dataclasses
import io
import json
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from calib import main as program
from calib.fleet.engine import cluster
from calib.fleet.fleet import store, stored
from calib.fleet.inventory import Recorded, by_arm, inventory
from calib.fleet.job import Answer, ArmStatus, Job
from calib.fleet.parcel import packed, unpacked
from logs.convert import write_log
from sim.arm import Arm
from sim.errors import BadLog
from tests.calib.conftest import fourier_motion, recorded
from tests.calib.fleet.conftest import write_recording


def recording(arm: str, cell: str, serial: str) -> Recorded:
    return Recorded("a.mcap", 1, "", arm, "", cell, serial, "excitation", "")


def test_arms_with_different_words_are_never_one() -> None:
    words = ["", "1", "2", "1-2", "1,2", "1, 2", "1+2", "line", "line-1", "a b", "a_b", "a~b", "x" * 200, "x" * 201, "é", "e"]
    found = [recording("ur10e", cell, serial) for cell, serial in product(words, words)]
    identities = {r.identity for r in found}
    assert len(identities) == len(found) - len(words)  # "1,2" and "1, 2" are the same two parts
    assert len({r.arm_id for r in found}) == len(identities)
    assert len(by_arm(found)) == len(identities)
    for r in found:
        assert len(r.arm_id) < 150
        assert "/" not in r.arm_id
    assert recording("ur10e", "line-1", "2").arm_id == "ur10e+line-1+2"
    assert recording("ur10e", "line", "1-2").arm_id == "ur10e+line+1-2"


@pytest.mark.parametrize(("key", "value", "message"), [
    ("wall_clock_start_ns", "9" * 40, "is not a time"),
    ("wall_clock_start_ns", "²", "is not a time"),
    ("wall_clock_start_ns", "-5", "is not a time"),
    ("arm", "../configs/arms/ur5e", "never a path"),
    ("arm", "/etc", "never a path"),
    ("arm", "..", "never a path"),
    ("cell", "\x1b[2J", "cannot be printed"),
    ("serial", "9" * 5000, "longer than 500 characters"),
])  # fmt: skip
def test_one_recording_that_says_nonsense_takes_no_other(
    tmp_path: Path, ur5e: Arm, capsys: pytest.CaptureFixture[str], key: str, value: str, message: str
) -> None:
    write_recording(tmp_path / "plant" / "cell-0" / "a.mcap", ur5e, ur5e, 1, seconds=2.0)
    words = {"arm": ur5e.name, "cell": "c", "serial": "s", "motion": "excitation", "wall_clock_start_ns": "1767225600000000000"}
    log = recorded(ur5e, fourier_motion(ur5e, 1, 2.0, 125.0), 1)
    write_log(log, tmp_path / "plant" / "b.mcap", "clean", words | {key: value})
    recordings, unknown = inventory(str(tmp_path / "plant"))
    assert [r.arm_id for r in recordings] == ["ur5e+cell-0+S-cell-0"]
    assert [message in why for _, why in unknown] == [True]
    out = tmp_path / "out"
    assert program.main(["fleet", str(tmp_path / "plant"), "--workers", "0", "--no-diagnose", "--out", str(out)]) == 1
    printed = capsys.readouterr()
    assert "\x1b[2J" not in printed.out + printed.err
    assert "Traceback" not in printed.err
    assert {p.name for p in (out / "arms").iterdir()} == {"ur5e+cell-0+S-cell-0"}


def answer(**changes: object) -> Answer:
    row = {"arm": "a", "status": "done", "sentence": "fine", "left_of_torque": [0.1, float("nan")]}
    plain = Answer("a", ArmStatus.DONE, row, {"arm/arm.toml": b"x = 1\n"}, ("m",), np.ones(1), np.eye(1))
    return dataclasses.replace(plain, **changes)  # type: ignore[arg-type]


def test_an_answer_travels_as_data() -> None:
    found = unpacked(packed(answer()), "a")
    assert found.row == {"arm": "a", "status": "done", "sentence": "fine", "left_of_torque": [0.1, None]}
    assert found.files == {"arm/arm.toml": b"x = 1\n"}
    assert (found.names, found.theta.tolist(), found.covariance.tolist()) == (("m",), [1.0], [[1.0]])


class Trap:
    """Sets `sprung` when it is unpickled."""

    sprung = False

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return (setattr, (Trap, "sprung", True))  # type: ignore[return-value]


def with_objects() -> bytes:
    out = io.BytesIO()
    np.savez(out, about=np.array([Trap()], dtype=object))
    return out.getvalue()


@pytest.mark.parametrize("data", [
    packed(answer(files={"../../outside": b"x"})),
    packed(answer(files={"/etc/passwd": b"x"})),
    packed(answer(files={"arm/../../x": b"x"})),
    packed(answer(files={"": b"x"})),
    packed(answer(arm_id="b")),
    packed(answer(row={"arm": "b"})),
    packed(answer(row={"arm": "a", "colour": "red"})),
    packed(answer(row={"arm": "a", "seconds": "long"})),
    packed(answer(theta=np.ones(3))),
    b"", b"PK\x03\x04", b"\x80\x04\x95", {"a": 1}, None, with_objects(),
])  # fmt: skip
def test_an_answer_that_is_none_is_refused(data: object) -> None:
    with pytest.raises(BadLog, match="the worker's answer about a"):
        unpacked(data, "a")
    assert not Trap.sprung


def test_any_bytes_are_refused_in_a_sentence() -> None:
    rng, whole = np.random.default_rng(1), packed(answer())
    for _ in range(300):
        data = bytearray(whole)
        for k in rng.integers(0, len(data), 4):
            data[k] = rng.integers(0, 256)
        try:
            unpacked(bytes(data), "a")
        except BadLog:
            continue


STRANGER = """
import sys
from distributed import Client
try:
    client = Client(sys.argv[1], timeout=3)
except Exception as error:
    sys.exit(f"refused: {type(error).__name__}")
print(client.submit(lambda: 1).result(timeout=3))
"""


@pytest.mark.filterwarnings("ignore")
def test_the_processes_of_this_computer_take_work_from_nobody_else() -> None:
    with cluster(workers=1) as client:
        assert client is not None
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:")
        for tried in (address, address.replace("tls://", "tcp://")):
            done = subprocess.run([sys.executable, "-c", STRANGER, tried], capture_output=True, text=True, timeout=60)
            assert done.returncode == 1
            assert done.stderr.splitlines()[-1].startswith("refused")
        assert client.submit(sum, [1, 2]).result() == 3


def test_an_open_scheduler_is_reported(
    tmp_path: Path, ur5e: Arm, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_recording(tmp_path / "plant" / "cell-0" / "a.mcap", ur5e, ur5e, 1, seconds=2.0)
    monkeypatch.setattr("calib.fleet.engine.CONNECT_SECONDS", 0.5)
    arguments = ["fleet", str(tmp_path / "plant"), "--scheduler", "tcp://127.0.0.1:9", "--out", str(tmp_path / "out")]
    assert program.main(arguments) == 2
    printed = capsys.readouterr().err
    assert "without TLS, anyone who can reach this scheduler can run programs" in printed
    assert "does not answer" in printed


@pytest.mark.slow
def test_the_parts_of_an_extra_are_requested_by_name(tmp_path: Path) -> None:
    (tmp_path / "plant").mkdir()
    (tmp_path / "log.csv").write_text("t,q1\n0.0,1.0\n0.1,1.0\n")
    hidden = "import sys; sys.modules.update(dict.fromkeys(('dask', 'distributed', 'pyarrow', 'fsspec')))\nfrom calib.main import main\n"
    for words, name in ((["fleet", str(tmp_path / "plant")], "fleet"), (["import", str(tmp_path / "log.csv")], "tables")):
        done = subprocess.run(
            [sys.executable, "-c", f"{hidden}sys.exit(main({words!r}))"],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            timeout=60,
        )
        assert done.returncode == 2, done.stderr
        assert f"pip install 'arm-calib[{name}]'" in done.stderr
        assert "Traceback" not in done.stderr


def test_an_answer_that_was_spoilt_on_disk_is_done_again(tmp_path: Path, ur5e: Arm) -> None:
    write_recording(tmp_path / "plant" / "cell-0" / "a.mcap", ur5e, ur5e, 1)
    (job,) = (Job(arm_id, ur5e, own, diagnose=False) for arm_id, own in by_arm(inventory(str(tmp_path / "plant"))[0]).items())
    row = {"arm": job.arm_id, "status": "done", "digest": job.digest, "parameters": ["m"]}
    kept = Answer(job.arm_id, ArmStatus.DONE, row, {}, ("m",), np.ones(1), np.eye(1))
    folder = tmp_path / "arms" / job.arm_id
    store(folder, kept)
    assert stored(folder, job) is not None
    for name, content in (
        ("answer.json", b"[]"), ("answer.json", json.dumps(row | {"colour": "red"}).encode()), ("answer.json", b"{" * 5000),
        ("estimate.npz", b"PK"), ("estimate.npz", with_objects()), ("estimate.npz", b""),
    ):  # fmt: skip
        store(folder, kept)
        (folder / name).write_bytes(content)
        assert stored(folder, job) is None
