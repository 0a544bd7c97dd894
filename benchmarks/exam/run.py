"""Sit the exam: make the cases, have `calib diagnose` answer them, compare, print confusion matrix and figures, write JSON."""

from __future__ import annotations

import concurrent.futures
import dataclasses
import json
import os
import resource
import shlex
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.exam.cases import Case, make
from benchmarks.exam.figures import confusion, figures, in_company
from benchmarks.exam.gap import after_over_before
from benchmarks.exam.record import compare_or_write
from benchmarks.exam.scoring import Row, compared


@dataclass(frozen=True)
class Exam:
    """Folder of the cases, seed, command to examine, and CPU time for an answer, s.

    keep: score answers that exist; final: also validate; record: write results/exam.json.
    """

    out: Path
    seed: int
    calib: str
    timeout: float
    keep: bool
    final: bool
    record: bool = False


def sit(cases: list[Case], exam: Exam, jobs: int) -> None:
    """Examine all cases, printing a line for each, then `report`."""
    rows: list[Row] = []
    load = os.getloadavg()[0]
    with concurrent.futures.ProcessPoolExecutor(jobs) as pool:
        for done in concurrent.futures.as_completed(pool.submit(examine, case, exam) for case in cases):
            row = done.result()
            rows.append(row)
            mark = "ok" if row.exact else "  "
            took = f"{row.seconds:.0f} s" if row.seconds is not None else "kept"
            hidden = f"{effects_text(row.truth)}{' ' + row.form if row.form else ''}"
            print(f"{mark} {row.case} {row.arm:7s} severity {row.severity}  {hidden}", end="")
            print(f"  ->  {row.verdict}: {effects_text(row.answer)}  [{took}]", flush=True)
    rows.sort(key=lambda r: r.case)
    report(rows, exam)
    compare_or_write(rows, exam.seed, len(cases), exam.record, round(load, 2))


def examine(case: Case, exam: Exam) -> Row:
    """Make one case if it does not exist, have it answered, and compare."""
    folder, answer = exam.out / f"seed{exam.seed}" / case.name, exam.out / f"seed{exam.seed}-answers" / case.name
    if not (folder / "truth.json").exists():
        make(case, folder)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    seconds, code = None, None
    if not (exam.keep and (answer / "diagnosis.json").exists()):
        answer.mkdir(parents=True, exist_ok=True)
        (answer / "diagnosis.json").unlink(missing_ok=True)
        begin = time.monotonic()
        code, used = run_calib(
            exam, answer / "exam.log", "diagnose", folder / "arm.xml", folder / "friction.mcap", folder / "excitation.mcap",
            "--holdout", folder / "validation.mcap", "--out", answer,
        )  # fmt: skip
        seconds = time.monotonic() - begin
        cost = {"wall": seconds, "cpu": used.ru_utime + used.ru_stime, "memory": used.ru_maxrss * 1024 / 1e6}
        (answer / "seconds.json").write_text(json.dumps(cost) + "\n", encoding="utf-8")
    row = compared(case.name, truth, answer / "diagnosis.json")
    row.seconds, row.exit = seconds, code
    if (answer / "seconds.json").exists():
        cost = json.loads((answer / "seconds.json").read_text(encoding="utf-8"))
        row.cpu, row.memory = cost["cpu"], cost.get("memory")
    if exam.final and row.truth and row.answer:
        corrected = answer / "arm" if (answer / "arm").is_dir() else folder / "arm.xml"
        for tag, arm in (("nominal", folder / "arm.xml"), ("corrected", corrected), ("true", folder / "true")):
            if not (exam.keep and (answer / tag / "prediction.csv").exists()):
                run_calib(exam, answer / "exam.log", "validate", arm, folder / "final.mcap", "--out", answer / tag)
        before, after, best = (answer / tag / "prediction.csv" for tag in ("nominal", "corrected", "true"))
        row.ratio, row.over_true = after_over_before(before, after), after_over_before(best, after)
    return row


def run_calib(exam: Exam, log: Path, *words: object) -> tuple[int, resource.struct_rusage]:
    """Exit code and resource usage of a command, its output appended to `log`; -SIGXCPU if it exceeds its CPU time."""
    command = [*shlex.split(exam.calib), *map(str, words)]
    limit = int(exam.timeout)
    with log.open("a", encoding="utf-8") as file:
        file.write("$ " + shlex.join(command) + "\n")
        file.flush()
        # CPU time rather than wall clock: a busy computer scores like an idle one
        process = subprocess.Popen(
            command, stdout=file, stderr=subprocess.STDOUT, env=os.environ | {"OMP_NUM_THREADS": "1"},
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit)),
        )  # fmt: skip
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        return process.returncode, used


def report(rows: list[Row], exam: Exam) -> None:
    """Print the confusion matrix and the figures; write them to JSON."""
    truths, answers, counts = confusion(rows)
    width = max(map(len, answers), default=0)
    print(f"\nrows: what was hidden; columns: the first name given\n{'':{width + 4}s}", end="")
    print("".join(f"{k + 1:4d}" for k in range(len(answers))))
    for truth in truths:
        cells = "".join(f"{counts.get((truth, a), 0) or '.':>4}" for a in answers)
        print(f"{truth:>{width}s} {answers.index(truth) + 1:3d}{cells}")
    for a in answers[len(truths) :]:
        print(f"{'column':>{width}s} {answers.index(a) + 1:3d}  {a}")
    beside = in_company(rows)
    print("\nhidden with others: named at its joint")
    for name, share in beside.items():
        print(f"{name:>{width}s}  {share}")
    found = figures(rows)
    print()
    for f in found:
        print(f)
    result = {
        "schema": "exam/1",
        "seed": exam.seed,
        "figures": [dataclasses.asdict(f) for f in found],
        "confusion": [{"truth": t, "answer": a, "count": n} for (t, a), n in sorted(counts.items())],
        "in_company": {name: dataclasses.asdict(share) for name, share in beside.items()},
        "rows": [dataclasses.asdict(r) | {"exact": r.exact} for r in rows],
    }
    path = exam.out / f"seed{exam.seed}.json"
    path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"\n{path}")


def effects_text(keys: list[tuple[str, str | None]]) -> str:
    """Effects on one line."""
    return ", ".join(f"{name} at {joint}" if joint else name for name, joint in keys) or "-"
