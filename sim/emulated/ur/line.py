"""Faults of data frames between controller and client: lost, late, duplicated, frozen or reordered."""

from __future__ import annotations

from collections import deque

FAULTS = ("gap", "drop", "delay", "duplicate", "freeze", "reorder")
GAP = 8  # frames that `gap` loses; a motion tolerates this loss
DROPPED = 50  # frames that `drop` loses; a motion does not tolerate it
DELAY = 0.25  # s by which `delay` holds back every later frame


class Line:
    """Data frames of one connection; `fault` switches on one of FAULTS for all later frames. `gap` and `drop` end by themselves."""

    def __init__(self) -> None:
        self._fault: str | None = None
        self._drop = 0
        self._frozen: bytes | None = None
        self._held: bytes | None = None
        self._late: deque[tuple[float, bytes]] = deque()

    def fault(self, name: str | None) -> None:
        """Switch to a fault; None ends the present one."""
        self._fault, self._frozen, self._held = name, None, None
        self._drop = {"gap": GAP, "drop": DROPPED}.get(name or "", 0)

    def carry(self, frame: bytes | None, now: float) -> bytes:
        """The bytes that leave now, with `frame` (or None) coming in; called in every cycle."""
        if self._fault == "delay":
            if frame is not None:
                self._late.append((now + DELAY, frame))
            due = b""
            while self._late and self._late[0][0] <= now:
                due += self._late.popleft()[1]
            return due
        if frame is None:
            return b""
        if self._drop > 0:
            self._drop -= 1
            return b""
        if self._fault == "duplicate":
            return frame + frame
        if self._fault == "freeze":
            self._frozen = self._frozen or frame
            return self._frozen
        if self._fault == "reorder":
            if self._held is None:
                self._held = frame
                return b""
            out, self._held = frame + self._held, None
            return out
        return frame
