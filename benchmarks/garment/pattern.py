"""How fast one image is read."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache
from statistics import median

import numpy as np

from asterism.cameras import Rig
from asterism.garment import Pattern, design_pattern
from asterism.garment.read import read_image
from asterism.simulation.garment import Photo, PhotoSettings, Wearer, WornGarment, garment_rig, photograph, sheet_of, suit_masks, wear
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

JACKET = ("torso", "left arm", "right arm")
"""Parts of a suit of which a camera sees about 1,000 circles."""


@cache
def _worn(parts: tuple[str, ...]) -> tuple[WornGarment, Pattern]:
    wearer = Wearer(motion="walk", seed=0, parts=parts)
    mask, pieces = sheet_of(suit_masks(wearer))
    pattern = design_pattern(mask, pieces=pieces, seed=0)
    return wear(pattern, wearer), pattern


def _pictures(quick: bool, parts: tuple[str, ...] = ()) -> Iterator[tuple[Photo, Pattern]]:
    """A walker in a suit of these parts before eight cameras, one moment, in good light; in a quick run an arm before one."""
    worn, pattern = _worn(("left arm",) if quick else parts)
    rig: Rig = garment_rig()
    for number, camera in enumerate(rig.cameras[:1] if quick else rig.cameras):
        yield photograph(worn, camera, 0.0, PhotoSettings(noise=0.01), rng=np.random.default_rng([0, number])), pattern


def speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """One image of 1280 x 960 px with about 1,000 circles, and one of a whole suit, one core; median of ten."""
    suits = {
        "about 1,000": min(_pictures(benchmark.quick, JACKET), key=lambda pair: abs(len(read_image(pair[0].image, pair[1])) - 1000)),
        "a whole suit's": next(_pictures(benchmark.quick)),
    }
    for name, (photo, pattern) in suits.items():
        seconds = []
        for _ in range(2 if benchmark.quick else 10):
            started = time.perf_counter()
            read = read_image(photo.image, pattern)
            seconds.append(time.perf_counter() - started)
        asked = "> 40" if name == "about 1,000" else "none"
        yield Figure(f"reading one image of 1280 x 960, {name} circles, one core", asked, 1.0 / median(seconds), "images/s", len(seconds))
        yield Figure(f"reading one image of 1280 x 960, {name} circles: their number", "none", float(len(read)), "circles", 1)
