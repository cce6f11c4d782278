"""`python -m asterism`: the command line where the `asterism` script is not on the path."""

import sys

from asterism.cli import main

sys.exit(main())
