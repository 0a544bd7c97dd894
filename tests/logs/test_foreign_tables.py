"""Tables as other recorders and shells write them: units in brackets, whole nanoseconds, UTF-16."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from logs.column_guess import guess_map
from logs.convert import import_recording, table_of
from logs.damage import Damage
from logs.tables import FORMATS, read_table
from sim.errors import BadLog
from tests.logs.test_tables import DQ, PLAIN, TAU, WIDE, Q, T, csv_text, same, taken


@pytest.mark.parametrize("brackets", ["[]", "()"])
def test_units_in_brackets_behind_a_name(tmp_path: Path, brackets: str) -> None:
    """`q1 [deg]` is joint 1 in degrees, not a joint called deg. Joint names in brackets are still recognised."""
    file, (left, right) = tmp_path / "a.csv", brackets
    stems = (("angle {} ", "deg"), ("speed {} ", "°/s"), ("torque {} ", "N*mm"))
    head = f"Time {left}ms{right}," + ",".join(
        f"{stem.format(j)}{left}{unit}{right}" for stem, unit in stems for j in (1, 2, 3)
    )
    file.write_text(csv_text(head, [1e3 * T, *np.degrees(Q).T, *np.degrees(DQ).T, *(1e3 * TAU).T]), encoding="utf-8")
    log = taken(file)
    assert log.joint_names == ("joint1", "joint2", "joint3")
    same(log, rtol=1e-9)
    named = "t," + ",".join(f"{stem}[{j}]" for stem in ("pos", "vel", "tau") for j in ("A", "B", "deg1"))
    file.write_text(csv_text(named, WIDE))
    assert taken(file).joint_names == ("A", "B", "deg1")


def test_whole_nanoseconds_since_1970(tmp_path: Path) -> None:
    """ROS writes more digits than a float64 holds, which resolves a quarter of a microsecond."""
    file = tmp_path / "a.csv"
    for name in ("t", "timestamp_ns", "stamp [ns]"):
        file.write_text(
            csv_text(PLAIN.replace("t,", f"{name},", 1), [1_700_000_000 * 10**9 + np.rint(1e9 * T).astype(int), *WIDE[1:]])
        )
        log = taken(file)
        np.testing.assert_allclose(log.t - log.t[0], T, atol=1e-6)
        np.testing.assert_allclose(log.q, Q)


def test_utf_16_as_a_windows_shell_writes_it(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(csv_text(PLAIN, WIDE), encoding="utf-16")
    same(taken(file))


@pytest.mark.parametrize("before", [0, 1017, 4089])
@pytest.mark.parametrize("encoding", ["cp1252", "utf-8"])
def test_a_degree_sign_in_any_place_and_encoding(tmp_path: Path, encoding: str, before: int) -> None:
    """The format is recognised by the first bytes of the file, which may end inside a character."""
    head = ",".join(["x" * before + "t", *(f"q{j} (°)" for j in range(3))])
    (tmp_path / "a.csv").write_text(csv_text(head, [T, *np.rad2deg(Q).T]), encoding=encoding)
    table = table_of(tmp_path / "a.csv")
    assert table is not None
    assert list(table.columns)[1:] == ["q0 (°)", "q1 (°)", "q2 (°)"]


def test_a_file_of_windows_says_that_it_was_read_as_one(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        csv_text("t," + ",".join(f"q{j} (°)" for j in range(3)), [T, *np.rad2deg(Q).T]), encoding="cp1252"
    )
    log = taken(tmp_path / "a.csv")
    np.testing.assert_allclose(log.q, Q)
    assert any("Windows-1252" in finding for finding in log.findings)


@pytest.mark.parametrize("end", ["", ";"])
def test_a_row_of_units_under_the_header(tmp_path: Path, end: str) -> None:
    head = PLAIN.replace(",", ";")
    units = ";".join(["ms", *3 * ["[deg]"], *3 * ["deg/s"], *3 * ["-"]])
    rows = csv_text("", [1e3 * T, *np.rad2deg(Q).T, *np.rad2deg(DQ).T, *TAU.T], ";").splitlines()[1:]
    (tmp_path / "a.csv").write_text("\n".join([head, *(f"{line}{end}" for line in (units, *rows))]) + "\n")
    same(taken(tmp_path / "a.csv"), rtol=1e-9)


def test_a_separator_behind_every_row_and_not_behind_the_header(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(csv_text(PLAIN, WIDE).replace("\n", ",\n").replace(",\n", "\n", 1))
    same(taken(tmp_path / "a.csv"))


@pytest.mark.parametrize("names", [("header.stamp.sec", "header.stamp.nanosec"), ("secs", "nsecs")])
def test_seconds_and_nanoseconds_in_two_columns(tmp_path: Path, names: tuple[str, str]) -> None:
    instants = 1_700_000_000_995_000_000 + np.rint(T * 1e9).astype(np.int64)
    head = ",".join([*names, *PLAIN.split(",")[1:]])
    (tmp_path / "a.csv").write_text(csv_text(head, [instants // 10**9, instants % 10**9, *WIDE[1:]]))
    log = taken(tmp_path / "a.csv")
    same(log)
    assert log.t_origin == instants[0]


def test_stamps_coarser_than_the_samples_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(csv_text(PLAIN, [np.floor(10 * T) / 10, *WIDE[1:]]))
    damage = Damage(tmp_path / "a.csv")
    chosen = guess_map(read_table(tmp_path / "a.csv", FORMATS, damage))[0]
    with pytest.raises(BadLog, match=r"288 of 300 samples .* coarser than the samples; .*--rate"):
        import_recording(tmp_path / "a.csv", tmp_path / "a.mcap", chosen)
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("form", ["01.03.2024 12:00:{:09.6f}", "12:00:{:09.6f}", "2024-03-01 12:00:{:09.6f}"])
def test_instants_in_a_form_that_is_not_read_are_named(tmp_path: Path, form: str) -> None:
    rows = csv_text("", WIDE[1:], ";").splitlines()[1:]
    lines = [f"{form.format(t)};{row}" for t, row in zip(T, rows, strict=True)]
    text = "\n".join([PLAIN.replace(",", ";"), *lines]) + "\n"
    (tmp_path / "a.csv").write_text(text.replace(".", ",") if form.startswith("2024") else text)
    with pytest.raises(BadLog, match=r"t holds text, not numbers; instants are read as .*ISO 8601"):
        taken(tmp_path / "a.csv")


def test_a_time_called_timestamp_makes_no_ur_rtde_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(csv_text(PLAIN.replace("t,", "timestamp,", 1), WIDE))
    assert table_of(tmp_path / "a.csv") is not None
    same(taken(tmp_path / "a.csv"))


def test_one_sample_is_no_recording(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text(csv_text(PLAIN, [x[:1] for x in WIDE]))
    with pytest.raises(BadLog, match="one sample"):
        taken(file)
