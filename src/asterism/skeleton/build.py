"""A random generator in; the build of a person out: the lengths of the bones, and how thick segments are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

REFERENCE_HEIGHT = 1.70
"""m, of the body whose lengths and places the tables give."""

BONES = {
    "hips": 0.168,  # between the hip joints
    "thigh": 0.418,
    "shank": 0.415,
    "ankle": 0.078,  # height of the ankle joint over the sole
    "trunk": 0.405,  # from the lower end of the lumbar spine to the neck
    "shoulders": 0.345,
    "upper arm": 0.295,
    "forearm": 0.255,
    "hand": 0.080,  # from the wrist to the knuckles
}
"""m, of a body of `REFERENCE_HEIGHT`: rounded shares of stature near those of the anthropometric tables of biomechanics textbooks."""

CHILD_HEIGHT = 1.50
"""m; below this bodies have more and more the proportions of children, fully so 0.35 m lower."""


@dataclass(frozen=True)
class BuildRules:
    """How people differ in build. Shares are standard deviations; draws beyond 2.5 of them are cut.

    heights     m, shortest and tallest: a child of six to a tall man
    proportion  of each bone's length. At half, long-legged people are foreign; at double, bodies are that nobody has
    asymmetry   of a limb's length, right against left: half of adults have 2 % between the legs
    short_limb  share of the people one of whose limbs is shorter by up to a quarter, as a prosthesis or an illness leaves it
    girth       of all thicknesses
    heavy       share of the people who are heavy: thicknesses and distances across up to 1.35 times the usual ones
    """

    heights: tuple[float, float] = (1.15, 2.00)
    proportion: float = 0.05
    asymmetry: float = 0.01
    short_limb: float = 0.03
    girth: float = 0.10
    heavy: float = 0.10


@dataclass(frozen=True)
class Build:
    """The body of one person.

    height  m
    size    height as a share of `REFERENCE_HEIGHT`
    bones   m, by name; of limbs "left thigh" and "right thigh"
    share   of each bone and of the head, against a body of `size`
    girth   of thicknesses, against a body of `REFERENCE_HEIGHT`
    """

    height: float
    size: float
    bones: dict[str, float]
    share: dict[str, float]
    girth: float


def random_build(rng: np.random.Generator, height: float, rules: BuildRules) -> Build:
    """The build of a person of this height (m)."""

    def vary(std: float) -> float:
        return float(np.clip(rng.normal(), -2.5, 2.5)) * std

    size = height / REFERENCE_HEIGHT
    child = float(np.clip((CHILD_HEIGHT - height) / 0.35, 0.0, 1.0))
    share = {name: 1.0 + vary(rules.proportion) for name in BONES}
    # children have shorter legs and larger heads
    share["thigh"] *= 1.0 - 0.04 * child
    share["shank"] *= 1.0 - 0.04 * child
    share["head"] = 1.0 + 0.3 * child
    bones = {name: size * length * share[name] for name, length in BONES.items()}
    for limb in ("thigh", "shank", "upper arm", "forearm"):
        difference = vary(rules.asymmetry)
        bones[f"left {limb}"], bones[f"right {limb}"] = bones[limb] * (1.0 + 0.5 * difference), bones[limb] * (1.0 - 0.5 * difference)
    if rng.random() < rules.short_limb:
        short = f"{rng.choice(['left', 'right'])} {rng.choice(['thigh', 'shank', 'upper arm', 'forearm'])}"
        bones[short] *= 1.0 - rng.uniform(0.05, 0.25)
    girth = size * (1.0 + vary(rules.girth))
    if rng.random() < rules.heavy:
        girth *= rng.uniform(1.1, 1.35)
    return Build(height, size, bones, share, girth)
