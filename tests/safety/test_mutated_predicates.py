"""Mutation tests: a change of one comparison, `and`, `or`, `not`, `all`, `any` or `isfinite` must make a test of its rule fail.

Each mutant of a module runs that module's own tests in a forked process; a mutant that no test notices is a survivor. Mutants
without an observable effect are listed in EQUIVALENT, with the reason.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import importlib.machinery
import importlib.util
import os
import sys
import types
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

from benchmarks.kept import Kept

ROOT = Path(__file__).resolve().parents[2]
SWAPS: dict[type[ast.AST], type[ast.AST]] = {
    ast.LtE: ast.Gt, ast.GtE: ast.Lt, ast.Lt: ast.GtE, ast.Gt: ast.LtE, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.And: ast.Or, ast.Or: ast.And, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
}  # fmt: skip
CALLS = {"all": "any", "any": "all", "isfinite": "isnan"}
# module -> functions that are mutated, tests that must notice; predicates are mutated, not the messages
TARGETS = {
    "monitor": (("check", "_check_device", "_check_clearance"), ("test_monitor", "test_monitor_torque", "test_monitor_joints")),
    "cycle": (("cycle",), ("test_monitor", "test_monitor_torque", "test_monitor_joints", "test_readings")),
    "rules": (
        (
            "finite",
            "device_time",
            "age",
            "temperature",
            "jump",
            "position",
            "speed",
            "following_error",
            "torque",
            "sudden_torque",
            "lost_load",
        ),
        ("test_rules", "test_monitor", "test_monitor_torque", "test_monitor_joints"),
    ),
    "lies": (
        ("frozen_position", "mean_speed", "turned", "frozen_torque", "swing", "clock"),
        ("test_rules", "test_monitor", "test_monitor_torque", "test_monitor_joints", "test_readings"),
    ),
    "looks": (("to_look_at", "nearest"), ("test_looks", "test_monitor", "test_monitor_torque", "test_monitor_joints")),
    "limits": (("first_excess", "check_sent"), ("test_limits",)),
    "torque": (("check_torque", "suffices"), ("test_torque", "test_clear", "test_bounds", "test_stated_bounds")),
    "parameters": (("_rows",), ("test_torque", "test_clear")),
    "clear": (("require_cleared", "clear"), ("test_clear",)),
    "sheets": (("check_range", "finite"), ("test_sheets", "test_clear", "test_certify")),
    "loads": (("room",), ("test_tube",)),
    "tube": (("_range", "__init__"), ("test_tube",)),
    "collision": (("distances",), ("test_collision",)),
    "certify": (("certify", "_prove"), ("test_collision", "test_certify")),
    "pairs": (("always_apart",), ("test_pairs", "test_collision")),
    "shapes": (("_check_sizes",), ("test_shapes", "test_collision")),
    "stages": (("gate", "stages_due"), ("test_stages",)),
    "approval": (("check_approval",), ("test_approval", "test_plan")),
    "second_look": (("__init__", "look", "_stopping", "_rules"), ("test_second_look",)),
    "verified_samples": (("__init__", "sample"), ("test_verified_samples", "test_second_look")),
    "signs": (("last", "tripped"), ("test_signs",)),
    "monitor_link": (("reason",), ("test_monitor_link",)),
    "guard": (("_check_start", "_first_reading", "_send"), ("test_guard", "test_guard_faults", "test_guard_one_joint")),
}


def mutants(tree: ast.Module, functions: tuple[str, ...]) -> Iterator[tuple[str, ast.Module]]:
    """Every mutant of the named functions, described by function, line and change."""
    places = [
        (f.name, k, node) for f in ast.walk(tree) if isinstance(f, ast.FunctionDef) and f.name in functions
        for k, node in enumerate(behaviour(f))
    ]  # fmt: skip
    for name, k, node in places:
        for change in changes(node):
            mutant = copy.deepcopy(tree)
            function = next(f for f in ast.walk(mutant) if isinstance(f, ast.FunctionDef) and f.name == name)
            target = behaviour(function)[k]
            apply(target, change)
            line = ast.unparse(target).split("\n")[0][:90]
            yield f"{name}:{getattr(node, 'lineno', '?')} {change} -> {line}", ast.fix_missing_locations(mutant)


def behaviour(function: ast.FunctionDef) -> list[ast.AST]:
    """The nodes of a function's body, without type annotations."""
    types = {id(node) for x in ast.walk(function) if isinstance(x, ast.AnnAssign) for node in ast.walk(x.annotation)}
    types |= {id(n) for x in ast.walk(function) if isinstance(x, ast.arguments) for a in ast.walk(x) for n in ast.walk(a)}
    return [node for statement in function.body for node in ast.walk(statement) if id(node) not in types]


