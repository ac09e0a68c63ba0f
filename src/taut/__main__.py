"""python -m taut: the command line."""

import sys

from taut.cli.main import main

sys.exit(main())
