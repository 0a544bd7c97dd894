"""Groups of columns that belong to one channel and differ only in the joint; the choice among several such groups."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from logs.column_names import (
    ACCELERATIONS,
    ACTION,
    ASIDE,
    COMMANDED,
    MEASURED,
    UNIT_WORDS,
    VAGUE,
    WORDS,
    apart,
    stated_unit,
    unknown_unit,
    words_of,
)
from logs.tables.table import Table
from logs.unit_guess import follows
from logs.units import UNITS

Group = dict[str, str]  # joint's key -> column


@dataclass(frozen=True)
class _Name:
    """A column's name, parsed.

    words    words of the name, without those of the arm's joint
    joint    name of that joint, "" where there is none
    text     text in brackets that is not a number
    hit      word that decides the channel
    channel  "" where there is none
    """

    name: str
    words: tuple[str, ...]
    joint: str
    text: str
    hit: str
    channel: str

    @property
    def stem(self) -> tuple[str, ...]:
        return tuple(word for word in self.words if not word.isdigit())

    @property
    def numbers(self) -> tuple[str, ...]:
        return tuple(word for word in self.words if word.isdigit())

    @property
    def meaning(self) -> tuple[str, ...]:
        return tuple(word for word in self.words if word in {self.hit} | COMMANDED | MEASURED | ASIDE | set(UNIT_WORDS))

    @property
    def rest(self) -> tuple[str, ...]:
        return tuple(word for word in self.words if word not in self.meaning)


def groups_of(names: Sequence[str], joint_names: Sequence[str] | None) -> dict[str, list[Group]]:
    """Channel -> its groups of columns.

    Joint names of the arm are looked for first. They count only where one channel has all of them.
    """
    out: dict[str, list[Group]] = defaultdict(list)
    joints = _named_joints(joint_names)
    read = _channels(names, joints)
    named = _by(read, lambda x: (x.channel, x.words) if x.joint else None)
    if any(len({x.joint for x in part}) == len(joints) for part in named.values()):
        for part in named.values():
            out[part[0].channel] += _unique((x.joint, x.name) for x in part)
        read = [x for x in read if not x.joint]
    else:
        read = _channels(names, ())
    behind = _by(read, lambda x: (x.channel, x.stem) if x.text else None)
    for part in behind.values():
        if _tell_joints(part):
            out[part[0].channel] += _unique((re.sub(r"[._ ](pos|position)$", "", x.text), x.name) for x in part)
            taken = {x.name for x in part}
            read = [x for x in read if x.name not in taken]
    for part in _by(read, lambda x: (x.channel, x.meaning)).values():
        out[part[0].channel] += _of_one_meaning(part)
    return out


def keys_of(names: Sequence[str], joint_names: Sequence[str] | None) -> list[str]:
    """Joint keys of the columns of one group; "" for an empty name, and for all where the names give no distinct keys."""
    there = [name for name in names if name]
    named, read = ([_read(name, joints, "q") for name in there] for joints in (_named_joints(joint_names), ()))
    ways = (
        [x.joint for x in named],
        [x.text for x in read if _tell_joints(read)],
        [x.numbers[-1] if x.numbers else "" for x in read],
        _called(read),
    )
    keys = next((keys for keys in ways if len(set(keys) - {""}) == len(there)), [""] * len(there))
    found = dict(zip(there, keys, strict=True))
    return [found.get(name, "") for name in names]


def best_of(
    channel: str, groups: Sequence[Group], keys: Sequence[str] | None, wanted: int | None, moving: Sequence[str] = ()
) -> Group:
    """Return the group of a channel that has the most joints of `keys`.

    Where `keys` is None: the group with `wanted` joints, else the one with the most. Ties are decided in this order: a group in
    `moving` (first columns of groups that follow a speed), one with exact words, one called measured, the shortest first name.
    """

    def rank(group: Group) -> tuple[bool, int, bool, bool, bool, int]:
        first = next(iter(group.values()))
        words = set(words_of(first))
        joints = len(group) if keys is None else sum(key in group for key in keys)
        exact = not words & (ASIDE | VAGUE | {"g"}) and not unknown_unit(channel, list(group.values()))  # g: torque of gravity
        return len(group) == wanted, joints, first in moving, exact, bool(words & MEASURED), -len(first)

    return max(groups, key=rank)


def following(table: Table, groups: Sequence[Group], speed: Group, t: np.ndarray, rows: np.ndarray) -> list[str]:
    """First columns of the groups of positions in which most joints are the integral of the speed."""
    out = []
    for group in groups:
        pairs = [(name, speed[key]) for key, name in group.items() if key in speed]
        if len(group) == len(speed) == 1:
            pairs = list(zip(group.values(), speed.values(), strict=True))
        found = [follows(table, q, dq, t, rows) for q, dq in pairs if dq in table.columns]
        if found and np.mean(found) > 0.5:
            out.append(next(iter(group.values())))
    return out


def _channels(names: Sequence[str], joint_names: Sequence[str]) -> list[_Name]:
    return [x for x in (_read(name, joint_names) for name in names) if x.channel]


def _read(name: str, joint_names: Sequence[str], channel: str = "") -> _Name:
    before, text = apart(name)
    words, joint = words_of(before), ""
    if text.isdigit():
        words, text = [*words, text], ""
    hit = _hit(words)
    if not hit and _hit(words_of(name)):  # joint1 [pos]
        words, text = words_of(name), ""
        hit = _hit(words)
    everywhere = [*words, *words_of(text)]
    for candidate in sorted(joint_names, key=len, reverse=True):
        wanted = words_of(candidate)
        at = next((k for k in range(len(everywhere)) if everywhere[k : k + len(wanted)] == wanted), None)
        if wanted and at is not None and _hit(others := [*everywhere[:at], *everywhere[at + len(wanted) :]]):
            words, joint, hit = others, candidate, _hit(others)
            break
    if not channel and hit and not set(words) & ACCELERATIONS:
        channel = WORDS.get(hit, "q") + ("_cmd" if set(words) & COMMANDED else "")
        channel = channel if channel in UNITS else ""
    return _Name(name, tuple(words), joint, text, hit, channel)


def _named_joints(joint_names: Sequence[str] | None) -> Sequence[str]:
    """The joint names, or none where they differ only in their numbers, which then are keys in all channels."""
    stems = {tuple(word for word in words_of(name) if not word.isdigit()) for name in joint_names or ()}
    return joint_names or () if len(stems) > 1 or len(joint_names or ()) == 1 else ()


def _tell_joints(part: list[_Name]) -> bool:
    """Whether the texts in brackets are joints: they differ and are not units.

    A single letter that is a unit may still be the name of a joint.
    """
    texts = {x.text for x in part}
    units = {text for text in texts if stated_unit(part[0].channel, f"[{text}]")}
    return len(texts) > 1 and units < texts and all(re.match(r"\w", text) for text in texts) and all(len(x) == 1 for x in units)


def _hit(words: Sequence[str]) -> str:
    return next((word for word in (*WORDS, ACTION) if word in words), "")


def _by(read: Iterable[_Name], of: Callable[[_Name], Hashable | None]) -> dict[Hashable, list[_Name]]:
    out: dict[Hashable, list[_Name]] = defaultdict(list)
    for x in read:
        if (key := of(x)) is not None:
            out[key].append(x)
    return out


def _of_one_meaning(part: list[_Name]) -> list[Group]:
    """Groups of columns whose names differ only in joints, numbers and other words: `q_1`, `q_hip`, `q_filtered_1`.

    A number identifies the joint, and other words make another group. A number is part of a joint's name (shoulder, elbow,
    wrist_1, wrist_2) where the columns with the largest group's numbers are no more than half of all.
    """
    bare, others = [x for x in part if not x.rest], [x for x in part if x.rest]
    numbered = list(_by(others, lambda x: x.stem if x.numbers else None).values())
    plain = [x for x in others if not x.numbers]
    out = _unique(("", x.name) for x in bare)
    sets = [{x.numbers[-1] for x in group} for group in numbered]
    largest = max(sets, key=len, default=set())
    alike = sum(len(group) for group, numbers in zip(numbered, sets, strict=True) if numbers == largest)
    if 2 * alike <= len(others):
        return out + _unique(zip(_called(others), (x.name for x in others), strict=True))
    for group in numbered:
        out += _unique((x.numbers[-1], x.name) for x in group)
    return out + _unique(zip(_called(plain), (x.name for x in plain), strict=True))


def _called(read: list[_Name]) -> list[str]:
    """Names of joints in names such as `/joint_states/elbow_joint/position`, without the parts that all of them share."""
    paths = [re.split(r"[/.:]+", x.name) for x in read]
    if len(read) > 1 and len({len(path) for path in paths}) == 1:
        differ = [len(set(parts)) > 1 for parts in zip(*paths, strict=True)]
        kept = [words_of(" ".join(part for part, use in zip(path, differ, strict=True) if use)) for path in paths]
        keys = ["_".join(word for word in words if word in x.rest) for x, words in zip(read, kept, strict=True)]
        if all(keys):
            return keys
    return ["_".join(x.rest) for x in read]


def _unique(pairs: Iterable[tuple[str, str]]) -> list[Group]:
    """Groups in which each key occurs once; sorted by joint number where all keys are numbers."""
    groups: list[Group] = []
    for key, name in pairs:
        group = next((group for group in groups if key not in group), None)
        if group is None:
            group = {}
            groups.append(group)
        group[key] = name
    return [dict(sorted(x.items(), key=lambda item: int(item[0]))) if all(k.isdecimal() for k in x) else x for x in groups]
