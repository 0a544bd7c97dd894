"""A promise, and whether it was kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Promise:
    """name: what is promised; kept: whether it was kept; detail: what was found instead."""

    name: str
    kept: bool
    detail: str = ""


@dataclass
class Promises:
    """Promises that are checked one after another."""

    found: list[Promise] = field(default_factory=list)

    def keep(self, name: str, holds: Callable[[], object]) -> None:
        """Check one: `holds` returns None, True or an empty text if it is kept, else False or what was found; an exception breaks it."""
        try:
            answer = holds()
        except Exception as error:  # whatever the checked code raises is the finding
            self.found.append(Promise(name, False, f"{type(error).__name__}: {error}"))
            return
        kept = answer is None or answer is True or answer == ""
        self.found.append(Promise(name, kept, "" if kept else str(answer)))

    def refuse(self, name: str, attempt: Callable[[], object], *kinds: type[Exception]) -> None:
        """Check a refusal: `attempt` must raise one of `kinds`, with a message of more than 10 characters."""

        def holds() -> str:
            try:
                got = attempt()
            except kinds as error:
                return "" if len(str(error)) > 10 else f"{type(error).__name__} without a sentence"
            except Exception as error:
                return f"raised {type(error).__name__}: {error}; {' or '.join(k.__name__ for k in kinds)} is promised"
            return f"was accepted and returned {got!r}"

        self.keep(name, holds)


def broken(promises: Iterable[Promise]) -> list[Promise]:
    """The promises that were not kept."""
    return [p for p in promises if not p.kept]


def assert_kept(promises: Iterable[Promise]) -> None:
    """AssertionError that lists every promise that was not kept."""
    promises = list(promises)
    assert promises, "nothing was checked"
    failed = broken(promises)
    lines = "\n".join(f"- {p.name}: {p.detail}" for p in failed)
    assert not failed, f"{len(failed)} of {len(promises)} promises broken:\n{lines}"
