"""`python -m asterism.cli`: the command line where the script `asterism` is not on the path."""

import sys

from asterism.cli import main

sys.exit(main())
