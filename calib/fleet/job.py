"""The request about one arm, and the answer: all that a worker needs and all that it returns."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from calib.fleet.inventory import Recorded
from sim.arm import Arm
from sim.version import program_version

SCHEMA = "fleet/1"


class ArmStatus(Enum):
    """How far the work on an arm got; the value is the sentence shown to people."""

    DONE = "identified, validated and diagnosed"
    BAD_LOGS = "its recordings cannot be used"
    CONFIGURATION = "its model and its recordings do not fit together"
    WORKER_LOST = "the workers that tried it died; the next call tries it again"
    OTHER_PROGRAM = "its worker runs another version of the program"
    FAILED = "the program failed; this is a defect of the program"

    @property
    def settled(self) -> bool:
        """Whether the same recordings would give the same answer again."""
        return self in (ArmStatus.DONE, ArmStatus.BAD_LOGS, ArmStatus.CONFIGURATION)


@dataclass(frozen=True)
class Job:
    """One arm: its model, its recordings (oldest first) and where finished portions of the work are kept ("": nowhere).

    `program` is the version that sent the request: a worker that runs another one refuses, because its numbers would not be comparable.
    A session is all recordings from `session_days` before the newest on; it shows the arm as it is now, the older ones since when.
    """

    arm_id: str
    arm: Arm
    recordings: tuple[Recorded, ...]
    kept: str = ""
    session_days: float = 1.0
    accept_partial: bool = False
    diagnose: bool = True
    program: str = field(default_factory=program_version)

    @property
    def digest(self) -> str:
        """Changes with anything that could change the answer."""
        options = [self.session_days, self.accept_partial, self.diagnose]
        words = [self.arm.sha256, self.program, options, [asdict(r) for r in self.recordings]]
        return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Answer:
    """One arm's row, the files of its folder (relative path -> content), and its parameters for the comparison with its siblings.

    names, theta (p,), covariance (p, p) of the model's columns; empty where nothing was identified.
    """

    arm_id: str
    status: ArmStatus
    row: dict[str, Any]
    files: dict[str, bytes] = field(default_factory=dict)
    names: tuple[str, ...] = ()
    theta: np.ndarray = field(default_factory=lambda: np.zeros(0))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))


def refusal(job: Job, status: ArmStatus, sentence: str, bad_logs: tuple[str, ...] = ()) -> Answer:
    """The answer for an arm that could not be assessed."""
    return Answer(
        job.arm_id, status, base_row(job) | {"status": status.name.lower(), "sentence": sentence, "bad_logs": list(bad_logs)}
    )


def base_row(job: Job) -> dict[str, Any]:
    """What is known of an arm before any log is opened."""
    return {
        "arm": job.arm_id,
        "model": job.arm.name,
        "model_sha256": job.arm.sha256,
        "cell": job.recordings[-1].cell,
        "serial": job.recordings[-1].serial,
        "first_recording": job.recordings[0].started,
        "last_recording": job.recordings[-1].started,
        "logs": [r.address for r in job.recordings],
        "digest": job.digest,
    }
