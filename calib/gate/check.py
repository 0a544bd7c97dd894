"""The result of a check, and its possible causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from calib.gate.correction import Correction

MOST_CAUSES = 3  # in a sentence
LIKELIEST, OTHERS, CONVERT = "Most likely cause: ", "Other possible causes: ", "convert it with "


@dataclass(frozen=True)
class Cause:
    """A likely cause: a sentence, how much better the arm's model fits when it is undone (0 where that was not computed), how to undo it."""

    sentence: str
    gain: float = 0.0
    corrections: tuple[Correction, ...] = ()
    interval: tuple[float, float] | None = None


def options(cause: Cause, names: Sequence[str]) -> str:
    """The options of a command that undo a cause."""
    return " ".join(f"--assume {c.word(names)}" for c in cause.corrections)


@dataclass(frozen=True)
class GateCheck:
    """One check: its name, whether it passed, what was found, and the likely causes, best first."""

    check: str
    ok: bool
    detail: str
    causes: tuple[Cause, ...] = field(default=())
    joints: tuple[str, ...] = ()
    of_all: bool = False  # about several recordings together, not about each
    final: bool = False  # failed, and nothing can be computed from the recording, however it is read

    def entry(self) -> dict[str, object]:
        """The check for diagnosis.json: what failed, with its likeliest cause."""
        causes = [cause.sentence for cause in self.causes]
        detail = self.detail
        if not self.ok and causes:
            detail += f". {LIKELIEST}{causes[0]}"
            if self.causes[0].corrections:
                detail += f"; {CONVERT}{options(self.causes[0], self.joints)}"
        return {"check": self.check, "ok": bool(self.ok), "detail": detail, "causes": causes}
