"""Reading of hard images: how many circles, how many wrong; of rendered wearers and of a print that OpenCV warps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from asterism.garment.design import design_pattern
from asterism.garment.read import ReadCircles, read_image
from asterism.simulation.garment import (
    CircleTruth,
    Folds,
    Lamp,
    PhotoSettings,
    Wearer,
    garment_rig,
    photograph,
    ring_of_lamps,
    sheet_of,
    suit_masks,
    wear,
)
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from tests.garment_warps import Warp, warped

LIGHTS = {
    "lamps all around": {},
    "two lamps, one warm": {"lamps": (Lamp((2.5, 1.5, 2.2), (14.0, 10.0, 6.0)), Lamp((-2.5, -1.0, 1.0), (3.0, 3.0, 4.0)))},
    "dim and blue": {"lamps": ring_of_lamps(strength=1.2, colour=(0.7, 0.9, 1.3)), "ambient": (0.08, 0.10, 0.14)},
}
NOISES = (0.01, 0.03, 0.1)
"""Of the highest value; 0.1 is 20 dB."""
SEED = 4711
"""The rules were chosen on images of other seeds."""


@dataclass
class Tally:
    """Counts over images."""

    given: int = 0
    wrong: int = 0
    readable: int = 0
    right: int = 0

    def add_photo(self, read: ReadCircles, truth: CircleTruth) -> None:
        """Count a rendered image: an identity is wrong where its circle is half its diameter or more away."""
        place = np.full(int(max(truth.ids.max(), read.ids.max(initial=0))) + 1, -1)
        place[truth.ids[truth.ids >= 0]] = np.flatnonzero(truth.ids >= 0)
        given = read.ids >= 0
        at = place[read.ids[given]]
        off = np.linalg.norm(truth.centres[at] - read.centres[given], axis=1)
        right = (at >= 0) & (off < np.maximum(2.0, 0.5 * truth.diameters[at, 0]))
        self._add(right, read.ids[given], truth.ids[truth.readable() & (truth.ids >= 0)])

    def add_warp(self, read: ReadCircles, warp: Warp, ids: np.ndarray) -> None:
        """Count a warped print."""
        given = read.grid[:, 0] >= 0
        cell = read.grid[given]
        off = np.linalg.norm(warp.centres[cell[:, 0], cell[:, 1]] - read.centres[given], axis=1)
        right = off < 0.5 * warp.diameters[cell[:, 0], cell[:, 1], 0]
        kept = read.ids[given] >= 0
        self._add(right[kept], read.ids[given][kept], ids[warp.readable() & (ids >= 0)])

    def _add(self, right: np.ndarray, ids: np.ndarray, wanted: np.ndarray) -> None:
        self.given += len(ids)
        self.wrong += int((~right).sum())
        self.readable += len(wanted)
        self.right += int(np.isin(wanted, ids[right]).sum())

    @property
    def recall(self) -> float:
        """Share of the readable circles that were read rightly."""
        return self.right / max(self.readable, 1)


def hard_images(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Rendered suits in three lights at three levels of noise, and warped prints."""
    photos, lights = Tally(), {name: Tally() for name in LIGHTS}
    noisy = Tally()
    for number in range(2 if benchmark.quick else 36):
        name, noise = list(LIGHTS)[number % 3], NOISES[number // 3 % 3]
        read, truth = _suit(number, name, noise, benchmark.quick)
        tallies = [photos, lights[name], *([noisy] if noise == max(NOISES) else [])]
        for tally in tallies:
            tally.add_photo(read, truth)
    yield Figure("wrong identities, rendered suits", "< 1e-6", photos.wrong / max(photos.given, 1), "share", max(photos.given, 1))
    for name, tally in lights.items():
        if tally.readable:
            yield Figure(
                f"read of circles of 6 px within 60 degrees, rendered suits, {name}", ">= 0.95", tally.recall, "share", tally.readable
            )
    if noisy.readable:
        yield Figure(
            "read of circles of 6 px within 60 degrees, rendered suits, noise of 20 dB", ">= 0.95", noisy.recall, "share", noisy.readable
        )
    prints = Tally()
    pattern = design_pattern((12, 16) if benchmark.quick else (34, 44), seed=3)
    for number in range(2 if benchmark.quick else 60):
        rng = np.random.default_rng([SEED, 1, number])
        warp = warped(
            pattern, (640, 480) if benchmark.quick else (1280, 960), rng.uniform(0, 55), NOISES[number % 3], (0, 90)[number % 2], rng=rng
        )
        prints.add_warp(read_image(warp.image, pattern), warp, pattern.ids)
    yield Figure(
        "wrong identities, prints through OpenCV warps", "< 1e-6", prints.wrong / max(prints.given, 1), "share", max(prints.given, 1)
    )
    yield Figure(
        "read of circles of 6 px within 60 degrees, prints through OpenCV warps", ">= 0.95", prints.recall, "share", max(prints.readable, 1)
    )


def _suit(number: int, light: str, noise: float, quick: bool) -> tuple[ReadCircles, CircleTruth]:
    rng = np.random.default_rng([SEED, 0, number])
    wearer = Wearer(motion=("walk", "raise arms")[number % 2], parts=("left arm",) if quick else (), folds=Folds(height=0.003))
    mask, pieces = sheet_of(suit_masks(wearer))
    pattern = design_pattern(mask, pieces=pieces)
    camera = garment_rig(size=(640, 480) if quick else (1280, 960), rng=rng).cameras[number % 8]
    settings = PhotoSettings(noise=noise, blur=float(rng.uniform(0.4, 0.9)), jpeg=(0, 0, 85)[number // 2 % 3], **LIGHTS[light])  # type: ignore[arg-type]
    photo = photograph(wear(pattern, wearer), camera, float(rng.uniform(0, 1.2)), settings, rng=rng)
    return read_image(photo.image, pattern), photo.truth
