"""One program at a time on a bus, and one link of it: whoever comes second sends nothing."""

import numpy as np
import pytest

from drivers.can_servo.driver import CanServo
from tests.drivers.can_servo.test_wire import started, swing, wire_cell


@pytest.mark.parametrize("interface", ["slcan", "damiao", "socketcand"])
def test_a_driver_that_connects_again_closes_what_it_had_open(interface, tmp_path, servo6):
    emulator, cell = started(wire_cell(interface, tmp_path), servo6)
    driver, rest = CanServo.from_cell(cell, servo6), np.array(cell.table.rest)
    try:
        driver.connect()
        first = driver.link
        with driver:
            assert first.failed
            swing(driver, rest, 51)
    finally:
        driver.release()
        emulator.stop()
