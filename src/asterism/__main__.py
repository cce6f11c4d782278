"""`asterism` and `python -m asterism`: the command line; an interruption while it is still being imported leaves no traceback."""

from __future__ import annotations

import sys


def run() -> int:
    """Import and run the command line; returns its exit status, 130 where it is interrupted."""
    try:
        from asterism.cli import main

        return main()
    except KeyboardInterrupt:
        print("asterism: interrupted; nothing was begun.", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(run())
