"""Kernels compiled ahead in a second process are those, and with those types, that labelling a recording as a whole calls."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from models import trained

import asterism
from asterism.labelling import compile_ahead
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.labelling.whole import _distance_kernels, _kernels, _short_kernels, _twin_kernels
from asterism.simulation import simulate_walks
from asterism.tracking import _cut_kernels, chain_kernels, link_kernels

pytestmark = pytest.mark.kernels

ENTRIES: dict[str, Any] = {
    f"{module.__name__}.{name}": getattr(module, name)
    for module, names in {
        link_kernels: ["link_frames"],
        chain_kernels: ["combine_directions", "sort_frames", "link_numbers", "number_chains"],
        _cut_kernels: ["repair_links", "count_strays"],
        _kernels: [
            "score_frames",
            "sum_scores",
            "overlaps",
            "rivals_weight",
            "settle_dominant",
            "best_split",
            "margins_of",
        ],
        _distance_kernels: ["training_deviations"],
        _twin_kernels: ["score_twins", "score_exchanges"],
        _short_kernels: ["label_short"],
    }.items()
    for name in names
}


def compiled() -> dict[str, set[Any]]:
    return {name: set(kernel.signatures) for name, kernel in ENTRIES.items()}


def test_labelling_a_recording_as_a_whole_needs_nothing_more() -> None:
    compile_ahead.main(list(compile_ahead.STEPS))
    ahead = compiled()
    assert all(ahead.values()), "every kernel of the list is compiled"
    walks = simulate_walks(subjects=5, frames=120, seed=4)
    ensemble = trained(walks[:4], miner=None)
    clouds, _ = simulate_gaps_and_ghosts(walks[4], 2, 1, seed=1)
    ensemble.label(clouds)
    assert compiled() == ahead


SMALL_STEP = """
import sys
import numpy as np
from asterism.labelling import compile_ahead
from asterism.tracking.chain_kernels import number_chains

none = np.zeros(0, dtype=np.int64)
compile_ahead.STEPS["small"] = lambda: number_chains(none, none)
compile_ahead.main(sys.argv[1:])
"""


def test_a_process_that_compiles_ahead_fills_the_cache(tmp_path: Path) -> None:
    """With one small kernel: a whole step takes half a minute to compile."""
    source = str(Path(asterism.__file__).parents[1])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": source}
    subprocess.run([sys.executable, "-m", "asterism.labelling.compile_ahead"], env=environment, check=True)
    assert not list(tmp_path.iterdir()), "without a step, nothing is compiled"
    subprocess.run([sys.executable, "-c", SMALL_STEP, "small"], env=environment, check=True)
    assert any("number_chains" in path.name for path in tmp_path.glob("asterism.tracking.chain_kernels-*/*.nbc"))
