"""session.html: one page for a guided session, rewritten after every step."""

from __future__ import annotations

import shlex
from pathlib import Path

from markupsafe import Markup

from calib import guided
from calib.claims import capital
from calib.guided_answer import answer
from calib.guided_session import GuidedSession
from calib.report import diagnosis, explorer
from calib.report.page import Page, Verdict

FILE = "session.html"
PAGES = ("plan.html", "report.html")


def write(session: GuidedSession) -> Path:
    """Write the page of a session into its folder; returns its path."""
    # a complete session shows what its diagnosis found; an open one its last step
    diagnoses = [d for d in session.commands if d.name.startswith("diagnose")] if session.closed else []
    last = next(reversed(diagnoses or session.commands), None)
    sentence = f"{last.sentence[:1].upper()}{last.sentence[1:]}" if last else "Nothing was done yet"
    verdict = _style(session) if session.closed else "open"
    facts = [
        ("cell", Path(session.cell).stem),
        ("state", "complete" if session.closed else "open"),
        ("time, questions included", f"{sum(d.seconds for d in session.commands) / 60:.1f} min"),
    ]
    page = Page(session.arm, sentence, verdict, facts, "session")
    page.aside("What to do next", _next(session))
    looked = [d for d in session.commands if d.name.startswith(("diagnose", "validate")) and d.folder]
    if looked:
        shown = next((d for d in reversed(looked) if d.name.startswith("diagnose")), looked[-1])
        explorer.copied(
            page.section(f"The residual on held-out motions, from {shown.name}"), session.folder / shown.folder / "report.html"
        )
    page.section("Steps").table(
        ["step", "result", "exit code", "time, questions included [s]"],
        [[d.name, capital(d.sentence), d.exit_code, d.seconds] for d in session.commands],
    )
    links = [
        Markup('<li><a href="{0}">{1}</a></li>').format(f"{d.folder}/{name}", f"{d.name}: {name}")
        for d in session.commands
        for name in PAGES
        if d.folder and (session.folder / d.folder / name).is_file()
    ]
    if links:
        page.section("Pages of the steps").embed(Markup("<ul>{}</ul>").format(Markup("").join(links)))
    page.section("Do it again").items(_again(session))
    return page.write(session.folder / FILE)


def _again(session: GuidedSession) -> list[str]:
    """The command of each step that succeeded, without --out: that folder is already a run, and runs are never overwritten."""
    lines = []
    for done in session.done:
        if session.finished(done.name) is done:
            words = list(done.arguments)
            if "--out" in words:
                del words[words.index("--out") : words.index("--out") + 2]
            lines.append(f"calib {shlex.join(words)}")
    return lines


def _style(session: GuidedSession) -> Verdict:
    """The mark of the last diagnosis."""
    try:
        return diagnosis.style(answer(guided.last_diagnosis(session)))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):  # an edited file
        return "open"


def _next(session: GuidedSession) -> list[str]:
    """What remains to do, as `calib go` prints it at its end; for an open session, how to continue it."""
    if not session.closed:
        return [f"Continue it: calib go {session.cell}"]
    return [
        *(f"{capital(s)}." for s in guided.ending(session)[1:]),
        f"Use it elsewhere: calib export {guided.best_arm(session)}",
    ]
