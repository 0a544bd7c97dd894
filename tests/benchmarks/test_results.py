"""A results file holds the measured rows and the code that they depend on; invalid rows are refused."""

from __future__ import annotations

import re
import tempfile
from importlib import import_module
from pathlib import Path

import pytest

from benchmarks import imports, results
from benchmarks.wording import structure

ROW = {"what": "a", "value": 1.5, "unit": "s", "bar": "", "other": 3}


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    results.write("demo", [ROW], command="make demo", measures=("benchmarks",), load_before=0.5, folder=tmp_path)
    found = results.read(tmp_path)["demo"]
    assert found.rows == ({"what": "a", "value": 1.5, "unit": "s"},)
    assert found.command == "make demo"
    assert found.machine["load_before"] == 0.5
    assert found.machine["reference_ms"] > 0
    assert found.outdated() == []


def test_changed_code_outdates_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results.write("demo", [ROW], command="make demo", measures=("benchmarks", "results"), folder=tmp_path)
    monkeypatch.setattr(
        results, "digest", lambda path: "other" if path == "benchmarks" else results.read(tmp_path)["demo"].measures[path]
    )
    monkeypatch.setattr(results.Results, "changed", lambda self, path: ["benchmarks/changed.py"])
    assert results.read(tmp_path)["demo"].outdated() == ["benchmarks (benchmarks/changed.py)"]


SOURCE = b'''"""What it is."""

def f(x):  # why
    """More."""
    return f"#{x}"  # twice
'''


def test_words_about_code_outdate_nothing() -> None:
    said = (
        SOURCE.replace(b"What it is", b"What\n\nelse")
        .replace(b"# why", b"")
        .replace(b"More", "Größer".encode())
        .replace(b"# twice", b"#")
    )
    assert results.code(said) == results.code(SOURCE) == b'def f(x):\n    return f"#{x}"'
    for old, new in ((b"#{x}", b"#{x} "), (b"return", b"yield"), (b"(x)", b"(x, y)")):
        assert results.code(SOURCE.replace(old, new)) != results.code(SOURCE)
    one_line = b'def f(): "x"\n'
    assert results.code(one_line) == one_line.strip()
    assert results.code(b"def (\n") == b"def (\n"


REFUSAL = b'''def f(x, y):
    """Why."""
    raise ValueError(f"{y!r} of {x} is none that is known" + "no" + "left, right or both of them")
'''


def test_wording_is_docstrings_and_messages_alone() -> None:
    better = REFUSAL.replace(b"{y!r} of {x} is none that is known", b"{x}: unknown value {y!r} of it").replace(
        b"Why.", b"What."
    )
    assert results.code(better) != results.code(REFUSAL)
    assert structure(better) == structure(REFUSAL)
    assert structure(REFUSAL.replace(b"left, right", b"left or right")) == structure(REFUSAL)
    for old, new in (
        (b"!r", b""),
        (b'"no"', b'"yes"'),
        (b"{x}", b"{x + 1}"),
        (b"ValueError", b"KeyError"),
        (b"known", b"known\\n"),
    ):
        assert structure(REFUSAL.replace(old, new)) != structure(REFUSAL)
    for used in (b"'one two three' in x", b"x == 'one two three'", b"x['one two three']", b"{'one two three': x}"):
        assert structure(used) != structure(used.replace(b"two", b"2nd"))
    assert structure(b"x.startswith('one two three')") != structure(b"x.startswith('one 2nd three')")
    with pytest.raises(ValueError, match="invalid syntax"):
        structure(b"def (\n")


def test_a_change_of_wording_is_reported_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    found = results.Results("demo", "make demo", "", "", False, {}, {"benchmarks/results.py": "0"}, (ROW,))
    now = (results.ROOT / "benchmarks" / "results.py").read_bytes()
    monkeypatch.setattr(results.Results, "changed", lambda self, path: [path])
    monkeypatch.setattr(
        results.Results, "then", lambda self, file: now.replace(b"needs `what` as text", b"give `what` as text")
    )
    assert found.reworded()
    monkeypatch.setattr(results.Results, "then", lambda self, file: now.replace(b"SHOWN = 3", b"SHOWN = 4"))
    assert not found.reworded()
    monkeypatch.setattr(results.Results, "changed", lambda self, path: [])
    assert not found.reworded()


def test_a_row_holds_no_folder_of_one_run(tmp_path: Path) -> None:
    place = Path(tempfile.gettempdir()) / "calib-a1b2" / "plant" / "8.mcap"
    results.write("demo", [ROW | {"note": f"convert {place}"}], command="make demo", measures=("benchmarks",), folder=tmp_path)
    assert results.read(tmp_path)["demo"].rows[0]["note"] == "convert plant/8.mcap"


def test_code_that_is_gone_outdates_it_and_is_not_measured(tmp_path: Path) -> None:
    gone = results.Results("demo", "make demo", "", "", False, {}, {"calib/gone.py": "0"}, (ROW,))
    assert gone.outdated() == ["calib/gone.py"]
    with pytest.raises(ValueError, match=r"calib/gone\.py: no file"):
        results.write("demo", [ROW], command="make demo", measures=("calib/gone.py",), folder=tmp_path)
    assert not list(tmp_path.iterdir())


def named_paths() -> list[tuple[str, str]]:
    """(module, path) for every code path in the MEASURES of a benchmark."""
    named = []
    folder = results.ROOT / "benchmarks"
    for file in sorted(folder.rglob("*.py")):
        if re.search(r"^MEASURES\b", file.read_text(encoding="utf-8"), re.MULTILINE):
            module = import_module(".".join(file.relative_to(results.ROOT).with_suffix("").parts))
            named += [(module.__name__, path) for path in module.MEASURES]
    return named


def test_every_path_that_a_benchmark_names_exists() -> None:
    named = named_paths()
    assert {"benchmarks.demo", "benchmarks.peers.compare", "benchmarks.arms", "benchmarks.soak"} <= {who for who, _ in named}
    for _, path in named:
        assert imports.files(path)  # ValueError names a path that does not exist


@pytest.mark.parametrize(
    ("name", "rows", "message"),
    [
        ("Demo", [ROW], "lower-case"),
        ("../demo", [ROW], "lower-case"),
        ("demo", [ROW, ROW], "more than one row"),
        ("demo", [{"what": "a"}], "needs `what`"),
        ("demo", [{"what": "a", "value": float("nan")}], "NaN"),
        ("demo", [{"what": "a", "value": "1.2 ± nan"}], "NaN"),
    ],
)
def test_wrong_rows_are_refused(tmp_path: Path, name: str, rows: list[dict[str, object]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        results.write(name, rows, command="make demo", folder=tmp_path)
    assert not list(tmp_path.iterdir())


def test_every_committed_file_can_be_read() -> None:
    found = results.read()
    assert len(found) > 20
    assert [name for name, one in found.items() if not one.rows] == []
