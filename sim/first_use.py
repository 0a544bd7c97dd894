"""One message when numerical kernels are compiled, once per computer, to explain the wait."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_notify: Callable[[str], None] | None = None


def announce(notify: Callable[[str], None] | None) -> None:
    """Call `notify` once in this process when kernels are compiled, not when they come from the cache; None: no call."""
    global _notify
    _notify = notify


def listen() -> None:
    """Follow Numba's compilations from now on."""
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, found: event.Event) -> None:
            _compiling(found.data)

        def on_end(self, found: event.Event) -> None:
            """Nothing to report."""

    event.register("numba:compile", Listener())


def _compiling(data: Any) -> None:
    global _notify
    notify, _notify = _notify, None
    if notify is None:
        return
    place = getattr(getattr(data.get("dispatcher"), "_cache", None), "cache_path", None)
    kept = f"they are kept in {place}" if place else "they are not kept, because no cache folder is writable"
    notify(f"compiling numerical kernels for this computer, some seconds of processor time; {kept}")
