"""What a check found, and what may be the cause."""

from __future__ import annotations

from dataclasses import dataclass, field

from calib.gate.correction import Correction


@dataclass(frozen=True)
class Cause:
    """A likely cause: a sentence, how much better the arm's model fits when it is undone (0 where that was not asked), how to undo it."""

    sentence: str
    gain: float = 0.0
    corrections: tuple[Correction, ...] = ()
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Check:
    """One check: its name, whether it passed, what was found, and the likely causes, best first."""

    check: str
    ok: bool
    detail: str
    causes: tuple[Cause, ...] = field(default=())
    joints: tuple[str, ...] = ()
    of_all: bool = False  # about several recordings together, where it is not about each

    def entry(self) -> dict[str, object]:
        """As diagnosis.json has it: what failed begins with its likeliest cause."""
        causes = [cause.sentence for cause in self.causes]
        said = f"most likely {causes[0]}: {self.detail}" if causes and not self.ok else self.detail
        return {"check": self.check, "ok": bool(self.ok), "detail": said, "causes": causes}
