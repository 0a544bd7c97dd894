"""Plug-ins of other packages: entry points of the groups arm_calib.drivers, arm_calib.effects and arm_calib.arms."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

from sim.errors import ConfigError

Group = Literal["drivers", "effects", "arms"]
OWN = "arm-calib"


@cache
def plugins(group: Group) -> dict[str, EntryPoint]:
    """name -> entry point that an installed package adds to a group; ConfigError if two packages add the same name."""
    found: dict[str, EntryPoint] = {}
    for entry in entry_points(group=f"arm_calib.{group}"):
        if entry.name in found and entry.value != found[entry.name].value:
            raise ConfigError(
                f"{group[:-1]} {entry.name!r} comes from {origin(found[entry.name])} and from {origin(entry)}; uninstall one of them"
            )
        found[entry.name] = entry
    return found


def origin(entry: EntryPoint | None) -> str:
    """Package and version of an entry point, such as `package 1.2`; arm-calib if there is none."""
    return OWN if entry is None else f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value


def loaded(entry: EntryPoint, kind: type) -> Any:
    """What the entry point names: a subclass of `kind`, or an instance of it; ConfigError names the package if it is neither."""
    where = f"{entry.group} {entry.name!r} of {origin(entry)}"
    try:
        found = entry.load()
    except Exception as error:  # another package's code may raise anything; report it as a ConfigError
        raise ConfigError(f"{where}: cannot be imported ({type(error).__name__}: {error}); ask its authors") from error
    if not (isinstance(found, kind) or (isinstance(found, type) and issubclass(found, kind))):
        raise ConfigError(f"{where}: {entry.value} is not a {kind.__name__}; ask its authors")
    return found


def check_names(group: Group, own: Iterable[str]) -> None:
    """ConfigError if a package adds a name that is built in, which would be ambiguous."""
    for name in set(own) & set(plugins(group)):
        raise ConfigError(
            f"{origin(plugins(group)[name])} adds {group[:-1]} {name!r}, which arm-calib already has; uninstall that package"
        )


def arm_folder(name: str) -> Path | None:
    """The folder of an arm that a package adds: the entry point names the package that holds arm.toml, or NAME/arm.toml."""
    entry = plugins("arms").get(name)
    if entry is None:
        return None
    try:
        spec = find_spec(entry.module)
    except (ImportError, ValueError):
        spec = None
    homes = [Path(p) for p in (spec.submodule_search_locations or ())] if spec else []
    for folder in (f for home in homes for f in (home, home / name)):
        if (folder / "arm.toml").is_file():
            return folder
    raise ConfigError(f"arm {name!r} of {origin(entry)}: {entry.value} holds no arm.toml; ask its authors")


def arm_origin(name: str, model: Path) -> str:
    """Package and version that an arm's model file comes from; arm-calib for a shipped arm and for a user's own folder."""
    entry = plugins("arms").get(name)
    folder = arm_folder(name) if entry else None
    return origin(entry if folder and model.resolve().is_relative_to(folder.resolve()) else None)
