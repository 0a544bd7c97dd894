"""What the columns of a table mean: from a map that was kept, from options, or from a guess that a person confirms."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from calib.terminal import console
from logs.column_guess import guess_map
from logs.column_map import CHANNELS, DRIVE, ColumnMap, of_plain, read_map
from logs.tables import Table
from logs.units import TIME, UNITS
from logs.words import BITS
from sim.errors import ConfigError
from sim.resources import nearest


def chosen_map(
    table: Table, file: Path, map_file: Path | None, columns: Sequence[str], rate: float | None, joints: str | None,
    joint_names: Sequence[str] | None, episode: int | None,
) -> tuple[ColumnMap, list[str], bool]:  # fmt: skip
    """The map, what is doubtful about it, and whether the options stated all of it."""
    if map_file is not None:
        found = read_map(map_file)
        return (replace(found, where={"episode_index": float(episode)}) if episode is not None else found), [], True
    stated = dict(_option(option, (*table.columns, *table.words)) for option in columns)
    names = tuple(part.strip() for part in joints.split(",")) if joints else joint_names
    complete = "q" in stated and ("time" in stated or rate is not None)
    if complete:
        return _of_options(stated, rate, names, episode), [], True
    guess, doubts = guess_map(table, names, episode)
    if not stated and rate is None:
        return guess, doubts, False
    plain = {"joints": list(guess.joints), "time": {"column": guess.time, "unit": guess.time_unit}}
    plain |= {
        name: {"columns": list(part.columns), "unit": part.unit} | ({"integer": part.integer} if part.integer else {})
        for name, part in guess.channels.items()
    }
    own = _plain(stated, rate)
    if "q" in own and names is None:
        plain["joints"] = _names(own["q"]["columns"])
    return of_plain({**plain, **own, "where": dict(guess.where)}, "--column"), doubts, False


def with_words(chosen: ColumnMap, assume: Sequence[str]) -> tuple[ColumnMap, list[str]]:
    """The map with the words `tau=int16`, `current=int32` and their like of `--assume`, which are about the raw numbers; the other words."""
    channels, others = dict(chosen.channels), []
    for word in assume:
        channel, _, integer = word.partition("=")
        if integer in BITS and channel in channels and channel in DRIVE:
            channels[channel] = replace(channels[channel], integer=integer)
        else:
            others.append(word)
    return replace(chosen, channels=channels), others


def confirm(chosen: ColumnMap, doubts: Sequence[str], table: Table, kept: Path) -> None:
    """Show the guess and ask; ConfigError where nobody answers, or the answer is no."""
    rows = [["time", chosen.time or "", chosen.time_unit]]
    rows += [[name, ", ".join(part.columns), part.unit] for name, part in chosen.channels.items()]
    used = {chosen.time, *chosen.where} | {name for part in chosen.channels.values() for name in part.columns}
    idle = [name for name in (*table.columns, *table.words) if name not in used]
    for row in (["joints", ", ".join(chosen.joints), ""], *rows, ["not used", ", ".join(idle) or "none", ""]):
        console.warn(f"  {row[0]:<12} {row[1]}{'  [' + row[2] + ']' if row[2] else ''}")
    for doubt in doubts:
        console.warn(f"  doubtful: {doubt}")
    if not sys.stdin.isatty():
        raise ConfigError(
            f"these meanings of the columns are a guess from their names; check {kept} and import again with --map {kept}, or accept "
            "the guess with --yes"
        )
    if console.ask("calib: is this what the columns mean? [y/N] ").strip().lower() not in ("y", "yes"):
        raise ConfigError(f"nothing was imported; correct {kept} and import again with --map {kept}")


def _option(text: str, known: Sequence[str]) -> tuple[str, tuple[list[str], str | None]]:
    """`q=a,b,c:deg` as channel, names and unit; `known` the file's columns, one of which may hold a colon."""
    channel, equals, rest = text.partition("=")
    if not equals or channel not in ("time", *CHANNELS):
        raise ConfigError(
            f"--column {text!r:.120}: write CHANNEL=NAME,NAME,...:UNIT; {nearest(channel[:40], ('time', *CHANNELS))}"
        )
    units = TIME if channel == "time" else UNITS[channel]
    names, colon, given = rest.rpartition(":")
    unit = next((u for u in units if u.replace(" ", "") == given.replace(" ", "")), "")  # Nm is N m
    if not unit:
        last = rest.split(",")[-1].strip()
        if colon and last not in known and last.rpartition(":")[0].strip() in known:
            raise ConfigError(f"--column {text!r:.120}: {given!r} is no unit of {channel}; {nearest(given, units)}")
        names = rest
    parts = [column for name in names.split(",") for column in _columns_of(name.strip(), known)]
    absent = next((name for name in parts if name and name not in known), None)
    if absent is not None:
        raise ConfigError(f"--column {text!r:.120}: the file has no column {absent!r:.80}; {nearest(absent[:80], known[:40])}")
    if channel == "time" and len(parts) != 1:
        raise ConfigError(f"--column {text!r:.120}: the time is one column")
    return channel, (parts, unit or None)


def _columns_of(name: str, known: Sequence[str]) -> list[str]:
    """The column of that name, or those of the matrix of that name: pos[0], pos[1], ..."""
    parts = [column for column in known if column.startswith(f"{name}[") and column.endswith("]")]
    return parts if parts and name not in known else [name]


def _plain(stated: dict[str, tuple[list[str], str | None]], rate: float | None) -> dict[str, dict]:
    out: dict[str, dict] = {}
    for channel, (names, unit) in stated.items():
        if channel == "time":
            out["time"] = {"column": names[0], "unit": unit or "s"}
        else:
            out[channel] = {"columns": names, "unit": unit or next(iter(UNITS[channel]))}
    if rate is not None:
        out["time"] = {"rate": rate}
    return out


def _names(columns: Sequence[str]) -> list[str]:
    return [f"joint{k + 1}" for k in range(len(columns))]


def _of_options(
    stated: dict[str, tuple[list[str], str | None]],
    rate: float | None,
    names: Sequence[str] | None,
    episode: int | None,
) -> ColumnMap:
    plain = _plain(stated, rate)
    joints = list(names) if names is not None else _names(plain["q"]["columns"])
    rows = {"episode_index": float(episode)} if episode is not None else {}
    return of_plain({"joints": joints, **plain, "where": rows}, "--column")
