"""`read_log` and the pieces of a large file give the same samples and the same refusals."""

from __future__ import annotations

import errno
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from logs import Log, pieces, read_log, spool
from logs.log import CHANNELS
from logs.schemas import COMMANDS, DIAGNOSTICS, SCHEMAS, STATES
from sim.errors import BadLog, DeviceError
from tests.logs.conftest import JOINTS, cdr, joint_message

COUNT = 600
STATE, DIAGNOSTIC = "sensor_msgs/msg/JointState", "calib_msgs/msg/JointDiagnostics"
Message = tuple[str, int, int, dict[str, Any]]  # topic, stamp and log time in ns, arrays


def messages() -> list[Message]:
    """Samples at 500 Hz with commands, and drive readings with their own stamps."""
    out: list[Message] = []
    for k in range(COUNT):
        at = 1_700_000_000_000_000_000 + k * 2_000_000
        q = 0.5 * np.sin(0.01 * k * np.array([1.0, 1.3, 1.7]))
        out.append((STATES, at, at + 5_000_000, {"position": q, "velocity": q + 1, "effort": q + 2}))
        out.append((COMMANDS, at, at + 5_000_000, {"position": q, "velocity": [], "effort": []}))
        if k % 20 == 0:
            out.append((DIAGNOSTICS, at + 700_000, at + 5_700_000, {"current": q * 10, "temperature": [30.0] * 3}))
    return out


def written(path: Path, content: list[Message], names: tuple[str, ...] = JOINTS) -> Path:
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=8_000)
    writer.start("ros2", "a test")
    schemas = {kind: writer.register_schema(kind, "ros2msg", SCHEMAS[kind].encode()) for kind in (STATE, DIAGNOSTIC)}
    channels: dict[str, int] = {}
    for topic, stamp, log, arrays in content:
        kind = DIAGNOSTIC if topic.endswith(DIAGNOSTICS) else STATE
        if topic not in channels:
            channels[topic] = writer.register_channel(topic, "cdr", schemas[kind])
        writer.add_message(channels[topic], log, cdr(kind, joint_message(stamp, names, **arrays)), stamp, 0)
    writer.finish()
    path.write_bytes(stream.getvalue())
    return path


def in_state(k: int, **arrays: Any) -> Callable[[list[Message]], list[Message]]:
    """Replace arrays of the k-th sample."""

    def change(content: list[Message]) -> list[Message]:
        at = [i for i, m in enumerate(content) if m[0] == STATES][k]
        topic, stamp, log, own = content[at]
        return [*content[:at], (topic, stamp, log, own | arrays), *content[at + 1 :]]

    return change


def under(name: str, only: bool = False) -> Callable[[list[Message]], list[Message]]:
    """Add a second arm with other positions under the namespace `name`; with `only`, remove the first."""

    def change(content: list[Message]) -> list[Message]:
        out: list[Message] = []
        for topic, stamp, log, arrays in content:
            out.append((f"{name}{topic}", stamp, log, {key: np.array(value) + 0.1 for key, value in arrays.items()}))
            out += [] if only else [(topic, stamp, log, arrays)]
        return out

    return change


def swapped(content: list[Message]) -> list[Message]:
    """Swap every tenth sample with the next one, as the threads of a recorder may."""
    at = [i for i, m in enumerate(content) if m[0] == STATES]
    for k in range(3, len(at) - 1, 10):
        content[at[k]], content[at[k + 1]] = content[at[k + 1]], content[at[k]]
    return content


def shifted(by: int, first: int, last: int = COUNT) -> Callable[[list[Message]], list[Message]]:
    """Shift the device stamps of samples `first` to `last` - 1 by `by` ns; log times stay."""

    def change(content: list[Message]) -> list[Message]:
        k, out = -1, []
        for topic, stamp, log, arrays in content:
            k += topic == STATES
            out.append((topic, stamp + by if first <= k < last else stamp, log, arrays))
        return out

    return change


