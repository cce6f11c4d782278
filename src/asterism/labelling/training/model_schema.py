"""What a model file may hold: its plain head and its arrays, before anything is made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

_HEAD = {
    "version": int,
    "marker_set": dict,
    "usual_score": float,
    "least_confidence": float,
    "look": dict,
    "about": dict,
}
_ARRAYS = {
    **{"markers": ("i", 1), "anchor_triples": ("i", 2), "anchor_low": ("f", 2), "anchor_high": ("f", 2)},
    **{"body_mean": ("f", 3), "body_load": ("f", 4), "body_noise": ("f", 4), "body_log_weight": ("f", 1)},
    **{"calibration_0": ("f", 2), "calibration_1": ("f", 2)},
}
"""Arrays that every model has: the kind of their numbers, and how many dimensions."""

_SAMPLE = {
    **{"sample_texts": ("u", 1), "sample_missing": ("u", 1), "sample_planes": ("u", 2)},
    **{"sample_numbers": ("i", 2), "sample_rates": ("f", 1)},
}
"""Arrays of the sample of the training, where there is one."""

_DISTANCES = {
    **{"distances_first": ("i", 1), "distances_second": ("i", 1), "distances_median": ("f", 2)},
    **{"distances_moving": ("b", 0), "distances_limit": ("f", 0), "distances_unit": ("f", 0)},
}
"""Arrays of the near-rigid distances, where the sample of the training does not show them all."""

_OPEN_ENDED = ("_low", "_high", "_hit_rates", "_median")
"""Ends of names of arrays whose numbers need not be finite: intervals that are open at one side, hit rates that no trial has shown,
distances of markers that someone did not wear."""

_LARGEST = 1e12
_MOST_MARKERS = 2000


def check_contents(head: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Raise ValueError, naming it, for an entry of the head or an array that is missing, of another type, not finite or absurd."""
    for name, kind in _HEAD.items():
        value = head.get(name)
        # A bool is an int to Python, and no count or share to us.
        if isinstance(value, bool) or not isinstance(value, (int, float) if kind is float else kind):
            raise ValueError(f"its {name} is {'of another kind' if name in head else 'missing'}")
    _check_numbers("head", head, 0)
    markers = head["marker_set"].get("names")
    if not isinstance(markers, list) or not all(isinstance(name, str) for name in markers) or len(markers) > _MOST_MARKERS:
        raise ValueError("its markers are no list of names")
    # A sample is all or nothing: with its numbers there, the other arrays must be, too.
    groups = {**(_SAMPLE if "sample_numbers" in arrays else {}), **(_DISTANCES if "distances_median" in arrays else {})}
    for name, (letter, dimensions) in {**_ARRAYS, **groups}.items():
        if name not in arrays:
            raise ValueError(f"it lacks {name}")
        # A body may have no near-rigid distance, but all else must be there.
        empty = not arrays[name].size and name not in _DISTANCES
        if arrays[name].dtype.kind != letter or arrays[name].ndim != dimensions or empty:
            raise ValueError(f"{name} has {arrays[name].dtype} in {arrays[name].shape}")
    for name, array in arrays.items():
        # NaN fails the comparison as well, so that one test finds both.
        if array.dtype.kind == "f" and not name.endswith(_OPEN_ENDED) and not (np.abs(array) < _LARGEST).all():
            raise ValueError(f"{name} has a number that is not finite or too large")
        if array.dtype.kind == "i" and array.size and not (np.abs(array.astype(np.float64)) < _LARGEST).all():
            raise ValueError(f"{name} has a number that is too large")
    _check_sample(arrays, len(markers))


def _check_sample(arrays: Mapping[str, NDArray[Any]], markers: int) -> None:
    """That the lengths of the clips fit the samples, before anything of their size is made."""
    if "sample_numbers" not in arrays:
        return
    numbers, planes, missing = arrays["sample_numbers"], arrays["sample_planes"], arrays["sample_missing"]
    clips = len(arrays["sample_rates"])
    # The lengths bound loops and memory, so that they are checked before the samples are unpacked.
    if numbers.shape != (3, clips) or (numbers[2] < 1).any() or planes.dtype != np.uint8 or planes.shape[0] != 4:
        raise ValueError("its sample of the training does not fit together")
    samples = int(numbers[2].sum()) * markers
    if planes.shape[1] != 3 * samples or len(missing) != (samples + 7) // 8:
        raise ValueError("its sample of the training has another length than it says")
    if not ((arrays["sample_rates"] > 0) & (arrays["sample_rates"] < 1e6)).all():
        raise ValueError("a frame rate of its sample is not possible")


def _check_numbers(where: str, value: Any, depth: int) -> None:
    """Plain values only, numbers finite."""
    # A text can nest deeper than the interpreter's stack.
    if depth > 20:
        raise ValueError(f"its {where} is nested too deeply")
    # What was trained on may be said in any numbers; nothing is computed from them.
    if isinstance(value, float) and not math.isfinite(value) and where != "about":
        raise ValueError(f"its {where} holds {value}")
    if isinstance(value, int) and abs(value) > _LARGEST:
        raise ValueError(f"its {where} holds {value:g}")
    if isinstance(value, dict):
        for key, inner in value.items():
            _check_numbers("about" if where == "about" else str(key), inner, depth + 1)
    elif isinstance(value, list):
        for inner in value:
            _check_numbers(where, inner, depth + 1)
