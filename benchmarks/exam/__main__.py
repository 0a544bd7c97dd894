"""Make cases, or sit the exam.

    python -m benchmarks.exam generate --count 40 --seed 7 --out build/cases     cases and truths, in the layout of practice cases
    python -m benchmarks.exam run --count 300 --seed 1 --out build/exam          make missing cases, ask, score, print
    python -m benchmarks.exam run --kinds clean --arms servo6 ...                only a part
    ARM_CALIB_DATA=... python -m benchmarks.exam real --count 27                 effects injected into real recordings

Every case depends only on the seed and its number; a longer exam begins with the shorter one of the same seed. `run` exits with
0 whatever the score: it is a measurement.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import os
import sys
from pathlib import Path

from benchmarks.exam import real
from benchmarks.exam.cases import ARMS, KINDS, Case, listed, make
from benchmarks.exam.run import Exam, sit


def main(arguments: list[str] | None = None) -> None:
    given = _parser().parse_args(arguments)
    if given.verb == "real":
        if not os.environ.get("ARM_CALIB_DATA"):
            print("effects in real recordings: skipped, ARM_CALIB_DATA names no folder with them")
            return
        exam = Exam(given.out, given.seed, given.calib, given.timeout, given.keep, False)
        real.sit(Path(os.environ["ARM_CALIB_DATA"]), exam, given.count)
        return
    cases = [c for c in listed(given.count, given.seed) if _wanted(c, given)]
    if not cases:
        sys.exit("no case of this exam fits the options; give other --kinds, --arms, --effects or a larger --count")
    if given.verb == "generate":
        with concurrent.futures.ProcessPoolExecutor(given.jobs) as pool:
            waiting = {pool.submit(make, case, given.out / case.name): case for case in cases}
            for done in concurrent.futures.as_completed(waiting):
                done.result()
                print(given.out / waiting[done].name, flush=True)
        return
    sit(cases, Exam(given.out, given.seed, given.calib, given.timeout, given.keep, given.final, given.record), given.jobs)


def _wanted(case: Case, given: argparse.Namespace) -> bool:
    return (
        case.kind in given.kinds
        and case.arm in given.arms
        and (not given.effects or any(name in given.effects for name, _ in case.chosen))
        and (not given.only or case.name in given.only)
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.exam", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    generate = verbs.add_parser("generate", help="write cases with their truths")
    run = verbs.add_parser("run", help="have `calib diagnose` answer them, and score")
    recordings = verbs.add_parser("real", help="the same with effects added to real recordings under ARM_CALIB_DATA")
    for part, count in ((generate, 300), (run, 300), (recordings, 27)):
        part.add_argument("--count", type=int, default=count, help=f"how many cases there are ({count})")
        part.add_argument("--seed", type=int, default=1)
        part.add_argument("--out", type=Path, default=Path("build/exam"))
    for part in (generate, run):
        part.add_argument("--jobs", type=int, default=1)
        part.add_argument("--kinds", nargs="+", choices=sorted(KINDS.values()), default=sorted(KINDS.values()))
        part.add_argument("--arms", nargs="+", choices=ARMS, default=list(ARMS))
        part.add_argument("--effects", nargs="+", help="only cases with one of these hidden")
        part.add_argument("--only", nargs="+", help="only these cases, by name")
    for part in (run, recordings):
        part.add_argument("--calib", default=f"{sys.executable} -m calib", help="the command to examine")
        part.add_argument("--timeout", type=float, default=300, help="s of CPU for one answer (300)")
        part.add_argument("--keep", action="store_true", help="score the answers that are there, ask for the missing ones")
    run.add_argument("--final", action="store_true", help="validate the corrected arms on a log the diagnosis never saw")
    run.add_argument(
        "--record", action="store_true", help="write results/exam.json; without it, what differs from it is printed"
    )
    return parser


main()
