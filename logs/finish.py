"""Turn a journal into a finished MCAP file: chunks, zstd, indexes, statistics, CRCs; verified, then put in place in one step."""

from __future__ import annotations

import os
from collections.abc import Callable
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path

import numpy as np
from mcap.writer import Writer

from logs.clock_fit import ClockFit, fit_clocks
from logs.damage import Damage
from logs.mcap_records import MESSAGE
from logs.mcap_stream import McapStream
from logs.schemas import RECORDING, STATES
from sim.errors import DeviceError

LIBRARY = "arm-calib"


def finish(journal: Path, state: str, words: dict[str, str], target: Path | None = None) -> tuple[str, ...]:
    """Replace the journal by a finished file of the same name, or write `target` and keep the journal; return findings.

    `words` join the journal's own metadata in the record `recording`. The finished file is written beside its place, synced,
    read back, counted, and only then renamed. At every instant there is one whole file under the name.
    """
    damage = Damage(journal, accept_partial=state != "clean")
    target = target or journal
    part = target.with_name(target.name + ".part")

    def body(writer: Writer) -> dict[int, int]:
        with journal.open("rb") as file:
            stream = McapStream(file, journal.stat().st_size, damage, attachments={})
            numbers: dict[int, int] = {}
            clocks: list[np.ndarray] = []
            batches = stream.batches()
            first = next(
                batches, None
            )  # a journal begins with its metadata, and so does the file: one that is cut short still has it
            own = {key: value for key, value in stream.metadata.pop(RECORDING, {}).items() if key not in ("ring", "boot")}
            writer.add_metadata(RECORDING, own | words | {"state": state})
            for batch in [] if first is None else chain([first], batches):
                heads = batch.heads
                states = [number for number, channel in stream.channels.items() if channel.topic == STATES]
                clocks.append(heads[["publish", "log"]][np.isin(heads["channel"], states)])
                rows = zip(
                    batch.starts.tolist(), heads["length"].tolist(), heads["channel"].tolist(), heads["sequence"].tolist(),
                    heads["log"].tolist(), heads["publish"].tolist(), strict=True,
                )  # fmt: skip
                for start, length, channel, sequence, log, publish in rows:
                    if channel not in numbers:
                        numbers[channel] = _register(writer, stream, channel)
                    data = batch.data[start + MESSAGE.itemsize : start + 9 + length]
                    writer.add_message(numbers[channel], log, data, publish, sequence)
            for item in (stream.attachments or {}).values():
                writer.add_attachment(item.create_time, item.log_time, item.name, item.media_type, item.data)
            for name, record in stream.metadata.items():
                writer.add_metadata(name, record)
            add_clock_fit(writer, _fit(clocks))
            if stream.unsealed:
                damage.note(f"the last {stream.unsealed} bytes are an incomplete sample and are left out")
            return {numbers[channel]: count for channel, count in stream.counts.items()}

    write_file(part, body)
    put_in_place(part, target)
    return damage.all_findings()


def killed_sentence(samples: int, last: int | None, lost: str = "at most 1 lost") -> str:
    """When a recording was killed (`last`: host clock of its last sample, ns since 1970), and how much of it there is."""
    if not samples or last is None:
        return "killed before the first sample"
    return f"killed at {datetime.fromtimestamp(last * 1e-9, UTC):%H:%M:%S} UTC, {samples:,} samples, {lost}"


def add_clock_fit(writer: Writer, fit: ClockFit | None) -> None:
    """Add the metadata record `clock_fit`, where there is a fit."""
    if fit is not None:
        writer.add_metadata("clock_fit", fit.text())


def _fit(clocks: list[np.ndarray]) -> ClockFit | None:
    times = np.concatenate(clocks) if clocks else np.empty(0, dtype=[("publish", "<u8"), ("log", "<u8")])
    if not len(times):
        return None
    device, host = (times[name].astype(np.int64) for name in ("publish", "log"))
    if np.any(np.diff(device) < 0):
        return None
    return fit_clocks((device - device[0]) * 1e-9, (host - host[0]) * 1e-9)


def write_file(part: Path, body: Callable[[Writer], dict[int, int]]) -> None:
    """Write an MCAP file with `body`, sync it and read it back; `body` returns the number of messages on each channel."""
    try:
        with part.open("wb") as file:
            writer = Writer(file, enable_data_crcs=True)
            writer.start("ros2", LIBRARY)
            counts = body(writer)
            writer.finish()
            file.flush()
            os.fsync(file.fileno())
        with part.open("rb") as file:
            stream = McapStream(file, part.stat().st_size, Damage(part))
            for _ in stream.batches():
                pass
        if stream.counts != {channel: count for channel, count in counts.items() if count}:
            raise DeviceError(
                f"{part}: reads back {stream.counts} messages where {counts} were written; do not trust this disk"
            )
    except OSError as error:
        part.unlink(missing_ok=True)
        raise DeviceError(
            f"{part}: cannot be written ({error.strerror}); free space or use another disk, then finish it with `calib import`"
        ) from error
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def put_in_place(part: Path, target: Path) -> None:
    """Rename the file, and sync the folder so that the rename survives a power cut."""
    os.replace(part, target)
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _register(writer: Writer, stream: McapStream, number: int) -> int:
    channel = stream.channels[number]
    schema = writer.register_schema(channel.schema, channel.schema_encoding, channel.definition.encode())
    return writer.register_channel(channel.topic, channel.encoding, schema, channel.metadata)
