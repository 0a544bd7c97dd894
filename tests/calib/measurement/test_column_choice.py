"""Columns that options state are used as stated, and the others are guessed around them."""

from __future__ import annotations

import numpy as np
import pytest

from calib.measurement.column_choice import chosen_map
from logs.column_map import ColumnMap
from logs.tables import Table
from sim.arm import load_arm
from sim.errors import BadLog, ConfigError

UR = load_arm("ur10e").joint_names
T = 0.004 * np.arange(500)


def chosen(
    heads: list[str], *options: str, rate: float | None = None, names: tuple[str, ...] | None = None
) -> tuple[ColumnMap, list[str], bool]:
    columns = {name: T if name in ("t", "Zeit", "timestamps", "t_ms") else np.sin(2 * T + k) for k, name in enumerate(heads)}
    return chosen_map(Table(columns, np.arange(len(T))), None, options, rate, None, names, None)


def joints(n: int, *stems: str) -> list[str]:
    return [stem.format(k + 1) for stem in stems for k in range(n)]


def test_a_rate_or_a_time_is_enough_where_no_time_is_found() -> None:
    heads = joints(3, "q{}", "dq{}", "tau{}")
    with pytest.raises(BadLog, match="--rate HZ"):
        chosen(heads)
    found, _, complete = chosen(heads, rate=250.0)
    assert (found.time, found.rate, set(found.channels), complete) == (None, 250.0, {"q", "dq", "tau"}, False)
    found, _, complete = chosen(["Zeit", *heads], "time=Zeit:ms")
    assert (found.time, found.time_unit, set(found.channels), complete) == ("Zeit", "ms", {"q", "dq", "tau"}, False)
    assert chosen(["timestamps", *heads])[0].time == "timestamps"


def test_positions_are_enough_where_the_file_has_a_gripper() -> None:
    heads = ["t", *joints(7, "joint{}_pos", "joint{}_vel", "joint{}_current")]
    with pytest.raises(BadLog, match="positions of 7 joints"):
        chosen(heads, names=UR)
    stated = joints(6, "joint{}_pos")
    found, _, complete = chosen(heads, f"q={','.join(stated)}", names=UR)
    assert (found.joints, found.channels["q"].columns, complete) == (UR, tuple(stated), False)
    assert found.channels["dq"].columns == tuple(joints(6, "joint{}_vel"))
    assert found.channels["current"].columns == tuple(joints(6, "joint{}_current"))


def test_positions_that_are_stated_by_name_in_another_order() -> None:
    order = sorted(UR)
    heads = [f"{word}.{name}" for word in ("alpha", "velocity") for name in order]
    found, _, _ = chosen(["t", *heads], "q=" + ",".join(heads[:6]), names=UR)
    assert (found.joints, found.channels["dq"].columns) == (tuple(order), tuple(heads[6:]))


def test_a_joint_without_a_column_keeps_its_place() -> None:
    heads = ["t", *joints(3, "joint{}_pos"), "dq1", "dq3"]
    found, _, _ = chosen(heads, "q=joint1_pos,joint2_pos,joint3_pos")
    assert found.channels["dq"].columns == ("dq1", "", "dq3")
    with pytest.raises(
        ConfigError, match=r"joint 2 has no column; a log needs the position of every joint.*--lock JOINT=ANGLE"
    ):
        chosen(heads, "q=joint1_pos,,joint3_pos")


def test_what_is_stated_is_taken_for_nothing_else() -> None:
    """A torque that is stated is not also read as current. The rest is guessed as before: a wrapped angle keeps its turn."""
    wrapped = (30 * T + np.pi) % (2 * np.pi) - np.pi
    table = Table({"t": T, "q1": wrapped, "i1": np.sin(T)}, np.arange(len(T)))
    found, _, _ = chosen_map(table, None, ["tau=i1:mNm"], None, None, None, None)
    assert set(found.channels) == {"q", "tau"}
    assert (found.channels["tau"].unit, found.channels["q"].wraps) == ("mN m", 2 * np.pi)


def test_a_unit_that_an_option_leaves_out_is_that_of_the_name() -> None:
    found, doubts, complete = chosen(["t_ms", "pos_deg_1", "tau1"], "time=t_ms", "q=pos_deg_1")
    assert (found.time_unit, found.channels["q"].unit, complete) == ("ms", "deg", True)
    assert "unused columns: tau1" in doubts[0]


def test_a_channel_that_does_not_fit_the_positions() -> None:
    with pytest.raises(ConfigError, match=r"\[tau\] columns: 2 names for 3 joints"):
        chosen(["t", *joints(3, "q{}", "tau{}")], "tau=tau1,tau2")
