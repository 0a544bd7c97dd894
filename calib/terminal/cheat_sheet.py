"""The cheat sheet: every task on one page. `calib help` prints it, and docs/cheat-sheet.md is written from it by `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

# heading -> (what to do, the command)
SHEET: dict[str, list[tuple[str, str]]] = {
    "Begin": [
        ("see all steps on a simulated arm", "calib demo"),
        ("find the hardware, write the first cell", "calib init"),
        ("be guided through a whole session", "calib go CELL"),
        ("add an arm of your own", "calib arm new my.urdf"),
    ],
    "A session, step by step": [
        ("check the device; nothing moves", "calib check CELL"),
        ("also move every joint by two degrees", "calib check CELL --move"),
        ("plan motions", "calib plan ARM --cell CELL"),
        ("run and record them", "calib record CELL latest"),
        ("identify friction, masses, inertias", "calib identify ARM LOG... --holdout LOG"),
        ("test on an unseen motion", "calib validate latest LOG"),
        ("identify the missing effect", "calib diagnose ARM LOG... --holdout LOG"),
        ("bring simulated motion closer to recordings", "calib polish latest LOG... --holdout LOG"),
        ("find what has changed since", "calib diagnose ARM LOG... --baseline LOG..."),
        ("plan a motion that decides between effects", "calib plan ARM --cell CELL --discriminate latest"),
        ("use the result in other tools", "calib export latest"),
    ],
    "Look back": [
        ("list the runs so far", "calib runs"),
        ("show a run and its pages", "calib report latest"),
        ("repeat an earlier run", "calib runs latest --again"),
        ("compare two runs", "calib report RUN RUN"),
        ("play a recording", "calib replay LOG"),
        ("import another format", "calib import FILE"),
    ],
    "At work": [
        ("watch payload, contact and wear live", "calib watch CELL"),
        ("many arms", "calib fleet FOLDER"),
    ],
    "Hardware": [
        ("find CAN drives", "calib servo scan --interface I --channel C"),
        ("look at CAN drives", "calib servo CELL"),
        ("run an emulated controller", "calib emulate CELL"),
        ("capture a robot's bytes for a bug report", "calib capture CELL"),
        ("list all physical effects", "calib effects"),
    ],
}
NOTES = (
    "CELL: a name in configs/, or a file. ARM: a name in configs/, or a folder.",
    "LOG: .mcap, ur_rtde .csv, ROS bag. `latest`: newest calibrated arm, plan or run.",
    "Every command: --help with an example, --quiet. Most: --json, --out DIR.",
    "Exit codes: 0 done, 1 the answer is no, 2 usage or data, 3 safety stop,\n"
    "4 device, 70 a fault of the program, 130 interrupted, 141 the reader of the\n"
    "output has gone. Ctrl-C stops a moving arm.",
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
