"""From a received frame to the drive that sent it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import can

from drivers.can_servo.drive import Drive


class Senders:
    """Finds the drive of an arm that sent a frame; drives of several protocols may share a bus."""

    def __init__(self, drives: Sequence[Drive]) -> None:
        self._kinds = list(dict.fromkeys(type(d) for d in drives))
        self._joints: dict[tuple[type[Drive], Hashable], int] = {(type(d), d.key): j for j, d in enumerate(drives)}

    def __call__(self, message: can.Message) -> int | None:
        """The joint's index; None for a frame that no drive of this arm sends."""
        for kind in self._kinds:
            key = kind.key_of(message)
            if key is not None and (j := self._joints.get((kind, key))) is not None:
                return j
        return None
