"""`python -m benchmarks.public_arms [NAME...] [--new]`: published arms through the whole line on the mock, one row each.

`python -m benchmarks public_arms` goes on where the last call ended (build/public_arms.jsonl), for `minutes` at a time: `make arms`.

The models are those of the wheel `example-robot-data`, unedited. Beside each stand the options that say what is the arm, and the facts
that its file lacks; a row that ends early carries the sentence that ended it. With --new the line ends after `calib arm new`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks import ONE_THREAD
from benchmarks.kept import FOLDER, Kept
from benchmarks.results import CODE, digest
from sim.errors import AnswerIsNo

STEPS = ("new", "check", "plan", "record", "identify", "diagnose", "export")
TURN = ["--limit", "q_min=-6.28", "--limit", "q_max=6.28"]
# name -> file in the wheel, what is the arm, and facts that the file lacks or has wrong
ARMS: dict[str, tuple[str, list[str]]] = {
    "panda": ("panda_description/urdf/panda.urdf", ["--tool", "panda_hand"]),
    "panda_capsules": ("panda_description/urdf/panda_collision.urdf", ["--tool", "panda_hand"]),
    "so100": ("so_arm_description/urdf/so100.urdf", []),
    "so101": ("so_arm_description/urdf/so101.urdf", []),
    "z1": ("z1_description/urdf/z1.urdf", []),
    "z1_on_b1": ("b1_description/urdf/b1-z1.urdf", ["--joints", "joint?"]),
    "talos_left": ("talos_data/robots/talos_left_arm.urdf", []),
    "talos_right": ("talos_data/robots/talos_reduced.urdf", ["--tool", "arm_right_7_link"]),
    "tiago": ("tiago_description/robots/tiago.urdf", ["--tool", "arm_7_link"]),
    "tiago_no_hand": ("tiago_description/robots/tiago_no_hand.urdf", ["--tool", "arm_tool_link"]),
    "tiago_dual_left": ("tiago_description/robots/tiago_dual.urdf", ["--tool", "arm_left_7_link"]),
    "tiago_pro_left": ("tiago_pro_description/robots/tiago_pro.urdf", ["--tool", "arm_left_7_link"]),
    "baxter_left": ("baxter_description/urdf/baxter.urdf", ["--tool", "left_hand_link"]),
    "baxter_right": ("baxter_description/urdf/baxter.urdf", ["--tool", "right_hand_link"]),
    "centauro_left": ("centauro_description/urdf/centauro.urdf", ["--joints", "j_arm1_?"]),
    "kinova_j2s6s200": ("kinova_description/robots/kinova.urdf", TURN),
    "kinova_on_anymal": ("anymal_b_simple_description/robots/anymal-kinova.urdf", ["--joints", "j2s6s200_joint_?"]),
    "ur3": ("ur_description/urdf/ur3_robot.urdf", []),
    "ur3_gripper": ("ur_description/urdf/ur3_gripper.urdf", []),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", []),
    "ur5_gripper": ("ur_description/urdf/ur5_gripper.urdf", []),
    "ur10_limited": ("ur_description/urdf/ur10_joint_limited_robot.urdf", []),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", []),
    "pr2_right": (
        "pr2_description/urdf/pr2.urdf",
        [
            "--tool",
            "r_wrist_roll_link",
            "--lock",
            "torso_lift_joint",
            "--numbers",
            "guessed",
            # the fore-arm and the wrist turn without end
            "--limit",
            "q_min=-2.285,-0.523,-3.9,-2.321,-6.28,-2.094,-6.28",
            "--limit",
            "q_max=0.714,1.396,0.8,0,6.28,0,6.28",
        ],
    ),
    "romeo_right": ("romeo_description/urdf/romeo.urdf", ["--tool", "r_wrist"]),
    "icub_right": ("icub_description/robots/icub.urdf", ["--tool", "r_hand", "--lock", "torso_*"]),
    "alex_left": ("alex_description/urdf/alex_nub_hands.urdf", ["--tool", "LeftGripperYawLink"]),
    "g1_left": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", ["--tool", "left_rubber_hand"]),
    "double_pendulum": (
        "double_pendulum_description/urdf/double_pendulum.urdf",
        [*TURN, "--limit", "dq_max=6", "--limit", "tau_max=5"],
    ),
}
# s that a step may take; longer is an end too
LONGEST = 240.0
# m from the base to the floor, of an arm whose file begins at its shoulder or at its trunk
FLOOR = {"talos_left": -1.2, "alex_left": -1.2}
# no model format has these
SHEET = ["--limit", "ddq_max=5", "--limit", "jerk_max=100", "--numbers", "cad"]
CELL = 'schema = "cell/1"\nname = "{name}"\narm = "{arm}"\ndriver = "mock"\nhome = {home}\n'


def robots() -> Path:
    """The folder of models in the wheel."""
    try:
        files = distribution("example-robot-data").files or []
    except PackageNotFoundError:
        raise SystemExit("example-robot-data is not installed: `make arms` does it") from None
    found = next(f for f in files if f.as_posix().endswith("panda_description/urdf/panda.urdf"))
    return Path(str(found.locate())).resolve().parents[2]


def line(name: str, home: Path, only_new: bool = False) -> dict[str, object]:
    """The steps of one arm: seconds each, and the sentence that ended it where one did."""
    file, options = ARMS[name]
    arm, cell, logs = home / name, home / f"{name}.toml", home / "logs"
    fit = [str(logs / "friction.mcap"), str(logs / "excitation.mcap"), "--holdout", str(logs / "validation.mcap")]
    commands = {
        "new": ["arm", "new", str(robots() / file), "--name", name, "--out", str(arm), *SHEET, *options, "--json"],
        "check": ["check", str(cell)],
        "plan": ["plan", str(arm), "--cell", str(cell), "--quick", "--out", str(home / "plan")],
        "record": ["record", str(cell), str(home / "plan"), "--yes", "--out", str(logs)],
        "identify": ["identify", str(arm), *fit, "--out", str(home / "fit")],
        "diagnose": ["diagnose", str(arm), *fit, "--out", str(home / "diagnosis")],
        "export": ["export", str(home / "fit" / "arm"), "--out", str(home / "exported")],
    }
    row: dict[str, object] = {"arm": name, "joints": None, "ended": ""}
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
        # diagnose says "effects found" with 1: an answer, not a failure
        if done.returncode and not (
            step == "diagnose" and done.returncode == 1 and (home / "diagnosis" / "diagnosis.json").exists()
        ):
            row["ended"] = f"{step}: {' '.join((done.stderr or done.stdout).split())[-400:]}"
            break
        if step == "new":
            made = json.loads(done.stdout)
            row["joints"] = len(made["joints"])
            if made["missing"]:
                row["ended"] = f"new: its file lacks {', '.join(made['missing'])}"
                break
            try:
                cell.write_text(_cell(name, arm), encoding="utf-8")
            except AnswerIsNo as answer:  # what `calib plan` would answer without a cell
                row["ended"] = f"plan: {answer}"
                break
    return row


def run(minutes: float = 30.0, names: Sequence[str] = tuple(ARMS)) -> list[dict[str, Any]]:
    """A slice of the arms, then a row of each that was tried so far: what, value, unit, bar, note."""
    end = time.monotonic() + 60 * minutes
    kept = Kept(FOLDER / "public_arms.jsonl", " ".join(digest(path) for path in CODE))
    for name in names:
        if name not in kept.found and time.monotonic() < end:
            with tempfile.TemporaryDirectory(prefix="calib-arms-") as home:
                kept.keep(name, line(name, Path(home)))
    rows = {name: kept.found[name] for name in ARMS if name in kept.found}
    through = sum(not row["ended"] for row in rows.values())
    return [
        {"what": "published arms through the whole line", "value": through, "bar": str(len(ARMS)), "note": f"{len(rows)} of {len(ARMS)} tried"},
        *(
            {"what": name, "value": "through" if not row["ended"] else f"ended at {row['ended'].partition(':')[0]}",
             "note": row["ended"][:200] or f"{row['joints']} joints; seconds: " + ", ".join(f"{s} {row[s]:.0f}" for s in STEPS)}
            for name, row in rows.items()
        ),
    ]  # fmt: skip


def _cell(name: str, arm: Path) -> str:
    """A mock cell of the arm, with the plane that `calib plan` assumes where there is no cell, and a home from which it can move."""
    import numpy as np

    from calib.excitation.home import home_of, open_cell
    from calib.excitation.room import Room
    from sim.arm import load_arm

    model = load_arm(arm)
    cell = open_cell(model)
    plane = cell.table.obstacles[0]
    if name in FLOOR:
        plane = plane.model_copy(update={"position": (0.0, 0.0, FLOOR[name])})
        cell = replace(cell, table=cell.table.model_copy(update={"obstacles": [plane]}))
    home = home_of(Room(model, cell), cell, None, np.random.default_rng(0))
    where = f'[[obstacles]]\nkind = "plane"\nname = "floor"\nposition = {list(plane.position)}\nnormal = [0.0, 0.0, 1.0]\n'
    return CELL.format(name=name, arm=arm, home=[round(float(x), 6) for x in home]) + where


def main() -> None:
    """Run the arms and print the table; exit code 1 where one did not come through."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.public_arms", description=__doc__)
    parser.add_argument("name", nargs="*", help=f"of {', '.join(ARMS)}; all if none")
    parser.add_argument("--new", action="store_true", help="only `calib arm new`")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to this file")
    given = parser.parse_args()
    os.environ.update(ONE_THREAD)
    rows = []
    for name in given.name or ARMS:
        if name not in ARMS:
            parser.error(f"unknown arm {name!r}; known: {', '.join(ARMS)}")
        with tempfile.TemporaryDirectory(prefix="calib-arms-") as home:
            rows.append(line(name, Path(home), given.new))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
        if given.json:
            given.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    steps = STEPS[:1] if given.new else STEPS
    grid = Table(title="seconds of each step", title_justify="left")
    for heading in ("arm", "joints", *steps, "ended by"):
        grid.add_column(heading, justify="left" if heading in ("arm", "ended by") else "right", overflow="fold")
    for row in rows:
        grid.add_row(*(str(row.get(key, "")) for key in ("arm", "joints", *steps, "ended")))
    console = Console(width=None if sys.stdout.isatty() else 180)
    console.print(grid)
    through = sum(not row["ended"] for row in rows)
    console.print(f"{through} of {len(rows)} came through")
    raise SystemExit(through < len(rows))


if __name__ == "__main__":
    main()
