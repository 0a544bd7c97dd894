"""What a browser saw of a page."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Visit:
    """A page as a browser has it open, and everything that it complained of or requested."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
