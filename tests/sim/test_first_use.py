"""The compilation of kernels is announced once, and only if kernels are really compiled."""

import numba
import numpy as np
import pytest

from sim import first_use
from sim.arm import load_arm
from sim.rigid_body import RigidBody


@pytest.fixture
def sentences():
    sentences = []
    first_use.announce(sentences.append)
    yield sentences
    first_use.announce(None)


def test_reported_once_where_kernels_are_compiled(sentences):
    RigidBody(load_arm("ur5e"))  # its kernels register the listener
    numba.njit(lambda x: x + 1)(np.zeros(2))
    numba.njit(lambda x: x + 2)(np.zeros(2))
    assert len(sentences) == 1
    assert sentences[0].startswith("compiling numerical kernels")
    assert "are not kept" in sentences[0]


def test_silent_where_they_come_from_memory_or_from_the_cache(sentences):
    body = RigidBody(load_arm("ur5e"))
    body.gravity_torque(np.zeros((1, 6)))
    sentences.clear()
    first_use.announce(sentences.append)
    body.gravity_torque(np.zeros((1, 6)))
    assert sentences == []
