"""The rows about labels in images: which hand labels count as impossible."""

from __future__ import annotations

import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from asterism.recording import Recording
from asterism.simulation.views_motion import simulate_motion
from asterism.views import load_body

sys.path.insert(0, str(Path(__file__).parents[1]))
hands = import_module("benchmarks.views.hands")


def renamed(names: dict[str, str]) -> Recording:
    """A simulated person with a whole body, some of whose markers carry the names of others."""
    recording, _ = simulate_motion(load_body("body26"), 60, rng=np.random.default_rng(5))
    return replace(recording, labels=tuple(names.get(name, name) for name in recording.labels))


@pytest.mark.parametrize("side", ["L", "R"])
def test_hands_whose_markers_carry_each_others_names_are_found_on_their_side(side: str) -> None:
    thumb, little, finger = (side + name for name in ("WRA", "WRB", "FIN"))
    assert hands.impossible_hands(renamed({})) == frozenset()
    assert hands.impossible_hands(renamed({thumb: little, little: thumb})) == {thumb, little, finger}
    assert hands.impossible_hands(renamed({thumb: finger, finger: little, little: thumb})) == {thumb, little, finger}
    assert hands.impossible_hands(renamed({side + "ELB": "?"})) == frozenset()