def changes(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Compare):
        return [f"compare {k}" for k, op in enumerate(node.ops) if type(op) in SWAPS]
    if isinstance(node, ast.BoolOp) or (isinstance(node, ast.BinOp) and type(node.op) in SWAPS):
        return ["operator"]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.Invert)):
        return ["not"]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CALLS:
        return ["call"]
    return []


def apply(node: ast.AST, change: str) -> None:
    if isinstance(node, ast.Compare):
        k = int(change.split()[1])
        node.ops[k] = SWAPS[type(node.ops[k])]()  # type: ignore[assignment]
    elif isinstance(node, ast.BoolOp | ast.BinOp):
        node.op = SWAPS[type(node.op)]()  # type: ignore[assignment]
    elif isinstance(node, ast.UnaryOp):
        node.operand = ast.UnaryOp(node.op, node.operand)
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        node.func.attr = CALLS[node.func.attr]


class Mutated(importlib.machinery.SourceFileLoader):
    """Loads one module from the mutated tree."""

    def __init__(self, name: str, path: str, tree: ast.Module) -> None:
        super().__init__(name, path)
        self.tree = tree

    def exec_module(self, module: types.ModuleType) -> None:
        """Leave functions uncompiled: compiling each mutant would take longer than its tests."""
        compiled, numba.config.DISABLE_JIT = numba.config.DISABLE_JIT, True
        super().exec_module(module)
        numba.config.DISABLE_JIT = compiled

    def get_code(self, fullname: str):  # type: ignore[no-untyped-def]
        return compile(self.tree, self.path, "exec")


class Finder:
    def __init__(self, trees: dict[str, ast.Module]) -> None:
        self.loaders = {
            f"safety.{module}": Mutated(f"safety.{module}", str(source_of(module)), tree) for module, tree in trees.items()
        }

    def find_spec(self, name: str, path: object = None, target: object = None):  # type: ignore[no-untyped-def]
        loader = self.loaders.get(name)
        return importlib.util.spec_from_file_location(name, loader.path, loader=loader) if loader else None


def source_of(module: str) -> Path:
    return ROOT / "safety" / f"{module}.py"


def noticed(module: str, tree: ast.Module, tests: tuple[str, ...]) -> bool:
    """Whether the tests fail with the mutant in place of the module, in a forked process."""
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
        for name in [n for n in sys.modules if n == "safety" or n.startswith(("safety.", "tests.safety"))]:
            del sys.modules[name]
        # never compile the cycle: it would come from the cache, with the unmutated rules
        sys.meta_path.insert(0, Finder({"cycle": ast.parse(source_of("cycle").read_text()), module: tree}))  # type: ignore[arg-type]
        code = 70
        try:
            files = [str(ROOT / "tests" / "safety" / f"{test}.py") for test in tests]
            code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", *files]))
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status) != 0


def known_of(module: str, tests: tuple[str, ...]) -> Kept:
    """Results of earlier runs, from the file that MUTANTS names: an interrupted run continues where it stopped.

    A change of the sources discards them.
    """
    sources = [source_of(module), *(ROOT / "tests" / "safety" / f"{test}.py" for test in tests)]
    digest = hashlib.sha256(b"".join(file.read_bytes() for file in sources)).hexdigest()[:16]
    return Kept(Path(os.environ["MUTANTS"]) if "MUTANTS" in os.environ else None, f"{module} {digest}")


# Mutants that may survive, each once, because they have no observable effect:
EQUIVALENT = (
    # _prove: which boxes are halved before their rows are checked one by one; either way every room is a verified one
    "compare 0 -> level <= 0",
    "compare 0 -> at[~proved] < least",
    "call -> (at[~proved] >= least).any()",
    "not -> ~~proved",
    # first_excess: a piece inside the limits is recognised when it is first halved
    "compare 0 -> lo - slack > b",
    "compare 0 -> b > hi + slack",
)


@pytest.mark.slow
@pytest.mark.parametrize("module", TARGETS)
def test_no_change_of_a_predicate_goes_unnoticed(module: str) -> None:
    functions, tests = TARGETS[module]
    tree = ast.parse(source_of(module).read_text())
    known = known_of(module, tests)
    assert known.found.get("as it is") or not noticed(module, tree, tests)
    known.keep("as it is", True)
    survivors = []
    for what, mutant in mutants(tree, functions):
        found = known.found.get(what)
        if found is None:
            found = noticed(module, mutant, tests)
            known.keep(what, found)
        survivors += [] if found else [what]
    unexplained = Counter(what.split(" ", 1)[1] for what in survivors) - Counter(EQUIVALENT)
    assert not unexplained, f"survivors: {survivors}"
