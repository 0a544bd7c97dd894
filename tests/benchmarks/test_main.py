"""`make bench`: what every topic is given when none is named is what it takes."""

from __future__ import annotations

import inspect
from importlib import import_module

import pytest

from benchmarks.__main__ import SLOW, TOPICS


@pytest.mark.parametrize("topic", [*TOPICS, *SLOW])
def test_a_topic_takes_what_it_is_given(topic: str) -> None:
    run = import_module(f"benchmarks.{topic}").run
    inspect.signature(run).bind(**TOPICS.get(topic, {}))


def test_a_topic_needs_nothing_to_run_in_full() -> None:
    for topic in (*TOPICS, *SLOW):
        inspect.signature(import_module(f"benchmarks.{topic}").run).bind()
