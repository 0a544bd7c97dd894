"""Convert any recording to a finished file of our own: import ur_rtde CSV, ROS bags and tables, recover open and damaged files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from mcap.writer import Writer

from logs.clock_fit import fit_clocks
from logs.column_map import ColumnMap
from logs.damage import Damage
from logs.encode import JointEncoder, log_body
from logs.finish import add_clock_fit, finish, put_in_place, write_file
from logs.log import COMMANDED, Log, State
from logs.mcap_records import is_journal
from logs.read import read_log
from logs.sampling import Sampling, examine
from logs.schemas import (
    COMMANDS,
    DEVICE_CLOCK,
    DIAGNOSTICS,
    EVENTS,
    FRAME,
    NO_HOST_CLOCK,
    RECORDING,
    SCHEMAS,
    STAMPS_END,
    STATES,
    TOPICS,
    UNITS,
)
from logs.table_log import log_of_table
from logs.tables import FORMATS, Table, read_table
from logs.tables.table import HEAD
from logs.timing import coarse, finer, shared_stamps
from sim.errors import BadLog, DeviceError
from sim.files import is_name
from sim.version import software_version


@dataclass(frozen=True)
class Imported:
    """The finished file and its log, how the source had ended, what did not survive (sentences), and how it was sampled."""

    source: Path
    path: Path
    log: Log
    ended: State
    left_out: tuple[str, ...]
    sampling: Sampling


def table_of(source: Path) -> Table | None:
    """Return the columns of a file whose meaning must be stated; None for a recording that states it, or an unknown format."""
    from logs.mcap_records import MAGIC
    from logs.ur_rtde_csv import looks_like_csv

    if source.is_file():
        with source.open("rb") as file:
            head = file.read(HEAD)
        if head.startswith((MAGIC, b"SQLite format 3", b"#ROSBAG")) or looks_like_csv(head):
            return None
    damage = Damage(source, accept_partial=True)
    known = any(form.recognises(head if source.is_file() else None, source) for form in FORMATS)
    return read_table(source, FORMATS, damage) if known else None


def import_recording(
    source: str | Path, target: str | Path, columns: ColumnMap | None = None, change: Callable[[Log], Log] | None = None,
    joint_names: Sequence[str] | None = None, arm: Mapping[str, str] = MappingProxyType({}),
) -> Imported:  # fmt: skip
    """Write what survives of `source` to the new file `target`; BadLog where nothing does, DeviceError where `target` exists.

    The file is clean if the source was whole, killed if its program was killed, and otherwise aborted: identification then
    refuses it unless --accept-partial is given. A journal is copied message by message, unless `change` altered it. Anything
    else is read into a Log, in which joints, times and values are checked, and written again. Samples that repeat the one
    before are left out. Where the source has only one clock and its stamps jitter, the sample times are rebuilt and the stamps
    kept as host times (`logs.sampling`). Both are reported.

    columns      meaning of the columns; needed for a table
    change       may refuse the log (raise) or return another reading of it, before it is written
    joint_names  joints asked for (`read_log`), where `source` is not a table
    arm          metadata added where the recording does not state its arm
    """
    source, target = Path(source), Path(target)
    if target.exists():
        raise DeviceError(f"{target}: exists already; recordings are never overwritten, give another folder with --out")
    target.parent.mkdir(parents=True, exist_ok=True)
    if columns is None:
        log = read_log(source, joint_names, accept_partial=True)
    else:
        damage = Damage(source, accept_partial=True)
        log = log_of_table(read_table(source, FORMATS, damage), columns, source, damage)
    whole = log.state in (State.CLEAN, State.UNSTATED, State.KILLED)
    state = "killed" if log.state is State.KILLED else "clean" if whole else "aborted"
    ended = log.state
    reason = log.metadata.get("end_reason") or ("imported" if whole else f"recovered: {ended.value}")
    unresolved = coarse(log.t, log.q, log.dq, log.tau, log.current)
    if change is None and unresolved:  # a `change` checks this itself
        raise BadLog(f"{source}: time: {unresolved}; {finer(log.metadata)}")
    read = log if change is None else change(log)
    journal = source.is_file() and is_journal(source) and read is log
    log, sampling = (log, sampling_of(log)) if journal else _resampled(read)
    words = {"end_reason": reason, "imported_from": source.name, "imported_by": software_version()}
    words["sampling"] = json.dumps(list(sampling.findings), ensure_ascii=False)
    words |= {} if log.metadata.get("arm") else arm
    if log.findings:
        words["findings"] = json.dumps(log.findings, ensure_ascii=False)
    if journal:
        finish(source, state, words, target)
    else:
        write_log(log, target, state, words)
    return Imported(source, target, read_log(target, log.joint_names, accept_partial=True), ended, log.findings, sampling)


def sampling_of(log: Log) -> Sampling:
    """How the samples of a log were taken; no value is added."""
    if np.any(np.diff(log.t) < 0) or not np.isfinite(log.q).all():
        log = log.part(np.isfinite(log.q).all(axis=1))
    others = {name: getattr(log, name) for name in ("tau", "current") if np.isfinite(getattr(log, name)).any()}
    return examine(log.t, log.q, log.dq, others, bridging=False)


def _resampled(log: Log) -> tuple[Log, Sampling]:
    """Return the log at its sample times without repeated samples, and how it was sampled.

    Where a host clock is recorded too, or values of q are missing, only samples that share the stamp of the one before are left
    out.
    """
    found = sampling_of(log)
    alone = not np.isfinite(log.t_host).any() and np.isfinite(log.q).all()
    if not alone or (not found.rebuilt and len(found.source) == len(log)):
        return _without_duplicates(log), found
    kept = log.part(found.source)
    if not found.rebuilt:
        return kept, found
    shift = round(float(found.t[0]) * 1e9)
    return replace(
        kept, t=found.t - found.t[0], t_host=kept.t - kept.t[0], t_origin=max(log.t_origin + shift, 0),
        t_host_origin=log.t_origin + round(float(kept.t[0]) * 1e9),
    ), found  # fmt: skip


def _without_duplicates(log: Log) -> Log:
    """Keep the first of samples that share a stamp: two readings at one instant have no derivative."""
    keep = np.r_[True, np.diff(log.t) > 0]
    if keep.all():
        return log
    return replace(log.part(keep), findings=(*log.findings, f"left out: {shared_stamps(int((~keep).sum()))}"))


def write_log(log: Log, target: Path, state: str, words: dict[str, str]) -> None:
    """Write the log as a finished MCAP file; `words` join its metadata in the record `recording`."""
    channels = {topic: k for k, topic in enumerate(TOPICS, start=1)}
    stamps = log.t_origin + np.rint(log.t * 1e9).astype(np.int64)
    has_host = bool(np.isfinite(log.t_host).all())
    hosts = log.t_host_origin + np.rint(log.t_host * 1e9).astype(np.int64) if has_host else stamps
    offset = int(hosts[0] - stamps[0])
    stamps = stamps + offset
    if not 0 <= min(int(stamps.min()), int(hosts.min())) <= max(int(stamps.max()), int(hosts.max())) < STAMPS_END:
        raise BadLog(
            f"{target}: instants from {stamps.min() * 1e-9:.6g} to {stamps.max() * 1e-9:.6g} s since 1970 cannot be written (1970 to 2038); "
            "check the time unit and the clock"
        )
    frame = log.metadata.get(FRAME, "")
    encoder = JointEncoder(log.joint_names, frame if is_name(frame) else "")
    slow = bool(np.isfinite(log.current).any() or np.isfinite(log.temperature).any())
    commanded = any(np.isfinite(getattr(log, channel)).any() for channel in COMMANDED)
    sources: list[tuple[str, tuple[np.ndarray, ...]]] = [(STATES, (log.q, log.dq, log.tau))]
    sources += [(COMMANDS, (log.q_cmd, log.dq_cmd, log.tau_cmd))] if commanded else []
    sources += [(DIAGNOSTICS, (log.current, log.temperature))] if slow else []

    def body(writer: Writer) -> dict[int, int]:
        numbers = {kind: writer.register_schema(kind, "ros2msg", text.encode()) for kind, text in SCHEMAS.items()}
        for topic, kind in TOPICS.items():
            writer.register_channel(topic, "cdr", numbers[kind], UNITS[topic])
        own = {key: value for key, value in log.metadata.items() if not key.startswith(f"{DEVICE_CLOCK}.")}
        about = own | words | {"state": state, "samples": str(len(log)), "joint_names": json.dumps(log.joint_names)}
        writer.add_metadata(
            RECORDING, about if has_host else about | NO_HOST_CLOCK
        )  # first: a file that is cut short still has it
        for k, (stamp, host) in enumerate(zip(stamps.tolist(), hosts.tolist(), strict=True)):
            for topic, arrays in sources:
                data = encoder.body(stamp, [np.ascontiguousarray(array[k]) for array in arrays])
                writer.add_message(channels[topic], host, data, stamp, k)
        for k, event in enumerate(log.events):
            stamp = max(log.t_origin + round(event.t * 1e9) + offset, 0)
            data = log_body(stamp, event.level, event.name, event.message)
            writer.add_message(channels[EVENTS], int(hosts[-1]), data, stamp, k)
        if offset:
            writer.add_metadata(DEVICE_CLOCK, {"offset_ns": str(offset)})
        add_clock_fit(writer, fit_clocks(log.t, log.t_host))
        return {channels[topic]: len(log) for topic, _ in sources} | {channels[EVENTS]: len(log.events)}

    part = target.with_name(target.name + ".part")
    write_file(part, body)
    put_in_place(part, target)
