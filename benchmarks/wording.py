"""Whether two Python sources differ in wording alone: in docstrings and messages."""

from __future__ import annotations

import ast
import re

WORDS = 3
SEARCHES = (
    "startswith", "endswith", "find", "index", "count", "partition", "rpartition", "split", "removeprefix", "removesuffix", "replace",
    "compile", "match", "search", "sub",
)  # fmt: skip


def structure(source: bytes) -> str:
    """The syntax tree of Python source without docstrings and messages: equal for two sources that differ in wording alone.

    A message is a text of one line with WORDS words or more; of a formatted one the values count, in any order, and its text does not.
    What is compared, looked up or searched for is no message. ValueError where the source cannot be read.
    """
    try:
        tree = ast.parse(source)
    except SyntaxError as error:
        raise ValueError(str(error)) from error
    return ast.dump(_Wordless().visit(tree))


class _Wordless(ast.NodeTransformer):
    def generic_visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(node):
            node.body[0] = ast.Pass()
        return super().generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        return node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        key = node.slice if isinstance(node.slice, ast.Constant) else self.visit(node.slice)
        return ast.Subscript(self.visit(node.value), key)

    def visit_match_case(self, node: ast.match_case) -> ast.AST:
        return node

    def visit_Dict(self, node: ast.Dict) -> ast.AST:
        return ast.Dict(node.keys, [self.visit(value) for value in node.values])

    def visit_Call(self, node: ast.Call) -> ast.AST:
        return node if isinstance(node.func, ast.Attribute) and node.func.attr in SEARCHES else self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.AST:
        return ast.Constant("") if isinstance(node.value, str) and _is_message(node.value) else node

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        texts = [str(part.value) for part in node.values if isinstance(part, ast.Constant)]
        if not _is_message(" ".join(texts)):
            return self.generic_visit(node)
        values = (part for part in node.values if not isinstance(part, ast.Constant))
        return self.generic_visit(ast.JoinedStr(sorted(values, key=ast.dump)))


def _is_message(text: str) -> bool:
    return "\n" not in text and len(re.findall(r"[A-Za-z]{2,}", text)) >= WORDS
