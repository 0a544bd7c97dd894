"""The state of a page in a browser."""

from dataclasses import dataclass, field
from typing import Any


@dataclass
class Visit:
    """A page open in a browser, with the complaints and requests that it caused."""

    page: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)
