"""Damage in a file: refused with its place and remedy or, where the operator accepts a partial file, counted and reported."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from sim.errors import BadLog

MAX_FINDINGS = 20


@dataclass
class Damage:
    """The one place where a reader decides between refusing a file and reading on without its damaged part."""

    path: Path
    accept_partial: bool = False
    findings: list[str] = field(default_factory=list)
    count: int = 0

    def refuse(self, where: str, fault: str, remedy: str) -> BadLog:
        """The error for a file that cannot be read at all; the caller raises it."""
        return BadLog(f"{self.path}: {where}: {fault}; {remedy}")

    def report(self, where: str, fault: str) -> None:
        """Raise BadLog, or note the damage and return, so that the caller leaves the damaged part out."""
        if not self.accept_partial:
            raise BadLog(
                f"{self.path}: {where}: {fault}; record it again, or read what survives with --accept-partial "
                "(`calib import` says what that is)"
            )
        self.count += 1
        if self.count <= MAX_FINDINGS:
            self.findings.append(f"left out, {where}: {fault}")

    def note(self, sentence: str) -> None:
        """Keep a sentence about something that is not damage."""
        self.findings.append(sentence)

    def all_findings(self) -> tuple[str, ...]:
        """All sentences, and the number of damaged places for which none was kept."""
        more = self.count - MAX_FINDINGS
        return (*self.findings, *((f"left out: {more} more damaged places",) if more > 0 else ()))
