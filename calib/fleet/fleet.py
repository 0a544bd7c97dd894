"""A folder of recordings in, a row and a folder for every arm out; earlier results that are still valid are not computed again."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calib.fleet.engine import cluster, results
from calib.fleet.inventory import Recorded, by_arm
from calib.fleet.job import Answer, ArmStatus, Job, refusal
from calib.fleet.parcel import unpacked
from calib.fleet.shrinkage import ShrinkageEstimate, packed_estimate
from calib.fleet.siblings import OUTLIER, Siblings, compare
from calib.fleet.table import require_row, write_table
from calib.fleet.task import work_packed
from calib.terminal.console import plain
from sim.arm import Arm, load_arm
from sim.errors import CalibError, UnknownArm
from sim.files import printable

ANSWER, ESTIMATE, PORTIONS, ARMS = "answer.json", "estimate.npz", "portions", "arms"
BORROWED = 0.5  # share of the knowledge of some parameter above which the siblings change what the arm's folder would hold


@dataclass(frozen=True)
class Settings:
    """How a fleet is processed; see `Job`. workers: processes on this computer, one per processor if None, this
    process if 0."""

    scheduler: str | None = None
    workers: int | None = None
    session_days: float = 1.0
    accept_partial: bool = False
    diagnose: bool = True


@dataclass(frozen=True)
class Progress:
    """Progress of the work: the address of Dask's page once it is known, then every arm with its status."""

    total: int
    dashboard: str = ""
    arm_id: str = ""
    status: ArmStatus | None = None


@dataclass(frozen=True)
class Fleet:
    """Rows in the order of the arms' names; recordings whose arm is unknown, with the reason; arms processed in this call."""

    rows: list[dict[str, Any]]
    unassigned: list[tuple[str, str]]
    done: tuple[str, ...]


def run_fleet(
    found: tuple[list[Recorded], list[tuple[str, str]]],
    out: Path,
    settings: Settings,
    progress: Callable[[Progress], None] = lambda p: None,
    configs: Path | None = None,
) -> Fleet:
    """Process every arm of an `inventory` into out/arms/<arm>/ and out/fleet.parquet; an arm whose recordings, model and program are those
    of an answer in `out` keeps that answer.
    """
    recordings, unassigned = found
    answers: dict[str, Answer] = {}
    arms: dict[str, Arm] = {}
    jobs: dict[str, Job] = {}
    for arm_id, own in by_arm(recordings).items():
        try:
            arms[arm_id] = load_arm(own[-1].arm, configs)
        except UnknownArm:
            where = "./configs" if configs is None else printable(configs)
            sentence = f"there is no arm {own[-1].arm!r} in {where}/arms; copy its folder there, or name the folder above arms/ with --configs DIR"
            answers[arm_id] = _unknown(arm_id, own, sentence)
            continue
        except CalibError as error:
            answers[arm_id] = _unknown(arm_id, own, str(error))
            continue
        kept = str((out / PORTIONS / arm_id).resolve())
        jobs[arm_id] = Job(arm_id, arms[arm_id], own, kept, settings.session_days, settings.accept_partial, settings.diagnose)
        known = stored(out / ARMS / arm_id, jobs[arm_id])
        if known is not None:
            answers[arm_id] = known
    missing = [(arm_id, job) for arm_id, job in jobs.items() if arm_id not in answers]
    progress(Progress(len(missing)))
    if missing:
        with cluster(settings.scheduler, settings.workers) as client:
            if client is not None:
                progress(Progress(len(missing), dashboard=client.dashboard_link))
            for arm_id, data, why in results(client, work_packed, missing):
                answers[arm_id] = _received(jobs[arm_id], data, why)
                store(out / ARMS / arm_id, answers[arm_id])
                shutil.rmtree(out / PORTIONS / arm_id, ignore_errors=True)
                progress(Progress(len(missing), arm_id=arm_id, status=answers[arm_id].status))
            rows, with_siblings = _compared(answers, arms)
            changed = {answers[arm_id].row.get("model_sha256") for arm_id, _ in missing}
            helped = [(arm_id, item) for arm_id, item in with_siblings if item.arm.sha256 in changed]
            for arm_id, data, why in results(client, packed_estimate, helped):
                files: dict[str, bytes] = {}
                try:
                    files = unpacked(data, arm_id).files if data is not None else {}
                except CalibError as error:
                    why = str(error)
                rows[arm_id]["notes"] = (
                    [] if files else [f"no arm folder with the siblings' help: {why or 'no such arm can exist'}"]
                )
                _write(out / ARMS / arm_id, files)
    else:
        rows, _ = _compared(answers, arms)
    ordered = [
        rows[arm_id] | {"notes": [*rows[arm_id].get("notes", ()), *_notes(arms.get(arm_id), jobs.get(arm_id))]}
        for arm_id in sorted(rows)
    ]
    write_table(out / "fleet.parquet", ordered)
    return Fleet(ordered, unassigned, tuple(arm_id for arm_id, _ in missing))


