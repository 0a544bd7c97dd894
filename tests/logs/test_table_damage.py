"""Damaged tables, and tables that are not recordings: refused or reported with their row, without a crash."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as parquet
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from logs.column_map import of_plain
from logs.damage import Damage
from logs.tables import FORMATS, read_table
from sim.errors import BadLog, CalibError
from tests.logs.test_tables import COUNT, PLAIN, WIDE, N, Q, T, csv_text, taken


def test_damage_is_reported_with_its_row(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    lines = csv_text(PLAIN, WIDE).splitlines()
    lines[10] = lines[10].rsplit(",", 1)[0]
    lines[20] = ",".join([lines[20].split(",")[0], "9.9e9", *lines[20].split(",")[2:]])
    file.write_text("\n".join(lines) + "\n")
    with pytest.raises(BadLog, match="row 11: 9 values where the header has 10"):
        taken(file)
    log = taken(file, accept=True)
    assert len(log) == COUNT - 2
    assert any("row 21, column 'q1': 9.9e+09 rad" in finding for finding in log.findings)
    file.write_text(csv_text(PLAIN, WIDE)[:-12])
    with pytest.raises(BadLog, match="ends inside this row"):
        taken(file)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda head, rows: [head, *(f"{row}," for row in rows[:9]), *(f"{row},7" for row in rows[9:])], "row 11: 11 values"),
        (
            lambda head, rows: [head, *(row.replace(".", ",") for row in rows)],
            r"row 2: \d+ values where the header has 10 columns, as in most",
        ),
        (lambda head, rows: ["Recording,2024", "Robot,X1", "", head, *rows], r"row 4: 10 values where the header has 2"),
    ],
)
def test_rows_of_another_width_than_the_header(
    tmp_path: Path, change: Callable[[str, list[str]], list[str]], words: str
) -> None:
    """A width that most rows share is not damage to a few rows. It is refused even where damage is accepted."""
    head, *rows = csv_text(PLAIN, WIDE).splitlines()
    (tmp_path / "a.csv").write_text("\n".join(change(head, rows)) + "\n")
    with pytest.raises(BadLog, match=words):
        taken(tmp_path / "a.csv", accept=True)


def test_a_cell_longer_than_the_csv_module_reads(tmp_path: Path) -> None:
    file, long = tmp_path / "a.csv", "x" * 200_000
    for text in (f"t,{long}\n0,1\n1,2\n", f"t,{long[:70_000]},{long[:70_000]}\n0,1,2\n1,2,3\n"):
        file.write_text(text)
        with pytest.raises(BadLog, match="row 1: no row with the names of columns"):
            read_table(file, FORMATS, Damage(file, False))
    file.write_text(f"t,q1,note\n0.0,1.0,{long}\n0.1,2.0,b\n0.2,2.0,b\n")
    table = read_table(file, FORMATS, Damage(file, False))
    assert (list(table.columns), table.words) == (["t", "q1"], ("note",))


def test_times_beyond_those_of_nanoseconds_are_words(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,q1,until\n0.0,1.0,9999-12-31 00:00:00\n0.1,2.0,9999-12-31 00:00:00\n")
    table = read_table(tmp_path / "a.csv", FORMATS, Damage(tmp_path / "a.csv", False))
    assert (list(table.columns), table.words) == (["t", "q1"], ("until",))


def test_what_is_no_recording(tmp_path: Path) -> None:
    for name, content, words in (
        ("a.csv", b"", "empty"),
        ("b.csv", b"t,q1,q1\n1,2,3\n", "occurs 2 times"),
        ("c.csv", b"t,q1\n", "no samples"),
        ("d.csv", b"name,colour\nbolt,red\nnut,blue\n", "no column of times"),
        ("e.csv", b"t,height\n0,1\n1,2\n2,3\n", "no columns that are positions"),
        ("f.npz", b"PK\x03\x04nothing", "cannot read"),
        ("g.mat", b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(200), "7.3"),
        ("h.mat", b"MATLAB 5.0 MAT-file" + bytes(200), "cannot read|no array"),
        ("i.parquet", b"PAR1" + bytes(64), "cannot read"),
        ("j.bin", bytes(range(256)), "unrecognised format"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadLog, match=words):
            taken(tmp_path / name)
    np.savez(tmp_path / "objects.npz", t=np.array([{}, []], dtype=object))
    with pytest.raises(BadLog, match="no array of samples"):
        taken(tmp_path / "objects.npz")
    file = tmp_path / "k.csv"
    file.write_text(csv_text(PLAIN, WIDE))
    with pytest.raises(BadLog, match=r"3 joints .* the arm has 2"):
        taken(file, names=("a", "b"))
    missing = of_plain({"joints": ["a"], "time": {"column": "t"}, "q": {"columns": ["Q1"], "unit": "rad"}}, "map")
    with pytest.raises(BadLog, match="did you mean 'q1'"):
        taken(file, missing)


@pytest.mark.parametrize(
    ("reader", "words"),
    [
        ("import os; os.abort()", "its reader ended without a message"),
        ("import sys; sys.exit('unknown type 77')", "unknown type 77"),
        ("raise MemoryError('Unable to allocate 8 EiB')", "Unable to allocate 8 EiB"),
        ("import time; time.sleep(60)", "not within 0.5 s"),
    ],
)
def test_a_mat_file_that_ends_its_reader_ends_only_the_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reader: str, words: str
) -> None:
    scipy.io.savemat(tmp_path / "a.mat", {"t": T, "q": Q})
    assert len(read_table(tmp_path / "a.mat", FORMATS, Damage(tmp_path / "a.mat")).columns) == 1 + N
    monkeypatch.setattr("logs.tables.matlab_table.CHILD", reader)
    monkeypatch.setattr("logs.tables.matlab_table.SECONDS", 0.5 if "sleep" in reader else 60.0)
    with pytest.raises(BadLog, match=words):
        read_table(tmp_path / "a.mat", FORMATS, Damage(tmp_path / "a.mat"))


@pytest.mark.slow
@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_bytes_changed_at_random_never_crash(tmp_path: Path, data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(["csv", "npz", "mat", "parquet"]))
    file = tmp_path / f"a.{kind}"
    short = slice(0, 40)
    if kind == "csv":
        file.write_text(csv_text(PLAIN, [x[short] for x in WIDE]))
    elif kind == "npz":
        np.savez(file, t=T[short], q=Q[short])
    elif kind == "mat":
        scipy.io.savemat(file, {"t": T[short], "q": Q[short]})
    else:
        parquet.write_table(pa.table({"t": T[short], "q1": Q[short, 0]}), file)
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    file.write_bytes(content[: data.draw(st.integers(1, len(content)))] if data.draw(st.booleans()) else content)
    try:
        log = taken(file, accept=True)
    except CalibError:
        return
    assert len(log) >= 2
    assert np.all(np.diff(log.t) >= 0)
    assert np.isfinite(log.q).any()
