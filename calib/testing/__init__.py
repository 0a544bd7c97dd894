"""The promises of a driver, an arm, an effect and a command, as checks that anyone can run on their own.

    from calib.testing import assert_kept, check_driver

    def test_my_driver():
        assert_kept(check_driver(lambda: MyDriver(...), arm))

Each check returns every promise and whether it was kept, so that one run shows everything that is wrong.
"""

from calib.testing.arm import check_arm
from calib.testing.command import check_command
from calib.testing.driver import check_driver
from calib.testing.effect import check_effect
from calib.testing.promise import Promise, assert_kept, broken

__all__ = ["Promise", "assert_kept", "broken", "check_arm", "check_command", "check_driver", "check_effect"]
