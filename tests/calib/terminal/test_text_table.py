"""Tables fit a terminal of 80 columns and lose nothing; numbers are rounded to their uncertainty."""

from __future__ import annotations

import itertools

import pytest

from calib.terminal.quantity import pair, percentages, rounded, significant_beside
from calib.terminal.text_table import lines, wrapped

JOINTS = ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"]
VALIDATE = [
    "joint",
    "residual [N m]",
    "unfiltered [N m]",
    "torque std [N m]",
    "share",
    "residual [A]",
    "off after 0.25 s [deg]",
    "bound [deg]",
]
RUNS = ["started (UTC)", "verb", "arm", "exit", "folder", "outcome"]
LONG = "No effect is missing: the model of ur10e agrees with the log within noise and its own uncertainty"


def shown(headers: list[str], rows: list[list[str]], numeric: list[bool], width: int = 80) -> list[str]:
    return [line for line, _ in lines(headers, rows, numeric, width)]


def test_a_wide_table_of_numbers_becomes_parts_with_the_first_column() -> None:
    rows = [[joint, *[f"{k + 0.125:.4g}" for k in range(7)]] for joint in JOINTS]
    table = shown(VALIDATE, rows, [False, *[True] * 7])
    assert max(map(len, table)) <= 80
    assert sum(line.startswith("joint") for line in table) == 2
    text = " ".join("\n".join(table).split())
    for word in itertools.chain(" ".join(VALIDATE).split(), *rows):
        assert word in text


def test_a_heading_is_folded_before_a_table_is_split_and_its_unit_stays_whole() -> None:
    headers = ["joint", "before", "after parameter refit", "after [N m]"]
    rows = [["shoulder_pan_joint", "3.175", "3.148", "3.156"]]
    assert shown(headers, rows, [False, *[True] * 3], 48) == [
        "                                  after",
        "                              parameter    after",
        "joint               before        refit    [N m]",
        "shoulder_pan_joint   3.175        3.148    3.156",
    ]


def test_no_line_ends_between_a_number_and_its_unit() -> None:
    text = "the residual RMS is 20.3 N m at 4.0 ± 1.2 N m s/rad, 3 kg m^2, 10 per turn and 12 mrad of 5 m"
    for width in range(12, 60):
        for line in wrapped(text, width).splitlines():
            assert not line.endswith(("20.3", "N", "4.0", "±", "1.2", " 3", "kg", "10", "12", " 5", "per"))
        assert " ".join(wrapped(text, width).split()) == text


def test_a_long_last_column_goes_below_its_row() -> None:
    rows = [["2026-11-22 08:06", "identify", "ur10e", "0", "20261122T080602Z-ur10e-identify", LONG]] * 2
    table = shown(RUNS, rows, [False] * 6)
    assert max(map(len, table)) <= 80
    assert " ".join("\n".join(table).split()).count(LONG) == 2


def test_a_column_below_its_rows_keeps_its_heading() -> None:
    assert shown(["joint", "offset [N m]"], [["elbow_joint", "0.083 ± 0.056, written 0.005"]], [False, False], 30) == [
        "joint",
        "    offset [N m]",
        "elbow_joint",
        "    0.083 ± 0.056, written",
        "    0.005",
    ]


def test_a_list_is_wrapped_beside_its_names_and_keeps_paths_whole() -> None:
    rows = [["exit code", "1"], ["command", "calib export a/folder/with-a-long-name/arm"]]
    assert shown(["", ""], rows, [False, False], 30) == [
        "exit code  1",
        "command    calib export",
        "           a/folder/with-a-long-name/arm",
    ]
    assert shown(["", ""], rows, [False, False])[0] == "exit code  1"


def test_a_table_that_fits_stays_as_it_is() -> None:
    assert shown(["a", "b"], [["x", "1"], ["yy", "22"]], [False, True]) == ["a    b", "x    1", "yy  22"]


@pytest.mark.parametrize("width", [20, 40, 80, 120])
def test_nothing_is_cut_off(width: int) -> None:
    rows = [[joint, LONG, "3.5", LONG] for joint in JOINTS]
    words = " ".join(shown(["joint", "first", "value", "second"], rows, [False, False, True, False], width)).split()
    assert all(words.count(word) >= 2 * 3 for word in LONG.split())
    assert not shown([], [], [])


@pytest.mark.parametrize(
    ("value", "std", "unit", "text"),
    [
        (-0.03011, 0.29, "N*m", "-0.03 ± 0.29 N m"),
        (-0.0001, 0.29, "", "0.00 ± 0.29"),
        (12345.6, 1234.0, "N*m/rad", "12300 ± 1200 N m/rad"),
        (0.124, 0.005, "1", "0.1240 ± 0.0050"),
        (3.0, None, "kg", "3 kg"),
        (3.0, 0.0, "kg", "3 kg"),
        (float("nan"), 1.0, "kg", "–"),
    ],
)
def test_a_number_is_rounded_to_its_uncertainty(value: float, std: float | None, unit: str, text: str) -> None:
    assert rounded(value, std, unit) == text


def test_two_columns_are_rounded_as_one_text_is() -> None:
    assert pair(-0.0011236, 0.0013872) == (-0.0011, 0.0014)
    assert pair(3.0, None) == (3.0, None)


@pytest.mark.parametrize(
    ("value", "limit", "shown"),
    [
        (0.166, 0.2, ("16.6%", "20%")),
        (0.2004, 0.2, ("20.04%", "20.00%")),
        (0.2 + 3e-7, 0.2, ("20.00003%", "20.00000%")),
        (0.2, 0.2, ("20.0%", "20%")),
    ],
)
def test_a_share_and_its_limit_read_alike_only_where_they_are(value: float, limit: float, shown: tuple[str, str]) -> None:
    assert percentages(value, limit) == shown


def test_a_size_and_its_bound_read_alike_only_where_they_are() -> None:
    assert significant_beside(1.24, 1.16) == ("1.24", "1.16")
    assert significant_beside(3.0, 1.0) == ("3", "1")
    assert significant_beside(1204.0, 1201.0) == ("1204", "1201")
