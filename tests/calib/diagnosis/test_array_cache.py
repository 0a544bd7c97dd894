"""Caches hold values within a number of bytes: only the least recently used values are computed again."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from calib.diagnosis.array_cache import ArrayCache, CacheBudget

ARRAY = np.zeros(10)  # 80 bytes


class Counted:
    """Counts how often each value is computed."""

    def __init__(self) -> None:
        self.times: dict[str, int] = {}

    def of(self, cache: ArrayCache, key: str) -> np.ndarray:
        def compute() -> np.ndarray:
            self.times[key] = self.times.get(key, 0) + 1
            return np.full(10, float(ord(key)))

        return cache.of(key, compute)


def test_a_value_is_computed_once() -> None:
    cache, counted = ArrayCache(CacheBudget(1000)), Counted()
    assert counted.of(cache, "a") is counted.of(cache, "a")
    assert counted.times == {"a": 1}


def test_beyond_its_bytes_the_least_recently_used_goes() -> None:
    cache, counted = ArrayCache(CacheBudget(2 * ARRAY.nbytes)), Counted()
    for key in "abacab":  # c drops b, which was used longest ago; b then drops c
        assert (counted.of(cache, key) == ord(key)).all()
    assert counted.times == {"a": 1, "b": 2, "c": 1}


def test_one_value_larger_than_all_bytes_is_kept_until_the_next() -> None:
    cache, counted = ArrayCache(CacheBudget(1)), Counted()
    for key in "aaba":
        counted.of(cache, key)
    assert counted.times == {"a": 2, "b": 1}


def test_arrays_of_an_object_count() -> None:
    cache, counted = ArrayCache(CacheBudget(2.5 * ARRAY.nbytes)), Counted()
    counted.of(cache, "a")
    cache.of("pair", lambda: SimpleNamespace(rows=ARRAY.copy(), gradient=ARRAY.copy(), name="x"))
    counted.of(cache, "a")
    assert counted.times == {"a": 2}


def test_caches_share_the_bytes() -> None:
    budget, counted = CacheBudget(2 * ARRAY.nbytes), Counted()
    first, second = ArrayCache(budget), ArrayCache(budget)
    for cache, key in ((first, "a"), (second, "b"), (first, "a"), (second, "c"), (first, "a"), (second, "b")):
        counted.of(cache, key)
    assert counted.times == {"a": 1, "b": 2, "c": 1}  # the order of use counts across both caches


def test_a_cache_that_is_gone_makes_room() -> None:
    budget, counted = CacheBudget(2 * ARRAY.nbytes), Counted()
    kept, gone = ArrayCache(budget), ArrayCache(budget)
    counted.of(kept, "a")
    counted.of(gone, "b")
    del gone
    counted.of(kept, "c")
    counted.of(kept, "a")
    assert counted.times == {"a": 1, "b": 1, "c": 1}
