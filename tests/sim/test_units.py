"""Units in column headings for arms with hinges, slides or both."""

from __future__ import annotations

import numpy as np
import pytest

from sim.units import headed


@pytest.mark.parametrize(
    ("slides", "heads"),
    [
        ([False, False], ["joint", "after [N m]", "Ia [kg m^2]", "bound [mrad]", "after [A]"]),
        ([True, False], ["joint", "after [N m, slides N]", "Ia [kg m^2, slides kg]", "bound [mrad, slides mm]", "after [A]"]),
        ([True, True], ["joint", "after [N]", "Ia [kg]", "bound [mm]", "after [A]"]),
    ],
)
def test_heads_of_columns_have_the_units_of_the_joints(slides: list[bool], heads: list[str]) -> None:
    assert headed(["joint", "after [N m]", "Ia [kg m^2]", "bound [mrad]", "after [A]"], np.array(slides)) == heads
