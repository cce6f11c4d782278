"""Measure and print: a chapter, some rows of it, all key figures for a release, or write the pages from the newest release.

python -m benchmarks recordings gaps stream --json gaps.json
python -m benchmarks.recordings.gaps --json gaps.json
python -m benchmarks release
python -m benchmarks docs
"""

from __future__ import annotations

import sys

from benchmarks.script import main

if __name__ == "__main__":
    sys.exit(main())