def _received(job: Job, data: object, why: str) -> Answer:
    """A worker's answer; where there is none, or it cannot be read, a row that states this."""
    if data is None:
        return refusal(job, ArmStatus.WORKER_LOST, why)
    try:
        return unpacked(data, job.arm_id)
    except CalibError as error:
        return refusal(job, ArmStatus.FAILED, str(error))


def stored(folder: Path, job: Job) -> Answer | None:
    """The answer that `folder` holds, if it is for exactly this job and would be the same now; else None."""
    try:
        row = json.loads((folder / ANSWER).read_text(encoding="utf-8"))
        status = ArmStatus[row["status"].upper()]
        require_row(row)
        if row["digest"] != job.digest or not status.settled:
            return None
        if status is not ArmStatus.DONE:
            return Answer(job.arm_id, status, row)
        with np.load(folder / ESTIMATE, allow_pickle=False) as file:
            return Answer(job.arm_id, status, row, {}, tuple(row["parameters"]), file["theta"], file["covariance"])
    except Exception:  # whatever is wrong with the stored answer, the arm is processed again
        return None


def store(folder: Path, answer: Answer) -> None:
    """Write the arm's folder, whole or not at all; it replaces an earlier one."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        for name, content in answer.files.items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / name).write_bytes(content)
        np.savez(draft / ESTIMATE, theta=answer.theta, covariance=answer.covariance)
        (draft / ANSWER).write_text(json.dumps(plain(answer.row), indent=1) + "\n", encoding="utf-8")
        os.chmod(draft, 0o755)
        if folder.exists():
            shutil.rmtree(folder)
        draft.rename(folder)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _unknown(arm_id: str, own: Sequence[Recorded], sentence: str) -> Answer:
    row = {
        "arm": arm_id, "model": own[-1].arm, "cell": own[-1].cell, "serial": own[-1].serial, "first_recording": own[0].started,
        "last_recording": own[-1].started, "logs": [r.address for r in own], "status": ArmStatus.CONFIGURATION.name.lower(),
        "sentence": sentence, "bad_logs": [],
    }  # fmt: skip
    return Answer(arm_id, ArmStatus.CONFIGURATION, row)


def _notes(arm: Arm | None, job: Job | None) -> list[str]:
    if arm is None or job is None:
        return []
    others = [r for r in job.recordings if r.arm_sha256 and r.arm_sha256 != arm.sha256]
    return [f"{len(others)} of its recordings were made with another version of the folder of {arm.name}"] if others else []


def _compared(
    answers: dict[str, Answer], arms: dict[str, Arm]
) -> tuple[dict[str, dict[str, Any]], list[tuple[str, ShrinkageEstimate]]]:
    """The rows, each compared with the arms of its model, and the arms that borrow so much that they get a second folder."""
    rows = {arm_id: dict(answer.row) for arm_id, answer in answers.items()}
    with_siblings: list[tuple[str, ShrinkageEstimate]] = []
    families: dict[str, list[Answer]] = {}
    for answer in answers.values():
        if answer.status is ArmStatus.DONE:
            families.setdefault(arms[answer.arm_id].sha256, []).append(answer)
    for family in families.values():
        family.sort(key=lambda a: a.arm_id)
        try:
            together = compare(np.array([a.theta for a in family]), [a.covariance for a in family])
        except (
            ValueError,
            np.linalg.LinAlgError,
        ) as error:  # numbers that cannot be compared must not cost the arms their own results
            together = None
            for answer in family:
                rows[answer.arm_id]["notes"] = [f"not compared with its siblings: {error}"]
        for k, answer in enumerate(family):
            rows[answer.arm_id]["siblings"] = len(family) - 1
            if together is None:
                continue
            rows[answer.arm_id] |= _beside(together, k, answer.names)
            if together.borrowed[k].max() > BORROWED:
                item = ShrinkageEstimate(
                    answer.arm_id, arms[answer.arm_id], together.shrunk[k], together.covariance[k], len(family) - 1
                )
                with_siblings.append((answer.arm_id, item))
    return rows, with_siblings


def _beside(together: Siblings, k: int, names: Sequence[str]) -> dict[str, Any]:
    worst = int(np.argmax(np.abs(together.score[k])))
    return {
        "shrunk": together.shrunk[k].tolist(),
        "shrunk_std": together.std[k].tolist(),
        "score": together.score[k].tolist(),
        "outlier_parameter": names[worst],
        "outlier_score": float(together.score[k][worst]),
        "borrowed": float(together.borrowed[k].mean()),
    }


def _write(folder: Path, files: dict[str, bytes]) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def deviates(row: Mapping[str, Any]) -> bool:
    """Whether an arm has an effect missing from its model, structure without a name, a model that disagrees, or numbers unlike its siblings'."""
    return (
        bool(row.get("effects") or row.get("elsewhere") or row.get("disagrees"))
        or row.get("verdict") == "unexplained"
        or abs(row.get("outlier_score") or 0.0) > OUTLIER
    )