CHANGES: dict[str, Callable[[list[Message]], list[Message]]] = {
    "nothing": lambda content: content,
    "a second arm": under("/left"),
    "an arm under a namespace": under("/left", only=True),
    "two arms under namespaces": lambda content: under("/right")(under("/left", only=True)(content)),
    "no commands and readings": lambda content: [m for m in content if m[0] == STATES],
    "two sources of commands": lambda content: [
        *[m for m in content if m[0] != COMMANDS],
        *[(f"/{arm}{m[0]}", *m[1:]) for m in content if m[0] == COMMANDS for arm in "ab"],
    ],
    "no stamps": lambda content: [(topic, 0, log, arrays) for topic, _, log, arrays in content],
    "swapped pairs": swapped,
    "swapped pairs and a bad sample": lambda content: in_state(404, position=[0.0, np.nan, 0.0])(swapped(content)),
    "time runs back": shifted(-5_000_000, 300),
    "time runs back twice": lambda content: shifted(-9_000_000, 400)(shifted(-5_000_000, 200)(content)),
    "a counter that wraps around": shifted(-(2**32) * 1_000, 300),
    "the same stamp": shifted(-2_000_000, 300, 301),
    "no position": in_state(333, position=[0.0, np.nan, 0.0]),
    "two bad samples": lambda content: in_state(500, effort=[np.inf] * 3)(in_state(21, effort=[0.0, 1e9, 0.0])(content)),
    "no speed of an arm": in_state(250, velocity=[0.0, 0.0, 1e6]),
    "a jump": in_state(411, position=[0.0, 9.0, 0.0]),
    "a temperature of none": lambda content: [
        (t, s, log, {**a, "temperature": [1e6] * 3}) if t == DIAGNOSTICS and k > 300 else (t, s, log, a)
        for k, (t, s, log, a) in enumerate(content)
    ],
    "readings out of order": lambda content: [
        (t, s - 90_000_000 * (t == DIAGNOSTICS and k % 4 == 0), log, a) for k, (t, s, log, a) in enumerate(content)
    ],
    "commands at instants of their own": lambda content: [
        (t, s + 900_000 * (t == COMMANDS), log, a) for k, (t, s, log, a) in enumerate(content) if t != COMMANDS or k % 3
    ],
    "torques from the middle on": lambda content: [
        (t, s, log, {**a, "effort": []}) if t == STATES and k < len(content) // 2 else (t, s, log, a)
        for k, (t, s, log, a) in enumerate(content)
    ],
}


def outcome(read: Callable[[], Log]) -> Log | str:
    """The log, or the text of the refusal."""
    try:
        return read()
    except BadLog as error:
        return str(error)


@pytest.mark.parametrize("accept_partial", [False, True], ids=["strict", "partial"])
@pytest.mark.parametrize("names", [JOINTS, JOINTS[::-1], ("other", *JOINTS[1:]), ("x", "y")], ids="-".join)
@pytest.mark.parametrize("change", CHANGES)
def test_a_recording_is_read_the_same_whichever_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str, names: tuple[str, ...], accept_partial: bool
) -> None:
    monkeypatch.setattr(pieces, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(spool, "ROWS", 64)
    file = written(tmp_path / "log.mcap", CHANGES[change](messages()))

    def unpacked() -> Log:
        (log,) = pieces.open_pieces(file, names, tmp_path / "spool", accept_partial)
        return log

    whole = outcome(lambda: read_log(file, names, accept_partial=accept_partial))
    part = outcome(unpacked)
    if isinstance(whole, str) or isinstance(part, str):
        assert part == whole
        return
    for name in ("t", *CHANNELS):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name), err_msg=name)
    for name in ("joint_names", "t_origin", "state", "metadata", "findings"):
        assert getattr(part, name) == getattr(whole, name)
    recorded = {"t", *(name for name in CHANNELS if np.isfinite(getattr(whole, name)).any())}
    assert {f.name for f in (tmp_path / "spool").iterdir()} == recorded


def test_the_cases_are_both_read_and_refused(tmp_path: Path) -> None:
    told = {
        change: outcome(lambda c=change: read_log(written(tmp_path / "a.mcap", CHANGES[c](messages())))) for change in CHANGES
    }
    refused = {change for change, what in told.items() if isinstance(what, str)}
    assert refused == {
        "two arms under namespaces", "two sources of commands", "swapped pairs and a bad sample", "time runs back",
        "time runs back twice", "no position", "two bad samples", "no speed of an arm", "a jump", "a temperature of none",
    }  # fmt: skip


def test_a_full_disk_is_no_fault_of_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*about: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "concatenate", full)
    file = written(tmp_path / "log.mcap", messages())
    with pytest.raises(DeviceError, match=r"spool: cannot be written \(No space left on device\); free space"):
        spool.spool(file, JOINTS, tmp_path / "spool")
