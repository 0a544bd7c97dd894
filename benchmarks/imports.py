"""The code that a figure depends on: a module's imports within this checkout, and theirs.

Imports inside functions count. Imports by a computed name do not (the driver named in a cell, the command that a person types);
a benchmark lists those in its MEASURES.
"""

from __future__ import annotations

import ast
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("calib", "safety", "drivers", "logs", "sim", "benchmarks")
# these run benchmarks and store their findings; they change no figure
ASIDE = ("benchmarks.results", "benchmarks.imports", "benchmarks.kept", "benchmarks.forked")
ARM, ARMS = "sim.arm", "configs/arms"  # code that reads arms depends on the shipped arms


def git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True, check=False)
    return done.stdout.strip()


def commands(*names: str) -> tuple[str, ...]:
    """Modules behind `calib NAME`, for MEASURES."""
    return ("calib.main", *(f"calib.commands.{name}" for name in names))


def files(path: str) -> list[str]:
    """Tracked files under a path or, for a module (`calib.commands.diagnose`), the files of everything it imports.

    ValueError if there are none.
    """
    if found := git("ls-files", "--", path).splitlines():
        return found
    if path not in modules():
        raise ValueError(f"{path}: no file of the checkout; a benchmark names code that was moved or removed")
    found, todo = [], [path]
    known = set(ASIDE)
    while todo:
        name = todo.pop()
        if name not in known:
            known.add(name)
            found.append(modules()[name])
            todo += imported(name)
    return sorted([*found, *(git("ls-files", "--", ARMS).splitlines() if ARM in known else ())])


@cache
def modules() -> dict[str, str]:
    """File of each module of the packages."""
    tracked = git("ls-files", "--", *PACKAGES).splitlines()
    return {f[:-3].replace("/", ".").removesuffix(".__init__"): f for f in tracked if f.endswith(".py")}


@cache
def imported(name: str) -> frozenset[str]:
    """Modules of the packages that a module imports anywhere in its code, and its parent packages.

    Imports for type checking do not count.
    """
    place = modules()[name]
    try:
        tree = ast.parse((ROOT / place).read_bytes())
    except (OSError, SyntaxError):  # a file that was removed or is being written
        return frozenset()
    package = name if place.endswith("__init__.py") else name.rpartition(".")[0]
    found, todo = {name.rpartition(".")[0]}, list[ast.AST]([tree])
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = (
                ".".join([*parts[: len(parts) - node.level + 1], node.module or ""]).strip(".") if node.level else node.module
            )
            found |= {str(base), *(f"{base}.{alias.name}" for alias in node.names)}
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            todo += node.orelse
        else:
            todo += ast.iter_child_nodes(node)
    # importing a.b.c also runs a and a.b
    whole = {".".join(x.split(".")[:k]) for x in found for k in range(1, x.count(".") + 2)}
    return frozenset(whole & modules().keys())
