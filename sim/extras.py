"""Optional dependencies, `pip install 'arm-calib[NAME]'`; a missing one is reported in one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from sim.errors import ConfigError

# name of the extra in pyproject.toml -> the modules that come with it
EXTRAS: dict[str, tuple[str, ...]] = {
    "fleet": ("dask", "distributed", "fsspec", "pyarrow", "cryptography"),
    "tables": ("pyarrow",),
}


@contextmanager
def needing(extra: str, what: str) -> Iterator[None]:
    """Context for imports: ConfigError names the extra if one of its modules is missing; `what` is what needs them."""
    try:
        yield
    except ModuleNotFoundError as error:
        name = (error.name or "").partition(".")[0]
        if name not in EXTRAS[extra]:
            raise
        raise ConfigError(f"{what} needs {name}, which is not installed; pip install 'arm-calib[{extra}]'") from error


class Lazily:
    """A module of an extra, imported at first use; ConfigError if it is missing."""

    def __init__(self, module: str, extra: str, what: str) -> None:
        self._wanted = module, extra, what

    def __getattr__(self, name: str) -> Any:
        module, extra, what = self._wanted
        with needing(extra, what):
            return getattr(import_module(module), name)
