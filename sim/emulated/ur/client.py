"""A client of the emulated controller."""

from __future__ import annotations

import socket
from dataclasses import dataclass, field

from sim.emulated.ur import line
from sim.emulated.ur.rtde import RtdeSession

UNREAD_MAX = 1 << 20  # bytes that a client may leave unread before the controller closes the connection


@dataclass
class Client:
    """A connection to one port of the controller, with unsent bytes and incomplete requests."""

    socket: socket.socket
    port: int
    session: RtdeSession | None = None
    line: line.Line = field(default_factory=line.Line)
    text: bytes = b""
    unsent: bytes = b""

    def send(self, data: bytes) -> bool:
        """Send as much as the connection takes now; return False if it is broken or the client leaves too much unread."""
        self.unsent += data
        try:
            self.unsent = self.unsent[self.socket.send(self.unsent) :]
        except BlockingIOError:
            return len(self.unsent) <= UNREAD_MAX
        except OSError:
            return False
        return True
