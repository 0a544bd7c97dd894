"""The promises of a command of `calib`: help with an example, an entry in the list, and refusals as sentences."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout

from calib.main import COMMANDS, main
from calib.testing.promise import Promise, Promises


def check_command(name: str, arguments: list[str] | None = None) -> tuple[Promise, ...]:
    """Check every promise of a command (`arm new` for a subcommand). arguments: with these and --json it must print one document."""
    out, words = Promises(), name.split()
    code, text, _ = _run([*words, "--help"])
    out.keep("it is in the list of commands", lambda: words[0] in COMMANDS or f"COMMANDS has no {words[0]!r}")
    out.keep("--help ends with 0", lambda: code == 0 or f"exit code {code}")
    out.keep(
        "its help has an example that begins with the command",
        lambda: f"    calib {name}" in text or "no `calib` line under Example",
    )
    out.keep(
        "every number that it takes has bounds, so that nonsense is refused before anything begins",
        lambda: (
            not (set(text.split()) & {"<int>", "<float>"}) or "an option of --help shows <int> or <float> instead of a range"
        ),
    )
    out.keep("-h is the same", lambda: _run([*words, "-h"])[1] == text)

    def refused() -> str:
        code, printed, complaint = _run([*words, "--no-such-option"])
        if code != 2 or printed or "Traceback" in complaint:
            return f"exit code {code}, {printed!r}"
        return "" if "no option --no-such-option" in " ".join(complaint.split()) else complaint

    out.keep("an unknown option is refused with 2, in a sentence on standard error", refused)
    if arguments is not None:
        out.keep("--json prints one JSON document", lambda: _json([*words, *arguments, "--json"]))
    return tuple(out.found)


def _run(arguments: list[str]) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(arguments)
    return code, out.getvalue(), err.getvalue()


def _json(arguments: list[str]) -> str:
    code, text, complaint = _run(arguments)
    if code not in (0, 1):
        return f"exit code {code}: {complaint}"
    json.loads(text)
    return ""
