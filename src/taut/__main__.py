"""python -m taut: the command line."""

import sys

from taut.apps.cli import main

sys.exit(main())
