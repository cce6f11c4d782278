"""Figures: what is asked, what is measured. `python -m benchmarks` runs its scripts."""

import os

for _library in ("OMP", "OPENBLAS", "MKL"):  # before NumPy is imported: every process keeps to one core
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
