"""The part of URScript in which our own control program is written, run statement by statement; one `yield` is one control period.

From the URScript manual of Universal Robots (e-Series, "The URScript Programming Language") and its use in
external_control.urscript of their client library: def, while, if, elif, else, end; numbers, strings, lists; arithmetic,
comparisons; named arguments. Other block syntax and unknown functions are refused before the program starts, as a controller
refuses what it cannot compile; any other statement or expression ends the program when it is reached.
"""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable, Generator, Iterator
from typing import Any

Call = Callable[..., Generator[None, None, Any]]
OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le, ast.Gt: operator.gt, ast.GtE: operator.ge,
}  # fmt: skip
BLOCKS = ("def", "while", "if", "elif", "else")
NUMBER_MAX = 1e15  # ours are far smaller; without a limit, a number could grow until it fills the memory
STATEMENTS_PER_PERIOD = 10_000  # a loop that runs this many without waiting ends the program, as on a controller


class NotCompiled(Exception):
    """The text is not a program that is understood here; the message states why."""


class Ended(Exception):
    """An error while the program ran."""


def compiled(text: str) -> tuple[str, list[ast.stmt]]:
    """Name and body of the program in a text; NotCompiled if it is not one."""
    lines = []
    depth = 0
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].strip() if '"' not in line else line.strip()
        first = re.split(r"[\s(:]", words, maxsplit=1)[0] if words else ""
        if not words:
            continue
        if first == "end":
            depth -= 1
            continue
        level = depth - (first in ("elif", "else"))
        if level < 0 or (first in BLOCKS) != words.endswith(":"):
            raise NotCompiled(f"line {number}: {words!r:.60}")
        lines.append("  " * level + words)
        depth += first in ("def", "while", "if")
    if depth != 0:
        raise NotCompiled(f"{depth} blocks without an end")
    try:
        tree = ast.parse("\n".join(lines))
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise NotCompiled(str(error)) from error
    if len(tree.body) != 1 or not isinstance(tree.body[0], ast.FunctionDef) or tree.body[0].args.args:
        raise NotCompiled("a program is one def without arguments")
    return tree.body[0].name, tree.body[0].body


class Program:
    """A compiled program with the functions that it may call."""

    def __init__(self, text: str, functions: dict[str, Call]) -> None:
        self.name, self._body = compiled(text)
        self._functions = functions
        self._variables: dict[str, Any] = {}
        self._done = 0
        for statement in self._body:
            for node in ast.walk(statement):
                if isinstance(node, ast.Call) and not (isinstance(node.func, ast.Name) and node.func.id in functions):
                    raise NotCompiled(f"{ast.unparse(node.func)!r:.40} is not a function known here")

    def run(self) -> Iterator[None]:
        """Run statement by statement; Ended if one fails."""
        try:
            yield from self._block(self._body)
        except (TypeError, ValueError, IndexError, KeyError, ArithmeticError, RecursionError) as error:
            raise Ended(f"{self.name}: {error}") from error

    def _block(self, body: list[ast.stmt]) -> Iterator[None]:
        for statement in body:
            self._done += 1
            if self._done > STATEMENTS_PER_PERIOD:
                raise Ended(f"{self.name}: a loop that never waits")
            match statement:
                case ast.Assign(targets=[ast.Name(id=name)]):
                    self._variables[name] = yield from self._value(statement.value)
                case ast.Expr():
                    yield from self._value(statement.value)
                case ast.While():
                    while (yield from self._value(statement.test)):
                        yield from self._block(statement.body)
                case ast.If():
                    chosen = statement.body if (yield from self._value(statement.test)) else statement.orelse
                    yield from self._block(chosen)
                case _:
                    raise Ended(f"{self.name}: {ast.unparse(statement)!r:.60} is not understood")

    def _value(self, node: ast.expr) -> Generator[None, None, Any]:
        match node:
            case ast.Constant(value=bool() | int() | float() | str()):
                return node.value
            case ast.Name(id=name):
                return self._variables[name]
            case ast.List():
                return (yield from self._values(node.elts))
            case ast.UnaryOp(op=ast.USub()):
                return -_number((yield from self._value(node.operand)))
            case ast.BinOp() if type(node.op) in OPERATORS:
                left = yield from self._value(node.left)
                right = yield from self._value(node.right)
                return _number(OPERATORS[type(node.op)](_number(left), _number(right)))
            case ast.Compare(ops=[op], comparators=[other]) if type(op) in OPERATORS:
                left = yield from self._value(node.left)
                return OPERATORS[type(op)](left, (yield from self._value(other)))
            case ast.Subscript():
                values = yield from self._value(node.value)
                return values[(yield from self._value(node.slice))]
            case ast.Call(func=ast.Name(id=name)):
                given, named = (yield from self._values(node.args)), {}
                for keyword in node.keywords:
                    named[str(keyword.arg)] = yield from self._value(keyword.value)
                return (yield from self._waited(self._functions[name](*given, **named)))
        raise Ended(f"{self.name}: {ast.unparse(node)!r:.60} is not understood")

    def _values(self, nodes: list[ast.expr]) -> Generator[None, None, list[Any]]:
        values = []
        for node in nodes:
            values.append((yield from self._value(node)))  # noqa: PERF401 - a comprehension cannot wait
        return values

    def _waited(self, call: Generator[None, None, Any]) -> Generator[None, None, Any]:
        while True:
            try:
                next(call)
            except StopIteration as over:
                return over.value
            self._done = 0
            yield


def _number(value: Any) -> int | float:
    """`value` if it is a number that a controller can hold, else ValueError."""
    if isinstance(value, int | float) and abs(value) <= NUMBER_MAX:
        return value
    raise ValueError(f"{value!r:.40} is not a usable number")
