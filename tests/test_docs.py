"""Commands in README and docs work, links lead somewhere, and what is derived from the catalogue is up to date."""

import json
import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from typer.main import get_command

from calib.main import COMMANDS, Commands, app
from calib.report import catalogue
from calib.terminal.options import arm_names, cell_names
from logs.prediction import MISSING, PREDICTED
from logs.schemas import SCHEMAS, STATES, TOPICS
from sim.effects import EFFECTS

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
# pages whose blocks build on one another, in reading order
STORY = ["README.md", "tutorial.md", "python.md", "add-an-arm.md"]
_BLOCK = re.compile(r"(?:<!-- (?P<note>[^>]*) -->\n)?```(?P<language>\w+)\n(?P<text>.*?)```", re.DOTALL)


@dataclass(frozen=True)
class Block:
    page: str
    language: str
    text: str
    note: str

    def __str__(self) -> str:
        return f"{self.page}: {self.text.splitlines()[0][:60]}"


def blocks() -> list[Block]:
    found = []
    for page in PAGES:
        parts = _BLOCK.finditer(page.read_text(encoding="utf-8"))
        found += [Block(page.name, part["language"], part["text"], part["note"] or "") for part in parts]
    return found


def calls() -> list[tuple[Block, list[str]]]:
    lines = [
        (b, shlex.split(line))
        for b in blocks()
        if b.language == "sh"
        for line in b.text.replace("\\\n", "").splitlines()
        if line
    ]
    return [(b, words) for b, words in lines if words[0] == "calib"]


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a reader who types along, with `calib` on the path."""
    folder = tmp_path_factory.mktemp("reader")
    (folder / "bin").mkdir()
    program = folder / "bin" / "calib"
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m calib "$@"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "block", [b for page in STORY for b in blocks() if b.page == page and "not run" not in b.note], ids=str
)
def test_what_the_reader_types_works(block: Block, reader: Path) -> None:
    environment = os.environ | {
        "PATH": f"{reader / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
    }
    program = ["bash", "-euo", "pipefail"] if block.language == "sh" else [sys.executable]
    done = subprocess.run(
        [*program, "-c", block.text], cwd=reader, env=environment, capture_output=True, text=True, timeout=600
    )
    fine = {int(code) for code in re.findall(r"\d+", block.note)} if block.note.startswith("exit code ") else {0}
    assert done.returncode in fine, done.stdout[-2000:] + done.stderr[-2000:]
    assert "Traceback" not in done.stderr


def test_every_block_is_run_or_says_why_not() -> None:
    for block in blocks():
        if block.page not in STORY:
            assert block.note.startswith("not run: "), f"{block}: add it to STORY, or say why it is not run"


@pytest.mark.parametrize(("block", "words"), calls(), ids=lambda x: str(x) if isinstance(x, Block) else "")
def test_every_command_and_option_exists(block: Block, words: list[str]) -> None:
    group = get_command(app)
    assert isinstance(group, Commands)
    names = [w for w in words[1:] if not w.startswith("-")]
    known = {o for p in group.params for o in p.opts} | {"--help", "--install-completion"}
    if names:
        command = group.get_command(None, names[0])
        assert command is not None, f"{block}: there is no command {names[0]}"
        if hasattr(command, "commands"):
            command = command.resolve_command(None, names[1:])[1]
        known = {o for p in command.params for o in (*p.opts, *p.secondary_opts)} | {"--help"}
    assert {w for w in words[1:] if w.startswith("--")} <= known


@pytest.mark.parametrize(("block", "words"), calls(), ids=lambda x: str(x) if isinstance(x, Block) else "")
def test_every_arm_and_cell_that_a_command_names_is_shipped(block: Block, words: list[str]) -> None:
    shipped = {*arm_names(), *cell_names()}
    for place, word in enumerate(words):
        takes = words[place - 1] if place else ""
        if takes == "--cell" or (
            takes in ("check", "plan", "record", "identify", "emulate", "servo") and place == 2 and word != "scan"
        ):
            assert word in shipped or word.startswith(("my-", "my_")) or "/" in word, f"{block}: {word} is not shipped"


def test_every_command_is_in_the_documentation() -> None:
    text = "".join(page.read_text() for page in PAGES)
    assert [name for name in COMMANDS if f"calib {name}" not in text] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text()):
        if not target.startswith("https://"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_page_of_effects_is_derived_from_the_catalogue() -> None:
    assert (ROOT / "docs" / "effects.md").read_text() == catalogue.page(), "run `make docs`"
    assert {p.stem for p in (ROOT / "docs" / "effects").glob("*.svg")} == {e.name for e in EFFECTS}


def test_every_page_is_in_the_site() -> None:
    listed = re.findall(r'= "([\w-]+\.md)"', (ROOT / "zensical.toml").read_text())
    assert sorted(listed) == sorted(p.name for p in (ROOT / "docs").glob("*.md"))


def test_an_effect_has_a_picture_of_what_it_leaves() -> None:
    drawing = catalogue.picture(EFFECTS[0])
    assert drawing.startswith("<svg")
    assert "residual [N m]" in drawing


def test_the_site_builds(tmp_path: Path) -> None:
    zensical = Path(sys.executable).parent / "zensical"
    if not zensical.exists():
        pytest.skip("Zensical is not installed, so the site was not built (pip install -e '.[dev]')")
    config = (ROOT / "zensical.toml").read_text()
    (tmp_path / "zensical.toml").write_text(config.replace('"build/site"', '"site"'))
    shutil.copytree(ROOT / "docs", tmp_path / "docs")
    subprocess.run([zensical, "build", "--strict"], cwd=tmp_path, check=True, capture_output=True, timeout=120)
    assert "Ten minutes on the mock arm" in (tmp_path / "site" / "tutorial.html").read_text()


def test_the_foxglove_layout_names_topics_and_fields_that_logs_have() -> None:
    layout = json.loads((ROOT / "docs" / "foxglove-layout.json").read_text())
    for panel, config in layout["configById"].items():
        assert json.dumps(layout["layout"]).count(f'"{panel}"') == 1
        for path in config.get("paths", []):
            topic, field = re.fullmatch(r"([/\w]+)\.(\w+)\[\d\]", path["value"]).groups()  # type: ignore[union-attr]
            like = STATES if topic in (PREDICTED, MISSING) else topic
            assert f"float64[] {field}" in SCHEMAS[TOPICS[like]]
        assert config.get("topicToRender", "/events") in TOPICS
