"""`python -m calib` runs `calib`."""

import sys

from calib.main import main

sys.exit(main())
