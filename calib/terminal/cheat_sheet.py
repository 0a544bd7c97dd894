"""The cheat sheet: every task on one page. `calib help` prints it, and docs/cheat-sheet.md is written from it by `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

# heading -> (what to do, the command)
SHEET: dict[str, list[tuple[str, str]]] = {
    "Begin": [
        ("see everything on a simulated arm", "calib demo"),
        ("find a UR, write its cell; find CAN adapters", "calib init"),
        ("a whole session, guided", "calib go CELL"),
        ("an arm of your own", "calib arm new my.urdf"),
    ],
    "A session, step by step": [
        ("ask the device; nothing moves", "calib check CELL"),
        ("two degrees with every joint", "calib check CELL --move"),
        ("plan motions", "calib plan ARM --cell CELL"),
        ("drive and record them", "calib record CELL latest"),
        ("identify friction, masses, inertias", "calib identify ARM LOG... --holdout LOG"),
        ("test on an unseen motion", "calib validate latest LOG"),
        ("identify the missing effect", "calib diagnose ARM LOG... --holdout LOG"),
        ("let it move nearer to the recordings", "calib polish latest LOG... --holdout LOG"),
        ("what has changed since then", "calib diagnose ARM LOG... --baseline LOG..."),
        ("a motion that decides between effects", "calib plan ARM --cell CELL --discriminate latest"),
        ("use the result elsewhere", "calib export latest"),
    ],
    "Look back": [
        ("what was done", "calib runs"),
        ("one run, and its pages", "calib report latest"),
        ("do a run again", "calib runs latest --again"),
        ("compare two runs", "calib report RUN RUN"),
        ("play a recording", "calib replay LOG"),
        ("read another format", "calib import FILE"),
    ],
    "At work": [
        ("payload, contact, wear as they happen", "calib watch CELL"),
        ("many arms", "calib fleet FOLDER"),
    ],
    "Hardware": [
        ("find CAN drives", "calib servo scan --interface I --channel C"),
        ("look at CAN drives", "calib servo CELL"),
        ("an emulated controller", "calib emulate CELL"),
        ("a robot's bytes, for a bug report", "calib capture CELL"),
        ("all physical effects", "calib effects"),
    ],
}
NOTES = (
    "CELL, ARM: a name in configs/, or a file. LOG: .mcap, .csv, a rosbag2 folder.",
    "`latest` is the newest that fits: arm that was written, plan, or run.",
    "Every command: --help with an example, --quiet. Most: --json, --out DIR.",
    "Exit codes: 0 done, 1 the answer is no, 2 usage or data, 3 safety stop,\n"
    "4 device, 70 a fault of the program, 130 interrupted. Ctrl-C stops a moving arm.",
)


def lines() -> list[str]:
    """The sheet for a terminal of 80 columns."""
    out: list[str] = []
    for heading, tasks in SHEET.items():
        out += ["", heading] if out else [heading]
        for what, call in tasks:
            line = f"  {what:<44}  {call}"
            out += [line] if len(line) <= 80 else [f"  {what}", f"{'':6}{call}"]
    return [*out, "", *"\n".join(NOTES).splitlines()]


def page() -> str:
    """docs/cheat-sheet.md."""
    parts = ["# Cheat sheet\n\n`calib help` prints this page. It is written by `make docs`.\n"]
    for heading, tasks in SHEET.items():
        rows = "\n".join(f"| {what} | `{call}` |" for what, call in tasks)
        parts.append(f"\n## {heading}\n\n| to | type |\n|---|---|\n{rows}\n")
    return "".join([*parts, "\n", *(f"- {note}\n" for note in NOTES)])


def write(docs: Path) -> None:
    """Write cheat-sheet.md into `docs`."""
    (docs / "cheat-sheet.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
