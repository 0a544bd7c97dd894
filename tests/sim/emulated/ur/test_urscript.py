"""Programs run statement by statement. One that is not understood, fails or never waits is ended and does not reach Python."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.emulated.ur.urscript import Ended, NotCompiled, Program


def run(text: str, periods: int = 100) -> tuple[list[Any], int]:
    """Values that a program showed, and the number of periods that it ran."""
    shown: list[Any] = []

    def show(*values: Any) -> Generator[None, None, None]:
        shown.extend(values)
        return
        yield

    def sync() -> Generator[None, None, None]:
        yield

    count = 0
    for _ in Program(text, {"show": show, "sync": sync}).run():
        count += 1
        if count == periods:
            break
    return shown, count


def test_numbers_lists_conditions_and_loops() -> None:
    text = """\
def p():
  q = [1, 2.5, -3]  # a comment
  k = 0
  while k < 3:
    if q[k] > 2:
      show("large", q[k] / 2)
    elif q[k] == 1:
      show("one")
    else:
      show(q[k] * 2 + 1)
    end
    k = k + 1
    sync()
  end
end
"""
    assert run(text) == (["one", "large", 1.25, -5], 3)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("while True:\n k = 1\n end", "never waits"),
        ("show(nobody)", "nobody"),
        ("k = [1]\n show(k[5])", "out of range"),
        ("show(1 / 0)", "division"),
        ('show("a" * 9)', "not a usable number"),
        ("k = 9\nwhile True:\n k = k * k\n end", "not a usable number"),
        ("show(1)[0]", "subscriptable"),
        ("k = lambda: 1", "not understood"),
        ("import os", "not understood"),
        ("k = show.__class__", "not understood"),
        ("k = 9 ** 9", "not understood"),
        ("for k in [1]:\n show(k)\n end", "line 2"),
    ],
)
def test_what_fails_ends_the_program(body: str, words: str) -> None:
    with pytest.raises((Ended, NotCompiled), match=words):
        run(f"def p():\n{body}\nend\n")


@given(st.text(alphabet=st.sampled_from("abdefhilnpwy ()[]=:<>.,+-*/\"'01\n#"), max_size=200))
def test_any_text_is_a_program_or_is_refused(text: str) -> None:
    for whole in (text, f"def p():\n{text}\nend\n"):
        try:
            run(whole, 10)
        except (Ended, NotCompiled):
            continue
