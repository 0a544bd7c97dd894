"""A page in one file: the result as a sentence, then pictures, then tables; it opens offline and makes no network requests.

All text from a log or a file name is escaped (Jinja2 autoescape). The content security policy is `default-src 'none'` with the SHA-256
of the page's own style and script, so that injected code would not run.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Self

import jinja2
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from calib.report.figure import svg
from calib.terminal.console import cell, plain
from sim.version import software_version

Verdict = Literal["good", "bad", "open", "found"]
# verdicts of identify and validate; any other is bad
_VERDICTS: dict[str, Verdict] = {"good": "good", "poor": "open"}
BADGES: dict[str, str] = {"good": "✓", "bad": "✕", "open": "?", "found": "!"}
_FOLDER = Path(__file__).resolve().parent
_TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(_FOLDER / "templates"), autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True,
    lstrip_blocks=True,
)  # fmt: skip


def mark_of(result: Mapping[str, Any]) -> Verdict:
    """The mark of an identification or a validation; never good if friction drives a joint."""
    driven = any(claim.get("claim") == "driving" for claim in result.get("claims", []))
    mark = _VERDICTS.get(str(result["verdict"]), "bad")
    return "found" if driven and mark == "good" else mark


@dataclass
class _Section:
    heading: str
    blocks: list[Markup] = field(default_factory=list)


class Page:
    """A page with its title, its result as a sentence, and sections that are filled from top to bottom.

    verdict: colours and marks the sentence: good, bad, open (not settled), found (a gap with a named cause), or None. facts: (label,
    value) pairs under it. Every method that adds something returns the page. Text is always escaped, never markup.
    """

    def __init__(
        self,
        title: str,
        sentence: str,
        verdict: Verdict | None = None,
        facts: Sequence[tuple[str, Any]] = (),
        subtitle: str = "",
    ) -> None:
        self.title, self.sentence, self.verdict, self.subtitle = title, sentence, verdict, subtitle
        self.facts = [(label, cell(value)) for label, value in facts]
        self._sections: list[_Section] = [_Section("")]
        self._scripts = [asset("page.js")]
        self._styles = [asset("page.css")]
        self._data: dict[str, str] = {}

    def section(self, heading: str, text: str = "") -> Self:
        """Begin a section, to which the following content is added."""
        self._sections.append(_Section(heading))
        return self.text(text) if text else self

    def text(self, paragraph: str) -> Self:
        """Add a paragraph."""
        return self._add(_marked(paragraph), "<p>{}</p>")

    def items(self, sentences: Iterable[str]) -> Self:
        """Add a list of sentences."""
        body = Markup("").join(Markup("<li>{}</li>").format(_marked(s)) for s in sentences)
        return self._add(body, "<ul>{}</ul>") if body else self

    def aside(self, heading: str, sentences: Sequence[str]) -> Self:
        """Add a highlighted panel, such as what to do with the result."""
        body = Markup("").join(Markup("<li>{}</li>").format(_marked(s)) for s in sentences)
        return self._add(Markup("<aside><h2>{}</h2><ul>{}</ul></aside>").format(heading, body))

    def figure(self, figure: Figure | Markup, caption: str) -> Self:
        """Add a matplotlib figure (see calib.report.figure.axes) or trusted SVG, with a caption."""
        drawing = svg(figure, caption) if isinstance(figure, Figure) else figure
        return self._add(Markup("<figure>{}<figcaption>{}</figcaption></figure>").format(drawing, caption))

    def table(self, headers: Sequence[str], rows: Iterable[Sequence[Any]], caption: str = "", fold: bool = False) -> Self:
        """Add a table that sorts on a click on its headers; numbers show four digits and sort by their full value. fold: initially closed."""
        body = [[(cell(v), _key(v), isinstance(v, int | float)) for v in row] for row in rows]
        for row in body:
            if len(row) != len(headers):
                raise ValueError(f"a row has {len(row)} cells under {len(headers)} headers: {[text for text, _, _ in row]}")
        html = template("table.html").render(headers=headers, rows=body, caption=caption, fold=fold)
        return self._add(Markup(html))

    def embed(self, html: Markup, script: str = "", style: str = "", data: dict[str, Any] | None = None) -> Self:
        """Add trusted markup with its own script, style and data (read by the script from `<script type="application/json" id=...>`)."""
        self._scripts += [script] if script else []
        self._styles += [style] if style else []
        for name, value in (data or {}).items():
            text = json.dumps(plain(value), allow_nan=False, separators=(",", ":"))
            self._data[name] = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
        return self._add(html)

    def html(self) -> str:
        """The whole page as text."""
        policy = "; ".join(
            [
                "default-src 'none'",
                "style-src " + " ".join(map(_hash, self._styles)),
                "script-src " + " ".join(map(_hash, self._scripts)),
                "img-src data:",
                "base-uri 'none'",
                "form-action 'none'",
            ]
        )
        return template("page.html").render(
            page=self, policy=policy, badge=BADGES.get(self.verdict or "", ""), version=software_version(),
            written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"), sections=self._sections,
            styles=[Markup(s) for s in self._styles], scripts=[Markup(s) for s in self._scripts],
            data={name: Markup(text) for name, text in self._data.items()},
        )  # fmt: skip

    def write(self, path: str | Path) -> Path:
        """Write the page; returns its path."""
        path = Path(path)
        path.write_text(self.html(), encoding="utf-8")
        return path

    def _add(self, block: Markup, form: str = "{}") -> Self:
        self._sections[-1].blocks.append(Markup(form).format(block))
        return self


def _marked(sentence: str) -> Markup:
    """Escaped text with `commands` set as code."""
    return Markup(re.sub("`([^`]+)`", r"<code>\1</code>", str(escape(sentence))))


def template(name: str) -> jinja2.Template:
    """A template of the pages; it escapes everything that is not Markup."""
    return _TEMPLATES.get_template(name)


def asset(name: str) -> str:
    """A script or style that is embedded unchanged in a page; ValueError if it would end its own element."""
    text = (_FOLDER / "assets" / name).read_text(encoding="utf-8")
    if "</" + "script" in text or "</" + "style" in text:
        raise ValueError(f"{name} would end its own element on the page")
    return text


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _key(value: Any) -> str:
    return repr(float(value)) if isinstance(value, int | float) and value == value else str(value if value is not None else "")
