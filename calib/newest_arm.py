"""`latest` as an arm on the command line."""

from __future__ import annotations

import contextlib
from pathlib import Path

from calib import guided, guided_session
from calib.claims.of_diagnosis import is_corrected
from calib.guided_answer import answer
from calib.past_runs import LATEST, RUNS, Run, list_runs
from calib.terminal import console
from sim.errors import ConfigError


def named(arm: str) -> str:
    """`arm`, or the folder of `latest`; it is printed, because the operator may expect a different arm."""
    if arm != LATEST or Path(arm).exists():
        return arm
    folder = latest_arm()
    console.warn(f"{LATEST} is {folder}")
    return str(folder)


def latest_arm() -> Path:
    """The newest arm folder of identify, polish, a diagnose that corrected its arm, or a complete guided session; ConfigError without one."""
    found = next((arm for arm in map(_arm_of, list_runs()) if arm is not None and arm.is_dir()), None)
    if found is None:
        raise ConfigError(
            f"{LATEST}: {RUNS}/ has no arm of calib identify, calib polish, a complete calib go, or a calib diagnose that corrected its arm; name an arm folder"
        )
    return found


def _arm_of(run: Run) -> Path | None:
    if run.verb in ("identify", "polish"):
        return run.folder / "arm"
    with contextlib.suppress(ConfigError):  # a run that cannot be read has no arm
        if run.verb == "diagnose":
            return run.folder / "arm" if is_corrected(answer(run.folder)) else None
        if run.verb == "go":
            session = guided_session.read_session(run.folder)
            return guided.best_arm(session) if session.closed else None
    return None
