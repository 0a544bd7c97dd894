"""A plan from the first check to the last log: `execute` is the one call that runs it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from drivers.driver import Driver
from drivers.preflight import preflight
from logs.about import about_recording
from logs.recorder import Recorder
from logs.recorder_process import RecorderProcess
from logs.recording import COMPLETED, Recording
from safety.approval import Approval, approval_of, check_approval
from safety.audit import record, verify
from safety.clear import Proof
from safety.collision import Clearance
from safety.guard import Guard
from safety.latency import latency_of
from safety.legs import Leg, Route
from safety.manifest import Manifest, device_facts, digest_of, require_same
from safety.monitor import compile_cycle
from safety.monitor_link import MonitorLink, seen
from safety.plan import Plan, check_plan
from safety.plausible import check_plausible
from safety.realtime import unhurried
from safety.run_progress import ProgressOfRun, RunProgress
from safety.stages import STAGES, StageResult, gate, stages_due
from safety.stop_sources import StopSignals, first_reason
from safety.trip import MotionStopped
from safety.window import Window
from sim.arm import Arm
from sim.cell import Cell
from sim.clock import SimulatedClock
from sim.errors import CalibError, SafetyStop

NEVER: Callable[[], str | None] = lambda: None  # noqa: E731
PAUSE = 0.3
SIMULATED = "time is simulated in this cell"


@dataclass(frozen=True)
class RunResult:
    """Result of a run: the log of each motion at full speed, and how closely the arm followed."""

    folder: Path
    logs: dict[str, Path]
    stages: tuple[StageResult, ...]
    latency: float
    approved_by: str
    verdicts: dict[str, Proof] = field(default_factory=dict)


def execute(
    plan: Plan,
    cell: Cell,
    arm: Arm,
    driver_factory: Callable[[Cell, Arm], Driver],
    folder: Path,
    *,
    audit: Path,
    stages: Sequence[float] | None = None,
    operator: str = "",
    stop_requested: Callable[[], str | None] = NEVER,
    watch: Callable[[RunProgress], None] = lambda progress: None,
    now: Callable[[], datetime] = lambda: datetime.now(UTC),
    link: MonitorLink | None = None,
    alone: str = SIMULATED,
) -> RunResult:
    """Drive every motion of an approved plan and record it into `folder`/<name>.mcap.

    stages: speeds to drive at, by default those that are due; none of these may be skipped. stop_requested: called every cycle;
    a reason ends the run in a bounded stop. SafetyStop if anything is not as approved, MotionStopped if something goes wrong on
    the way; the recordings are then closed as aborted. link: the monitor process; alone: why there is none.
    """
    check_plan(plan, arm, cell)
    approval = approval_of(plan)
    if approval is None:
        raise SafetyStop(
            f"{plan.folder}: nobody has approved this plan; look at it, then approve it with `calib record CELL PLAN`"
        )
    check_approval(approval, plan, arm, cell, now())
    check_plausible(arm, cell)
    due = stages_due(plan, arm, cell, audit)
    speeds = tuple(due if stages is None else stages)
    if not (speeds and set(due) <= set(speeds) <= set(STAGES) and speeds == tuple(sorted(set(speeds)))):
        raise SafetyStop(f"stages {list(speeds)}: this plan must pass {list(due)} here, each once, slowest first")
    facts = {"plan": plan.sha256, "manifest": digest_of(approval.manifest), "arm": arm.name, "cell": cell.name}
    by = operator or approval.approved_by
    record(
        audit,
        "run begins",
        now(),
        **facts,
        operator=by,
        approved_by=approval.approved_by,
        folder=str(folder),
        stages=list(speeds),
    )
    compile_cycle()  # takes seconds, once per computer: not with an arm connected
    try:
        with StopSignals() as signals, driver_factory(cell, arm) as driver:
            _same_device(audit, device_facts(driver.info), approval, plan, now())
            run = _Run(plan, cell, arm, driver, folder, by, first_reason(signals.reason, stop_requested), watch, link, alone)
            result = run.drive(speeds, approval.approved_by)
    except BaseException as error:
        stopped = error.record() if isinstance(error, MotionStopped) else {}
        try:
            record(audit, "run stopped", now(), **facts, reason=str(error) or type(error).__name__, stop=stopped)
        except CalibError as second:
            error.add_note(str(second))
        raise
    record(audit, "run completed", now(), **facts, logs=[str(p) for p in result.logs.values()], monitor=run.monitored)
    if speeds == STAGES:
        record(
            audit,
            "stages passed",
            now(),
            plan=plan.sha256,
            manifest=facts["manifest"],
            stages=[asdict(s) for s in result.stages],
        )
    return result


def _same_device(audit: Path, device: Manifest, approval: Approval, plan: Plan, now: datetime) -> None:
    """An approval is for the first device that it is used with; from then on, SafetyStop names what differs."""
    since = approval.approved_at.isoformat()
    for entry in verify(audit):
        facts = entry["facts"]
        if entry["event"] == "device" and (facts.get("plan"), facts.get("approved_at")) == (plan.sha256, since):
            require_same(facts.get("device", {}), device, f"{plan.folder}: this approval was first used with")
            return
    record(audit, "device", now, plan=plan.sha256, approved_at=since, device=device)


class _Run:
    """One run of one plan on one connected driver."""

    def __init__(
        self, plan: Plan, cell: Cell, arm: Arm, driver: Driver, folder: Path, operator: str,
        stop_requested: Callable[[], str | None], watch: Callable[[RunProgress], None],
        link: MonitorLink | None, alone: str,
    ) -> None:  # fmt: skip
        self.link, self.alone, self.monitored = link, alone, list[dict[str, float]]()
        self.plan, self.cell, self.arm, self.driver, self.folder = plan, cell, arm, driver, folder
        self.operator, self.stop_requested, self.watch = operator, stop_requested, watch
        self.simulated = isinstance(driver.clock, SimulatedClock)
        self.clearance = Clearance(arm, cell)
        self.latency = latency_of(cell, driver)
        self.route = Route(plan, cell, arm, driver, self.clearance, self.latency)
        self.progress = ProgressOfRun(watch, driver.rate)

    def drive(self, speeds: Sequence[float], approved_by: str) -> RunResult:
        """Preflight, clear everything, then run stage after stage; at the end back to where the cell wants the arm."""
        failed = [f"{c.name}: {c.detail} ({c.remedy})" for c in preflight(self.driver, self.cell) if c.ok is False]
        if failed:
            raise SafetyStop(f"{self.cell.name} is not ready: {'; '.join(failed)}")
        with unhurried():
            legs = self.route.legs(self.driver.read().q, speeds, self.watch)
        logs: dict[str, Path] = {}
        results: list[StageResult] = []
        self.progress.left = sum(len(leg.cleared) / self.driver.rate + PAUSE for speed in speeds for leg in legs[speed])
        for i, speed in enumerate(speeds):
            self.progress.stage = (i + 1, len(speeds), speed)
            result, paths = self._stage(legs[speed], speed)
            results.append(result)
            if speed == STAGES[-1]:
                logs = paths
            if i + 1 < len(speeds):
                room = min(float(leg.cleared.room.min()) for leg in legs[speeds[i + 1]])
                gate(result, speeds[i + 1], self.arm, self.cell, room)
        return RunResult(self.folder, logs, tuple(results), self.latency, approved_by, self.route.verdicts)

    def _stage(self, legs: Sequence[Leg], speed: float) -> tuple[StageResult, dict[str, Path]]:
        """Run all legs at one speed. Logs are opened before and closed after the drive, so that neither delays the loop."""
        place = self.folder if speed == STAGES[-1] else self.folder / f"rehearsal-{round(100 * speed)}"
        place.mkdir(parents=True, exist_ok=True)
        paths = {leg.name: place / f"{leg.name}.mcap" for leg in legs if leg.name}
        done: set[str] = set()
        logs: dict[str, Recording] = {}
        try:
            for name, path in paths.items():
                logs[name] = self._recording(path, name, speed)
            with self._guarded(legs) as guard:
                for number, leg in enumerate(legs):
                    self.progress.what = leg.what
                    if self.link is not None:
                        self.link.leg = number
                    self.progress.left -= len(leg.cleared) / self.driver.rate + PAUSE
                    guard.run(leg.cleared, leg.what, Window(logs[leg.name], leg.first, leg.last) if leg.name else None)
                    guard.hold(PAUSE, f"after {leg.what}")
                    done |= {leg.name} if leg.name else set()
        except BaseException as error:
            for name, log in logs.items():
                try:
                    log.close(COMPLETED if name in done else str(error) or type(error).__name__)
                except CalibError as second:
                    error.add_note(str(second))
            raise
        with ExitStack() as closing:  # close each of them, whatever fails
            for log in logs.values():
                closing.callback(log.close)
            if self.link is not None:
                self.monitored.append(self.link.end())
        worst = guard.monitor.worst
        return StageResult(speed, *(tuple(worst[k].tolist()) for k in ("following error", "residual"))), paths

    def _guarded(self, legs: Sequence[Leg]) -> AbstractContextManager[Guard]:
        """The guard of a stage, watched by the monitor process if there is one."""
        given, link = (self.driver, self.arm, self.cell, self.clearance), self.link
        if link is None:
            return Guard(*given, self.stop_requested, self.progress.cycle, self.latency)
        self.watch(RunProgress("the monitor process loads the verified motions", 0.0, None))
        with unhurried():
            link.begin([leg.cleared for leg in legs], self.driver.rate, self.latency, self.folder)
        reason = first_reason(self.stop_requested, link.reason)
        return seen(link, lambda sent: Guard(*given, reason, self.progress.cycle, self.latency, sent))

    def _recording(self, path: Path, motion: str, speed: float) -> Recording:
        info, table = self.driver.info, self.cell.table
        metadata: dict[str, Any] = {
            "arm": self.arm.name, "arm_sha256": self.arm.sha256, "cell": self.cell.name, "cell_sha256": self.cell.sha256,
            "driver": table.driver, "device": info.model, "serial": info.serial, "firmware": info.firmware,
            "rate": self.driver.rate, "torque_source": info.torque_source,
            "payload": table.payload.model_dump() if table.payload else None,
            "device_payload_mass": info.payload_mass, "device_payload_com": info.payload_com, "mounting": info.gravity,
            "operator": self.operator, "plan": self.plan.sha256, "motion": motion, "speed": speed, **info.extra,
            "assumed": ", ".join(self.cell.assumed) or None,
            "monitor_process": "yes" if self.link is not None else f"no: {self.alone}",
        }  # fmt: skip
        kept = {key: value for key, value in metadata.items() if value is not None}
        kind = Recorder if self.simulated else RecorderProcess
        return kind(path, self.arm.joint_names, kept, about_recording(self.arm, self.cell, self.plan.folder))
