"""The meaning of columns guessed from their names: units, joints by name or number, and the best of several candidates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from logs.column_guess import guess_map
from logs.column_map import ColumnMap
from logs.tables import Table
from sim.arm import load_arm
from sim.errors import BadLog

UR = load_arm("ur10e").joint_names
WORDS = ("position", "velocity", "current")


def table(heads: Sequence[str], t: np.ndarray | None = None) -> Table:
    """Table with a column t and a sine for each of `heads`, each 0.1 rad ahead of the one before."""
    t = 0.004 * np.arange(500) if t is None else t
    columns = {"t": t} | {name: np.sin(2 * t + 0.1 * k) for k, name in enumerate(heads)}
    return Table(columns, np.arange(len(t)))


def guessed(heads: Sequence[str], names: Sequence[str] | None = None) -> tuple[ColumnMap, str]:
    found, doubts = guess_map(table(heads), names)
    return found, "; ".join(doubts)


def three(*patterns: str, numbers: Sequence[object] = (1, 2, 3)) -> list[str]:
    return [pattern.format(k) for pattern in patterns for k in numbers]


@pytest.mark.parametrize(
    ("channel", "name", "unit"),
    [
        ("tau", "tau{}_mNm", "mN m"), ("tau", "torque{}_Nmm", "N mm"), ("tau", "tau{} (N-m)", "N m"), ("current", "i{}_mA", "mA"),
        ("current", "MotorCurrent{}mA", "mA"), ("dq", "dq{} [deg/sec]", "deg/s"), ("dq", "dq{} (1/min)", "rpm"), ("dq", "dQ{} [DEG/S]", "deg/s"),
        ("dq", "speed{}_rev", "rev/s"), ("temperature", "Temp{}_K", "K"), ("tau", "tau{} [NM]", "N m"),
    ],
)  # fmt: skip
def test_a_unit_that_a_name_states(channel: str, name: str, unit: str) -> None:
    found, doubts = guessed(three("q{} [DEG]", name))
    assert (found.channels["q"].unit, found.channels[channel].unit, doubts) == ("deg", unit, "")
    assert found.joints == ("joint1", "joint2", "joint3")
    assert found.channels[channel].columns == tuple(three(name))


@pytest.mark.parametrize("brackets", ["()", "[]"])
@pytest.mark.parametrize(
    ("channel", "name", "text"), [("tau", "tau{}", "%"), ("q", "q{}", "grad"), ("tau", "tau{}", "lbf in"), ("q", "q{}", "A")]
)
def test_a_text_in_brackets_that_is_no_unit_is_doubted(brackets: str, channel: str, name: str, text: str) -> None:
    heads = three("q{}", f"{name} {brackets[0]}{text}{brackets[1]}")
    found, doubts = guessed(heads[3:] if channel == "q" else heads)
    assert f"the unit '{text}' of" in doubts
    assert len(found.channels[channel].columns) == 3


def test_columns_of_a_channel_in_two_units_are_doubted() -> None:
    assert "state deg and rad: deg is taken" in guessed(["q1 [deg]", "q2 [rad]"])[1]


def test_texts_in_brackets_that_differ_are_joints() -> None:
    """Even A, which is also a unit of current. Torque [%] and Torque [Nm] are not two joints but one torque in two units."""
    found, doubts = guessed(three("pos[{}]", "current[{}]", numbers="ABC"))
    assert (found.joints, found.channels["current"].columns, doubts) == (
        ("A", "B", "C"),
        tuple(three("current[{}]", numbers="ABC")),
        "",
    )
    found, doubts = guessed(["position", "Torque [%]", "Torque [Nm]"])
    assert found.channels["tau"].columns == ("Torque [Nm]",)
    assert "could also be Torque [%]" in doubts
    found, doubts = guessed(three("joint{} [pos]", "joint{} [vel]"))
    assert (found.channels["dq"].columns, doubts) == (tuple(three("joint{} [vel]")), "")


@pytest.mark.parametrize("pattern", ["{joint}_{word}", "{word}.{joint}", "/joint_states/{joint}/{word}", "{word}[{joint}]"])
def test_joints_of_an_arm_by_their_names(pattern: str) -> None:
    """In any order, anywhere in the column's name, with and without the arm. A gripper is not one of the arm's joints."""
    order = sorted(UR)
    heads = [pattern.format(joint=joint, word=word) for word in WORDS for joint in order]
    for names in (UR, None):
        found, doubts = guessed(heads, names)
        assert (found.joints, doubts) == (tuple(order), "")
        assert [found.channels[name].columns for name in ("q", "dq", "current")] == [
            tuple(heads[k : k + 6]) for k in (0, 6, 12)
        ]
    found, doubts = guessed([*heads, pattern.format(joint="gripper", word="position")], UR)
    assert set(found.joints) == set(UR)
    assert "could also be" in doubts


def test_numbers_are_keys_where_joints_are_called_by_them() -> None:
    """Numbers are keys of joints, not parts of a name. Torque columns of joint1 to joint3 may have only the number."""
    found, doubts = guessed([*three("q_{}", "q_err_{}", "dq_{}"), "q_norm"])
    assert found.joints == ("joint1", "joint2", "joint3")
    assert (found.channels["q"].columns, "q_err_1" in doubts) == (("q_1", "q_2", "q_3"), True)
    found, _ = guessed(three("joint{}_pos", "tau_{}"), ("joint1", "joint2", "joint3"))
    assert found.channels["tau"].columns == ("tau_1", "tau_2", "tau_3")
    found, doubts = guessed(three("arm{}_q1", "arm{}_q2", numbers=(1, 2)))
    assert found.channels["q"].columns == ("arm1_q1", "arm1_q2")
    assert "could also be arm2_q1, arm2_q2" in doubts


@pytest.mark.parametrize("names", [None, ("a", "b", "c", "d")])
def test_columns_in_falling_order_are_joints_in_rising_order(names: Sequence[str] | None) -> None:
    found, _ = guessed(three("q{}", "dq{}", numbers=(10, 3, 2, 1)), names)
    assert found.joints == (names or ("joint1", "joint2", "joint3", "joint10"))
    assert found.channels["q"].columns == ("q1", "q2", "q3", "q10")
    assert found.channels["dq"].columns == ("dq1", "dq2", "dq3", "dq10")


@pytest.mark.parametrize("other", ["state", "enc", "pos", "pos_err", "position_raw"])
def test_the_position_of_one_drive(other: str) -> None:
    """It is the column whose derivative is the speed; without a speed, the one with the exact name."""
    t = 0.004 * np.arange(500)
    parts = {"t": t, other: np.full(len(t), 3.0), "position": np.sin(2 * t), "velocity": 2 * np.cos(2 * t)}
    for columns in (parts, {name: x for name, x in parts.items() if name != "velocity"} if other != "pos" else parts):
        found, doubts = guess_map(Table(columns, np.arange(len(t))))
        assert found.channels["q"].columns == ("position",)
        assert any(f"could also be {other}" in doubt for doubt in doubts)


def test_errors_and_weights_are_no_positions_and_torques() -> None:
    found, _ = guessed(three("position_{}", "pos_err_{}", "velocity_{}", "torque_{}", "tau_g_{}"))
    assert found.channels["q"].columns == ("position_1", "position_2", "position_3")
    assert found.channels["tau"].columns == ("torque_1", "torque_2", "torque_3")


def test_of_two_groups_the_one_with_the_arms_joints_is_taken() -> None:
    heads = [*(f"state[{k}]" for k in range(5)), "position[0]", "position[1]"]
    assert guessed(heads, ("a", "b"))[0].channels["q"].columns == ("position[0]", "position[1]")


@pytest.mark.parametrize("digits", [3, 2])
def test_speeds_where_stamps_are_printed_to_few_digits(digits: int) -> None:
    """At 1 kHz, ten samples share a stamp printed to 0.01 s. The unit of the speed is recognised all the same."""
    t = 0.001 * np.arange(4000)
    columns = {"t": np.floor(t * 10**digits + 1e-6) / 10**digits, "q1": np.sin(2 * t), "dq1": 2 * np.cos(2 * t)}
    found, doubts = guess_map(Table(columns, np.arange(len(t))))
    assert (found.channels["dq"].unit, doubts) == ("rad/s", [])


def test_names_that_mean_nothing_are_refused() -> None:
    for heads in (["voltage [V]", "foo [x]", "foo [y]"], ["ddq1 [a]", "ddq1 [b]"], ["()", "[]"]):
        with pytest.raises(BadLog, match="say which they are"):
            guessed(heads)
