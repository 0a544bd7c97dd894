"""Every key of a hand-written file is in a table of the page that describes it, and so is a default that is a number."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from drivers.mock import MockOptions
from drivers.replay import ReplayOptions
from drivers.ur_rtde.options import UrOptions
from sim.arm_table import ArmTable
from sim.can_wiring import CanOptions, ServoTable
from sim.cell import CellTable
from sim.emulated.ur.build import UrEmulation

DOCS = Path(__file__).resolve().parents[1] / "docs"
WHERE: dict[type[BaseModel], str] = {
    CellTable: "keys.md", ArmTable: "keys.md", UrOptions: "keys.md", MockOptions: "keys.md", ReplayOptions: "keys.md",
    UrEmulation: "keys.md", CanOptions: "first-day-can.md",
}  # fmt: skip
# default gains of 0, which a cell file may leave out only for an ODrive
NEEDED = {(ServoTable, "kp"), (ServoTable, "kd")}


def tables(kind: Any) -> Iterator[type[BaseModel]]:
    """The table and the tables nested in it."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind
        for field in kind.model_fields.values():
            yield from tables(field.annotation)
    else:
        for part in get_args(kind):
            yield from tables(part)


def keys(schema: type[BaseModel]) -> dict[str, list[tuple[type[BaseModel], Any]]]:
    """Key -> the tables that have it, with its default; without keys that only open another table."""
    out: dict[str, list[tuple[type[BaseModel], Any]]] = {}
    for table in tables(schema):
        for name, field in table.model_fields.items():
            if next(tables(field.annotation), None) is None:
                out.setdefault(field.alias or name, []).append((table, field.default))
    return out


def rows_naming(page: str) -> dict[str, list[str]]:
    """Key -> the rows of the page's tables that name it."""
    out: dict[str, list[str]] = {}
    for row in (DOCS / page).read_text(encoding="utf-8").splitlines():
        for key in re.findall(r"`(\w+)`", row) if row.startswith("| ") else ():
            out.setdefault(key, []).append(row)
    return out


@pytest.mark.parametrize("schema", WHERE, ids=lambda s: s.__name__)
def test_every_key_stands_in_a_document(schema: type[BaseModel]) -> None:
    assert keys(schema).keys() - rows_naming(WHERE[schema]).keys() == set()


@pytest.mark.parametrize("schema", WHERE, ids=lambda s: s.__name__)
def test_a_default_that_is_a_number_is_the_stated_one(schema: type[BaseModel]) -> None:
    rows, wrong = rows_naming(WHERE[schema]), {}
    for key, owners in keys(schema).items():
        for table, value in owners:
            number = isinstance(value, int | float) and not isinstance(value, bool) and (table, key) not in NEEDED
            if number and not any(re.search(rf"(?<![\w.]){value:.10g}(?!\.?\w)", row) for row in rows[key]):
                wrong[f"{table.__name__}.{key}"] = value
    assert wrong == {}
