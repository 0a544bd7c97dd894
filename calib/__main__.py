"""`python -m calib` is `calib`."""

import sys

from calib.main import main

sys.exit(main())
