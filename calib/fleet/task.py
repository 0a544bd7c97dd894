"""The task of a worker: one arm, from its recordings' addresses to its answer. The same arm gives the same answer on any worker."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from calib.claims.of_diagnosis import claims, disagrees
from calib.diagnosis.answer import Diagnosis
from calib.diagnosis.whole import Whole, diagnose_pieces
from calib.fleet.job import Answer, ArmStatus, Job, base_row, refusal
from calib.fleet.opened import Copies, Opened, opened_of, pieces_of
from calib.fleet.parcel import packed
from calib.fleet.since import History, histories
from calib.gate.commands import by_import
from calib.identification.calibrated import write_calibrated
from calib.identification.gaps import mean_of_known
from calib.identification.identify import Identification, identify
from calib.regression.stored import Kept
from calib.terminal.console import plain
from calib.validation.validate import Validation, validate
from logs import Log
from sim.errors import AnswerIsNo, BadLog, CalibError, ConfigError
from sim.version import program_version

ANSWERS: tuple[tuple[type[CalibError], ArmStatus], ...] = (
    (BadLog, ArmStatus.BAD_LOGS),
    (ConfigError, ArmStatus.CONFIGURATION),
    (AnswerIsNo, ArmStatus.CONFIGURATION),  # no physically consistent arm is near the estimates
)


def work_packed(job: Job) -> bytes:
    """`work`, as bytes for transfer."""
    return packed(work(job))


def work(job: Job) -> Answer:
    """The answer about one arm; an arm that cannot be assessed yields a row with the reason, not an exception."""
    begin = time.process_time()
    bad: list[str] = []
    if program_version() != job.program:
        reason = f"the worker runs arm-calib {program_version()}, the command {job.program}; install the same on both"
        return refusal(job, ArmStatus.OTHER_PROGRAM, reason)
    with tempfile.TemporaryDirectory(prefix="calib-fleet-") as scratch:
        copies = Copies(Path(scratch))
        try:
            opened = opened_of(job, copies)
            bad = opened.bad
            return _answer(job, opened, copies, begin)
        except CalibError as error:
            status = next((s for kind, s in ANSWERS if isinstance(error, kind)), ArmStatus.FAILED)
            return refusal(job, status, by_import(copies.sentence(error), job.arm.name), tuple(bad))
        except Exception as error:  # one arm's defect must not cost the other arms their results
            return refusal(job, ArmStatus.FAILED, f"{type(error).__name__}: {copies.sentence(error)}", tuple(bad))


def _answer(job: Job, opened: Opened, copies: Copies, begin: float) -> Answer:
    arm, out = job.arm, copies.folder / "out"
    out.mkdir()
    kept = Kept(Path(job.kept)) if job.kept else None
    # however long the session, at most two pieces are held out
    held = list(opened.apart)[:2]
    found = identify(arm, opened.fitted, held, kept=kept)
    calibrated = write_calibrated(out / "arm", arm, found.arm)
    found.known.write(out / "arm", found.model)
    found.result.write(out / "result.json")
    checked = validate(calibrated, held or [opened.fitted[len(opened.fitted) - 1]])
    (out / "validation.json").write_text(json.dumps(checked.as_dict(), indent=1) + "\n", encoding="utf-8")
    named: Diagnosis | None = None
    whole, trouble = Whole(0.0, 0.0), ""
    if job.diagnose:
        try:
            named, whole = diagnose_pieces(arm, opened.fitted, held, kept)
            (out / "diagnosis").mkdir()
            named.write(out / "diagnosis", arm)
        except CalibError as error:
            trouble = copies.sentence(error)
    past = _histories(job, opened, named, copies) if named else []
    row = base_row(job) | _identified(found, opened) | _validated(checked, bool(held)) | _diagnosed(named, whole, past, trouble)
    row |= {"status": ArmStatus.DONE.name.lower(), "sentence": found.result.outcome, "bad_logs": opened.bad}
    row["cpu_seconds"] = time.process_time() - begin
    files = {str(f.relative_to(out)): f.read_bytes() for f in sorted(out.rglob("*")) if f.is_file()}
    return Answer(job.arm_id, ArmStatus.DONE, row, files, found.model.names, found.solution.theta, found.solution.covariance)


def _histories(job: Job, opened: Opened, named: Diagnosis, copies: Copies) -> list[History]:
    """Histories of the named effects over the longest piece of each older recording, oldest first, and of the newest session."""

    def longest() -> Iterator[tuple[str, Log]]:
        for k, recording in enumerate(opened.older):
            try:
                pieces = pieces_of(job, recording, copies, f"older-{k}")
                yield recording.started, pieces[int(np.argmax(pieces.seconds))]
            except CalibError as error:
                opened.bad.append(copies.sentence(error))
            shutil.rmtree(copies.folder / f"older-{k}")
        newest = [r.started for r in job.recordings if r not in opened.older and r.started]
        yield min(newest, default=""), opened.fitted[int(np.argmax(opened.fitted.seconds))]

    return histories(job.arm, named.accepted, longest())


def _identified(found: Identification, opened: Opened) -> dict[str, Any]:
    result, solution = found.result, found.solution
    gap = result.holdout or result.training
    return {
        "joints": list(result.joint_names),
        "seconds": float(sum(opened.fitted.seconds)),
        "rows": result.training.rows.tolist(),
        "condition": result.condition,
        "regularised": bool(solution.regularised),
        "residual_before": plain(gap.before),
        "residual_after": plain(gap.after),
        "residual_signal": plain(gap.signal),
        "parameters": list(found.model.names),
        "units": list(found.model.units),
        "values": solution.theta.tolist(),
        "std": np.sqrt(np.diag(solution.covariance)).tolist(),
    }


def _validated(checked: Validation, apart: bool) -> dict[str, Any]:
    left = [c.sliding / np.where(c.signal > 0, c.signal, np.nan) for c in checked.checks]
    return {
        "validated_on": "held-out" if apart else "training",
        "validation": checked.outcome,
        "left_of_torque": plain(mean_of_known(left)),
    }


def _diagnosed(named: Diagnosis | None, whole: Whole, past: Sequence[History], trouble: str) -> dict[str, Any]:
    if named is None:
        return {"verdict": "not_diagnosed", "diagnosis_trouble": trouble, "effects": [], "unexplained": []}
    when = {(h.effect, h.joint): h for h in past}
    effects = []
    for e in named.answer["effects"]:
        history = when.get((e["effect"], e["joint"]))
        effects.append(
            {
                **{key: e[key] for key in ("effect", "joint", "confidence", "gap_share")},
                "parameters": [
                    {"name": k, "identifiable": p.get("identifiable", True)} | {x: p[x] for x in ("value", "std", "unit")}
                    for k, p in e["parameters"].items()
                ],
                "since": history.since if history else "",
                "began": bool(history and history.began),
            }
        )
    return {
        "verdict": named.answer["verdict"],
        "disagrees": disagrees(named.answer),
        "diagnosis_trouble": trouble,
        "searched_seconds": whole.searched,
        "weighed_seconds": whole.weighed,
        "elsewhere": "" if whole.elsewhere is None else " ".join(filter(None, whole.elsewhere[0])),
        "refit": "; ".join(c.sentence for c in claims(named.answer) if c.name == "refit"),
        "effects": effects,
        "unexplained": [u["joint"] for u in named.answer["unexplained"]],
    }
