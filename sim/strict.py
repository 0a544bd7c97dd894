"""Configuration tables that reject unknown keys, missing keys and numbers that are not finite."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, ValidationError

from sim.errors import ConfigError
from sim.files import checked_label, checked_name
from sim.resources import nearest


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be finite")
    return value


# strict: "1" and true are not numbers; 1 is
Finite = Annotated[float, Strict(), AfterValidator(_finite)]
Positive = Annotated[float, Strict(), AfterValidator(_finite), Field(gt=0)]
NotNegative = Annotated[float, Strict(), AfterValidator(_finite), Field(ge=0)]

Name = Annotated[str, AfterValidator(checked_name)]
Label = Annotated[str, AfterValidator(checked_label)]

MAX_FAULTS = 10  # reported at once

T = TypeVar("T", bound=BaseModel)


class StrictTable(BaseModel):
    """A table of a configuration file; a key that it does not list is an error."""

    model_config = ConfigDict(extra="forbid", strict=False, frozen=True)


def validated(table: type[T], data: dict[str, Any], file: Path | str) -> T:
    """`data` as `table`; ConfigError names key, value and rule, and for an unknown key the known ones."""
    try:
        return table.model_validate(data)
    except ValidationError as error:
        lines = []
        for item in error.errors()[:MAX_FAULTS]:
            key = ".".join(str(x) for x in item["loc"])
            if item["type"] == "extra_forbidden":
                owner = _owner(table, item["loc"][:-1])
                known = [f.alias or n for n, f in owner.model_fields.items()] if owner else []
                lines.append(f"unknown key {key}; {nearest(str(item['loc'][-1]), known)}")
            elif item["type"] == "missing":
                lines.append(f"missing key {key}; add it: it is never guessed")
            elif item["type"] == "union_tag_invalid":
                kind, kinds = item["ctx"]["tag"], re.findall(r"'([^']*)'", item["ctx"]["expected_tags"])
                lines.append(f"{key}.{item['ctx']['discriminator'].strip(chr(39))} = {kind!r}: unknown; {nearest(kind, kinds)}")
            else:
                message = item["msg"].removeprefix("Value error, ")
                at = f"{key} = {item['input']!r:.80}: " if key else ""  # of the table as a whole
                lines.append(f"{at}{message[0].lower()}{message[1:]}")
        more = error.error_count() - MAX_FAULTS
        lines += [f"and {more} more"] if more > 0 else []
        raise ConfigError(f"{file}: " + "; ".join(lines)) from error


def _owner(table: type[BaseModel], location: tuple[Any, ...]) -> type[BaseModel] | None:
    """The table at `location`; where it is one of several kinds, as an obstacle is, the location names its kind."""
    owners: list[type[BaseModel]] = [table]
    for key in location:
        if isinstance(key, int):
            continue
        kinds = [o for o in owners if any(key in get_args(f.annotation) for f in o.model_fields.values())]
        if len(owners) > 1 and kinds:
            owners = kinds
        else:
            owners = [
                t for o in owners for n, f in o.model_fields.items() if key in (n, f.alias) for t in _tables(f.annotation)
            ]
    return owners[0] if owners else None


def _tables(kind: Any) -> list[type[BaseModel]]:
    """The tables in a type, such as those of a list."""
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return [kind]
    return [table for part in get_args(kind) for table in _tables(part)]
