"""The messages of one topic as arrays by joint name: messages of one layout are decoded together, all others one by one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from logs.cdr import CdrError, Layout, joint_layout
from logs.damage import Damage
from logs.mcap_records import MESSAGE, Batch

BLOCK = 1 << 16  # rows after which the pieces are joined
MAX_LAYOUTS = 8  # layouts tried on a batch before its remaining messages are parsed one by one


@dataclass
class JointTopic:
    """Messages of one topic, decoded in pieces: stamps, host times and values in the order of `wanted`.

    Without `wanted`, the joints are those of the message with the most joints in the first batch. others: joints of messages
    that name none of `wanted` -> their number. The total is exact; only the first MAX_LAYOUTS sets are kept.
    """

    topic: str
    fields: int
    wanted: tuple[str, ...] | None
    damage: Damage
    stamp: list[np.ndarray] = field(default_factory=list)
    host: list[np.ndarray] = field(default_factory=list)
    sequence: list[np.ndarray] = field(default_factory=list)
    values: list[list[np.ndarray]] = field(default_factory=list)
    others: dict[tuple[str, ...], int] = field(default_factory=dict)
    taken: int = 0  # messages, including those dropped by `clear`
    last_host: int | None = None
    layouts: dict[int, list[Layout]] = field(default_factory=dict)
    _loose: int = 0

    def take(self, batch: Batch, starts: np.ndarray, heads: np.ndarray) -> None:
        """Decode the messages at `starts`; those of one size and layout together."""
        count = len(starts)
        stamp = np.zeros(count, dtype=np.int64)
        sound = np.zeros(count, dtype=bool)
        values: list[np.ndarray | None] = [None] * self.fields
        sizes = heads["length"].astype(np.int64) - (MESSAGE.itemsize - 9)
        if self.wanted is None:
            self.wanted = self._most_joints(batch, starts, sizes)
        for size in sizes[:1].tolist() if np.all(sizes == sizes[:1]) else np.unique(sizes).tolist():
            left = np.flatnonzero(sizes == size)
            rows = batch.payloads(starts[left], size) if size else np.empty((len(left), 0), dtype=np.uint8)
            known = self.layouts.setdefault(size, [])
            tried = 0
            while len(left):
                layout = known[tried] if tried < len(known) else self._parsed(rows[0], batch, starts[left[0]])
                if layout is None:
                    left, rows = left[1:], rows[1:]
                    continue
                if tried >= len(known) and len(known) < MAX_LAYOUTS:
                    known.append(layout)
                # beyond MAX_LAYOUTS every message is parsed by itself: slow, but correct and never quadratic
                if tried >= MAX_LAYOUTS:
                    places, matching, left, rows = left[:1], rows[:1], left[1:], rows[1:]
                elif (match := layout.matches(rows)).all():
                    places, matching, left = left, rows, left[:0]
                else:
                    places, matching, left, rows = left[match], rows[match], left[~match], rows[~match]
                tried += 1
                if len(places):
                    stamp[places], sound[places] = layout.stamps(matching)
                    self._late(batch, starts[places[~sound[places]]])
                    self._place(layout, matching, places, values, sound, count, batch, starts)
        self._append(stamp, heads["log"].astype(np.int64), heads["sequence"].astype(np.int64), values, sound)

    def _most_joints(self, batch: Batch, starts: np.ndarray, sizes: np.ndarray) -> tuple[str, ...] | None:
        """Names of the largest set of joints among the first messages of each size, the earlier on a tie; None if unreadable."""
        most: tuple[str, ...] | None = None
        for k in np.sort(np.unique(sizes, return_index=True)[1]).tolist():
            if not sizes[k]:
                continue
            try:
                names = joint_layout(batch.payloads(starts[k : k + 1], int(sizes[k]))[0].tobytes(), self.fields).names
            except CdrError:
                continue  # reported where it is read
            most = names if most is None or len(names) > len(most) else most
        return most

    def _parsed(self, row: np.ndarray, batch: Batch, start: int) -> Layout | None:
        try:
            return joint_layout(row.tobytes(), self.fields)
        except CdrError as error:
            self.damage.report(f"{batch.where}, message on {self.topic} at byte {start} in it", str(error))
            return None

    def _late(self, batch: Batch, starts: np.ndarray) -> None:
        if len(starts):
            self.damage.report(f"{batch.where}, message on {self.topic} at byte {starts[0]} in it", "a stamp with over 1e9 ns")

    def _place(
        self, layout: Layout, rows: np.ndarray, places: np.ndarray, values: list[np.ndarray | None], sound: np.ndarray,
        count: int, batch: Batch, starts: np.ndarray,
    ) -> None:  # fmt: skip
        """Write the values of matching messages to their columns, by joint name."""
        wanted = self.wanted = layout.names if self.wanted is None else self.wanted
        missing = [name for name in wanted if name not in layout.names]
        if missing or not wanted:
            if len(missing) == len(wanted):
                joints = layout.names if len(self.others) < MAX_LAYOUTS else next(iter(self.others))
                self.others[joints] = self.others.get(joints, 0) + len(places)
            else:
                self.damage.report(
                    f"{batch.where}, message on {self.topic} at byte {starts[places[0]]} in it",
                    f"joints {', '.join(missing)} are missing; it names {', '.join(layout.names)}",
                )
            sound[places] = False
            return
        columns = [layout.names.index(name) for name in wanted]
        as_they_stand = len(places) == count and layout.names == wanted
        for k in range(self.fields):
            part = layout.values(rows, k)
            if part is None:
                continue
            if as_they_stand:
                values[k] = part
                continue
            target = values[k]
            if target is None:
                target = values[k] = np.full((count, len(wanted)), np.nan)
            target[places] = part[:, columns]

    def _append(
        self, stamp: np.ndarray, host: np.ndarray, sequence: np.ndarray, values: list[np.ndarray | None], sound: np.ndarray
    ) -> None:  # fmt: skip
        if not sound.any():
            return
        if not sound.all():
            stamp, host, sequence = stamp[sound], host[sound], sequence[sound]
            values = [None if part is None else part[sound] for part in values]
        nothing = np.broadcast_to(np.float64(np.nan), (len(stamp), len(self.wanted or ())))
        self.taken, self.last_host = self.taken + len(stamp), int(host[-1])
        self.stamp.append(stamp)
        self.host.append(host)
        self.sequence.append(sequence)
        self.values.append([nothing if part is None else part for part in values])
        self._loose += len(stamp)
        if self._loose >= BLOCK:
            for times in (self.stamp, self.host, self.sequence):
                times[:] = [_grown(times)]
            self.values = [[_grown([parts[k] for parts in self.values]) for k in range(self.fields)]]
            self._loose = 0

    def clear(self) -> None:
        """Drop the messages taken so far, but keep their layouts."""
        self.stamp, self.host, self.sequence, self.values, self._loose = [], [], [], [], 0

    def joined(self, k: int) -> np.ndarray:
        """(M, n) values of field k; its pieces are released, so that memory never holds all of them twice."""
        pieces = [parts[k] for parts in self.values]
        for parts in self.values:
            parts[k] = np.empty((0, 0))
        return _grown(pieces) if pieces else np.empty((0, len(self.wanted or ())))


def _grown(pieces: list[np.ndarray]) -> np.ndarray:
    """Concatenate the pieces, which are unusable afterwards: the first grows, where it can, without being held twice."""
    first, rest, count = pieces[0], pieces[1:], sum(map(len, pieces))
    at, shape = len(first), (count, *first.shape[1:])
    if not any(piece.strides[0] for piece in pieces):
        return np.broadcast_to(np.float64(np.nan), shape)
    if not (first.flags.owndata and first.flags.writeable and first.flags.c_contiguous):
        first = first.copy()
    first.resize(shape, refcheck=False)
    for piece in rest:
        first[at : at + len(piece)] = piece
        at += len(piece)
    return first
