"""The table of dependencies: each has a description, and its cost includes what only it needs."""

from __future__ import annotations

import re
import tomllib

from benchmarks import install
from benchmarks.results import ROOT

FOUND: install.Packages = {
    "arm-calib": (0, ["pin", "scipy", "numpy"]),
    "pin": (10_000_000, ["boost", "numpy"]),
    "boost": (90_000_000, []),
    "scipy": (50_000_000, ["numpy"]),
    "numpy": (20_000_000, []),
}


def test_every_dependency_has_a_sentence_and_no_other_has() -> None:
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    names = {re.match(r"[\w.-]+", line)[0] for line in wanted}  # type: ignore[index]
    assert names == set(install.GIVES) - {"arm-calib"}


def test_a_dependency_costs_what_only_it_needs() -> None:
    found = {row["what"]: row for row in install.rows(FOUND)}
    assert [row["value"] for row in found.values()] == [100.0, 50.0, 0.0]
    assert "counts 1 that only it needs" in found["install: pin"]["note"]
    assert found["install: numpy"]["note"].endswith("others need it too")
