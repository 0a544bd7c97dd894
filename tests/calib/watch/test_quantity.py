"""A quantity of the watch as text."""

import pytest

from calib.watch.events import Quantity


@pytest.mark.parametrize(
    ("quantity", "text"),
    [
        (Quantity(43.61, 7.6, "N*m"), "44 ± 15 N m"),
        (Quantity(2.8713, 0.0754, "kg"), "2.87 ± 0.15 kg"),
        (Quantity(17.44, 0.5, "N*m*s/rad"), "17.44 ± 0.98 N m s/rad"),
        (Quantity(231.0, 60.0, "N*m"), "230 ± 120 N m"),
    ],
)
def test_value_and_interval_end_at_one_digit(quantity: Quantity, text: str) -> None:
    assert str(quantity) == text
