"""`python -m benchmarks.arms [NAME...] [--new]`: take published arms through the whole workflow on the mock, one row each.

`python -m benchmarks arms` continues where the last call stopped (build/arms.jsonl), for `minutes` at a time: `make arms`.

The models come unedited from the wheel `example-robot-data`, with the options that select the arm in each file. All arms are
given ddq_max and jerk_max, which no model format has. Any further fact is given only after a message has asked for it by name,
and the row records it. A row that ends early holds the message that ended it. With --new the run ends after `calib arm new`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from rich.console import Console
from rich.table import Table

from benchmarks import ONE_THREAD
from benchmarks.imports import commands, git
from benchmarks.kept import FOLDER, Kept
from benchmarks.published_arms import ARMS, DRIVES, FACTS, GIVEN, SHEET, cell_text
from benchmarks.results import digest
from sim.arm import Arm, load_arm
from sim.errors import AnswerIsNo
from sim.stated_facts import LIMIT_UNITS

MEASURES = ("benchmarks.arms", *commands("arm", "check", "plan", "record", "identify", "diagnose", "export"))
STEPS = ("new", "check", "plan", "record", "identify", "diagnose", "export")
# version of the row format and of how a row is measured; a new one discards earlier rows
ROW = "arms/2"
# s, time limit of a step on a computer that is busy with other work; exceeding it ends the row
LONGEST = 3000.0


def robots() -> Path:
    """Folder of the models in the wheel."""
    try:
        files = distribution("example-robot-data").files or []
    except PackageNotFoundError:
        raise SystemExit("example-robot-data is not installed: `make arms` does it") from None
    found = next(f for f in files if f.as_posix().endswith("panda_description/urdf/panda.urdf"))
    return Path(str(found.locate())).resolve().parents[2]


def line(name: str, home: Path, only_new: bool = False) -> dict[str, Any]:
    """Row of one arm: how it ended, the facts given on request, and the seconds of each step of the last attempt."""
    given: list[str] = []
    facts: list[str] = []
    while True:
        begin = time.perf_counter()
        row = attempt(name, home / str(len(given)), facts, only_new)
        row |= {"given": list(given), "seconds": round(time.perf_counter() - begin, 1)}
        what, more = answer(name, row, home / str(len(given)) / name)
        if not more or what in given:
            return row
        given.append(what)
        facts += more


def attempt(name: str, home: Path, facts: Sequence[str], only_new: bool = False) -> dict[str, Any]:
    """Take one arm through the steps: seconds of each, and the message that ended it, if any."""
    file, options = ARMS[name]
    numbers = [] if "--numbers" in facts else ["--numbers", "cad"]
    arm, cell, logs = home / name, home / f"{name}.toml", home / "logs"
    home.mkdir(parents=True, exist_ok=True)
    fit = [str(logs / "friction.mcap"), str(logs / "excitation.mcap"), "--holdout", str(logs / "validation.mcap")]
    new = [str(robots() / file), "--name", name, "--out", str(arm), *SHEET, *numbers, *options, *facts, "--json"]
    commands = {
        "new": ["arm", "new", *new],
        "check": ["check", str(cell)],
        "plan": ["plan", str(arm), "--cell", str(cell), "--quick", "--out", str(home / "plan")],
        "record": ["record", str(cell), str(home / "plan"), "--yes", "--out", str(logs)],
        "identify": ["identify", str(arm), *fit, "--out", str(home / "fit")],
        "diagnose": ["diagnose", str(arm), *fit, "--out", str(home / "diagnosis")],
        "export": ["export", str(home / "fit" / "arm"), "--out", str(home / "exported")],
    }
    row: dict[str, Any] = {"arm": name, "joints": None, "ended": "", "invented": [], "named": [], "unexplained": []}
    for step in STEPS[:1] if only_new else STEPS:
        begin = time.perf_counter()
        try:
            done = subprocess.run(
                [sys.executable, "-m", "calib", *commands[step]], capture_output=True, text=True, check=False, timeout=LONGEST
            )
        except subprocess.TimeoutExpired:
            row["ended"] = f"{step}: not done within {LONGEST:.0f} s on this computer"
            break
        row[step] = round(time.perf_counter() - begin, 1)
        written = home / "diagnosis" / "diagnosis.json"
        # exit code 1 of diagnose means "effects found", not a failure
        if done.returncode and not (step == "diagnose" and done.returncode == 1 and written.exists()):
            row["ended"] = f"{step}: {sentence_of(done)}"
            break
        if step == "diagnose":
            found = json.loads(written.read_text(encoding="utf-8"))
            row["named"] = [" at ".join(filter(None, (e["effect"], e["joint"]))) for e in found["effects"]]
            row["unexplained"] = [u["joint"] for u in found["unexplained"]]
        if step == "new":
            made = json.loads(done.stdout)
            row["joints"] = len(made["joints"])
            row["invented"] = invented(load_arm(arm), robots() / file, [*SHEET, *facts])
            if made["missing"]:
                row["ended"] = f"new: missing: {', '.join(made['missing'])}"
                break
            try:
                cell.write_text(cell_text(name, arm), encoding="utf-8")
            except AnswerIsNo as no:  # what `calib plan` would report without a cell
                row["ended"] = f"plan: {no}"
                break
    return row


def sentence_of(done: subprocess.CompletedProcess[str]) -> str:
    """Why a command ended with a non-zero exit code: its error, or the sentence of a negative result."""
    answers = [line for line in done.stdout.splitlines() if line.startswith("Poor")]
    if answers:  # there may also be notes, which begin like errors
        return " ".join((answers[-1], *(line for line in done.stdout.splitlines() if DRIVES[0] in line)))[:900]
    lines = [line.strip() for line in (done.stdout + done.stderr).splitlines()]
    if error := [k for k, line in enumerate(lines) if line.startswith("calib: ")]:
        failed = [line for line in lines[: error[-1]] if " NO " in line]  # rows of `calib check`, which hold the facts
        return " ".join((*failed, " ".join(lines[error[-1] :]).removeprefix("calib: ")))[:900]
    return (lines[-1:] or ["no sentence"])[-1][:900]


def answer(name: str, row: Mapping[str, Any], folder: Path) -> tuple[str, list[str]]:
    """Fact that the message ending a row asks for, and the options that state it; ("", []) if it asks for none."""
    for sentence, options in FACTS.get(name, {}).items():
        if sentence in row["ended"]:
            return sentence.removeprefix("missing: "), options
    sentence, shares = DRIVES
    if sentence not in row["ended"]:
        return "", []
    arm = load_arm(folder)
    scale = {"coulomb": arm.tau_max, "viscous": arm.tau_max / arm.dq_max, "inertia": arm.tau_max / arm.ddq_max}
    given = {key: ",".join(f"{share * x:.4g}" for x in scale[key]) for key, share in shares.items()}
    return "friction and reflected inertia of the drives", [
        x for key, row in given.items() for x in ("--drive", f"{key}={row}")
    ]


def invented(arm: Arm, file: Path, options: Sequence[str]) -> list[str]:
    """Limits of an arm that neither its URDF nor an option states."""
    given = {option.partition("=")[0] for option in options}
    stated = {}
    for joint in ElementTree.parse(file).getroot().iter("joint"):
        limit = joint.find("limit")
        if limit is not None:
            turns = joint.get("type") == "continuous"
            keys = {"dq_max": "velocity", "tau_max": "effort"} | ({} if turns else {"q_min": "lower", "q_max": "upper"})
            stated[joint.get("name")] = {key: float(limit.get(of, "nan")) for key, of in keys.items()}
    out = []
    for key in LIMIT_UNITS:
        for name, value in zip(arm.joint_names, getattr(arm, key).tolist(), strict=True):
            own = stated.get(name, {}).get(key, float("nan"))
            if key not in given and math.isfinite(value) and not math.isclose(value, own, rel_tol=1e-9, abs_tol=1e-12):
                out.append(f"{key} of {name}: {value:g}, its file has {own:g}")
    return out


def run(minutes: float = 30.0, names: Sequence[str] = tuple(ARMS)) -> list[dict[str, Any]]:
    """Try arms for `minutes`; return rows (what, value, unit, bar, note) over all arms tried so far.

    Order: arms never tried, then arms that failed on older code, then arms that passed on older code.
    """
    end = time.monotonic() + 60 * minutes
    code = " ".join(digest(path) for path in MEASURES)
    kept = Kept(FOLDER / "arms.jsonl", ROW)
    found = kept.found
    old = [name for name in names if name in found and found[name]["code"] != code]
    order = [name for name in names if name not in found] + sorted(old, key=lambda name: not found[name]["ended"])
    for name in order:
        if time.monotonic() < end:
            with tempfile.TemporaryDirectory(prefix="calib-arms-") as home:
                row = line(name, Path(home))
            found.pop(name, None)
            kept.keep(name, row | {"code": code, "commit": git("rev-parse", "--short=12", "HEAD")})
    return rows({name: found[name] for name in ARMS if name in found}, code)


def rows(found: Mapping[str, Mapping[str, Any]], code: str) -> list[dict[str, Any]]:
    """The counts, then one row per arm. An arm tried on code other than `code` names its commit."""
    older = {name for name, row in found.items() if row["code"] != code}
    tried = f"{len(found)} of {len(ARMS)} tried" + f", {len(older)} of them on an older commit" * bool(older)
    through = [row for row in found.values() if not row["ended"]]
    wrong = [row for row in through if row["named"]]
    odd = [row for row in through if row["unexplained"]]
    made_up = [sentence for row in found.values() for sentence in row["invented"]]
    out: list[dict[str, Any]] = [
        {"what": "published arms through the whole line", "value": len(through), "bar": str(len(ARMS)),
         "note": f"{tried}; {sum(not row['given'] for row in through)} with nothing but their file, ddq_max and jerk_max"},
        {"what": "invented limits", "value": len(made_up), "bar": "0", "note": "; ".join(made_up)[:400] or tried},
        {"what": "arms with an effect named that is not there", "value": len(wrong), "bar": "0",
         "note": "; ".join(f"{row['arm']}: {', '.join(row['named'])}" for row in wrong)[:600] or f"{len(through)} diagnosed"},
        {"what": "arms with structure reported as unexplained although nothing is hidden", "value": len(odd), "bar": "0",
         "note": "; ".join(f"{row['arm']}: {', '.join(row['unexplained'])}" for row in odd)[:600] or f"{len(through)} diagnosed"},
    ]  # fmt: skip
    for name, row in found.items():
        steps = (
            f"commit {row['commit']}; " * (name in older)
            + f"{row['joints']} joints; {row['seconds']:.0f} s: "
            + ", ".join(f"{s} {row[s]:.0f}" for s in STEPS if s in row)
        )
        after = f" after giving {' and '.join(GIVEN.get(what, what) for what in row['given'])}" if row["given"] else ""
        value = f"failed at {row['ended'].partition(':')[0]}" if row["ended"] else "through"
        out.append({"what": name, "value": value + after, "note": f"{steps}. {row['ended']}"[:900] if row["ended"] else steps})
    return out


def main() -> None:
    """Run the arms and print the table. Exit code 1 if any arm did not pass."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.arms", description=__doc__)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(ARMS)}; all if none")
    parser.add_argument("--new", action="store_true", help="only `calib arm new`")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file")
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)
    found = []
    for name in given.name or ARMS:
        if name not in ARMS:
            parser.error(f"unknown arm {name!r}; known: {', '.join(ARMS)}")
        with tempfile.TemporaryDirectory(prefix="calib-arms-") as home:
            found.append(line(name, Path(home), given.new))
        print(json.dumps(found[-1]), file=sys.stderr, flush=True)
        if given.json:
            given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    steps = STEPS[:1] if given.new else STEPS
    grid = Table(title="seconds of each step", title_justify="left")
    for heading in ("arm", "joints", *steps, "given", "ended by"):
        grid.add_column(heading, justify="left" if heading in ("arm", "given", "ended by") else "right", overflow="fold")
    for row in found:
        grid.add_row(*(str(row.get(key, "")) for key in ("arm", "joints", *steps)), "; ".join(row["given"]), row["ended"])
    console = Console(width=None if sys.stdout.isatty() else 180)
    console.print(grid)
    through = sum(not row["ended"] for row in found)
    console.print(f"{through} of {len(found)} came through")
    raise SystemExit(through < len(found))


if __name__ == "__main__":
    main()
