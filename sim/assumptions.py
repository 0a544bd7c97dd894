"""What a cell file may take for granted: rules that an operator can lift by saying so, each with the sentence that is then shown and recorded.

`assume = ["..."]` at the top of a cell file. A rule that nobody can lift has no place here, and neither has one that protects people.
"""

from __future__ import annotations

ASSUMPTIONS: dict[str, str] = {
    # can_servo
    "watchdog-works": "the drives switch off when their commands stop, although that cannot be read back; it was tried by pulling the cable",
    "identifiers-as-stated": "each drive identifier sits on the joint of the cell file; serial numbers are not compared",
    "turns-as-read": "no joint is a whole turn away from what its drive reports",
}
