"""Documents and messages follow docs/style.md; the glossary, class names, file lengths and imports follow the rules."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
STYLE = ROOT / "docs" / "style.md"
PAGES = [ROOT / "README.md", *(p for p in sorted((ROOT / "docs").glob("*.md")) if p != STYLE)]
PACKAGES = ("calib", "safety", "drivers", "logs", "sim")
MODULES = [p for name in PACKAGES for p in sorted((ROOT / name).rglob("*.py"))]
OURS = (*PACKAGES, "benchmarks", "tests")
LONGEST = 250  # lines of a Python file
# private names that tests still import from another file; none may be added
PRIVATE = {
    "calib.diagnosis.names._beyond_ordinary",
}
CODE = re.compile(r"```.*?```|`[^`\n]*`|\]\([^)]*\)", re.DOTALL)


def rules() -> dict[str, str]:
    """Regular expression -> the words to use instead, from the table of the style page."""
    rows = re.findall(r"^\| `(.+?)` \| (.+?) \|$", STYLE.read_text(encoding="utf-8"), re.MULTILINE)
    return {pattern.replace("\\|", "|"): better for pattern, better in rows}


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"))


def messages(module: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every string that a person may read: two words or more, and no docstring except a command's."""
    tree = parsed(module)
    silent = set()
    shown = "commands" in module.parts
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            is_help = (shown and isinstance(node, ast.FunctionDef) and node.decorator_list) or getattr(
                node, "name", ""
            ) == "command"
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and not is_help:
                silent.add(id(first.value))
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in silent
            and " " in node.value.strip()
        ):
            yield node.lineno, node.value


def test_the_style_page_has_rules() -> None:
    assert len(rules()) >= 10
    for pattern, better in rules().items():
        assert not re.search(pattern, better), f"{better!r} is not what {pattern!r} should become"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_a_page_keeps_to_the_words(page: Path) -> None:
    text = CODE.sub(" ", page.read_text(encoding="utf-8"))
    found = [f"{m[0]!r}: {better}" for pattern, better in rules().items() for m in re.finditer(pattern, text, re.IGNORECASE)]
    assert found == []


@pytest.mark.parametrize("package", PACKAGES)
def test_messages_keep_to_the_words(package: str) -> None:
    found = [
        f"{module.relative_to(ROOT)}:{line}: {m[0]!r}: {better}"
        for module in MODULES
        if module.parts[len(ROOT.parts)] == package
        for line, text in messages(module)
        for pattern, better in rules().items()
        for m in re.finditer(pattern, text, re.IGNORECASE)
    ]
    assert found == []


def test_the_glossary_is_in_order_and_says_each_word_once() -> None:
    words = re.findall(r"^\| ([^|]+?) \|", (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8"), re.MULTILINE)
    words = [w for w in words if w not in ("word", "---")]
    assert words == sorted(set(words), key=str.casefold)
    assert len(words) > 30


def test_a_class_name_means_one_thing() -> None:
    """In the packages, without emulated devices, whose classes are named like those of their drivers."""
    at: dict[str, list[str]] = {}
    for module in MODULES:
        if "emulated" in module.parts:
            continue
        for node in parsed(module).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                at.setdefault(node.name, []).append(str(module.relative_to(ROOT)))
    assert {name: files for name, files in at.items() if len(files) > 1} == {}


def test_a_file_has_one_idea_s_length() -> None:
    files = [p for name in OURS for p in sorted((ROOT / name).rglob("*.py"))]
    lines = {p.relative_to(ROOT).as_posix(): len(p.read_text(encoding="utf-8").splitlines()) for p in files}
    assert {name: n for name, n in lines.items() if n > LONGEST} == {}


def private_names(file: Path) -> Iterator[str]:
    """Private names that a file imports from our other files; outside tests, also those used as attributes of imports."""
    tree, imported = parsed(file), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in OURS:
            imported |= {name.asname or name.name: f"{node.module}.{name.name}" for name in node.names}
    yield from (name for name in imported.values() if name.rpartition(".")[2].startswith("_"))
    if file.relative_to(ROOT).parts[0] == "tests":
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and re.match("_[^_]", node.attr):
            yield from (f"{of}.{node.attr}" for name, of in imported.items() if name == node.value.id)


def test_no_file_imports_a_private_name_of_another() -> None:
    """Tests may import those in PRIVATE, other files none."""
    files = [p for name in OURS for p in sorted((ROOT / name).rglob("*.py"))]
    found = {p.relative_to(ROOT).as_posix(): names for p in files if (names := set(private_names(p)))}
    assert {file: names for file, names in found.items() if not file.startswith("tests/") or names - PRIVATE} == {}
    assert set().union(*found.values()) == PRIVATE
