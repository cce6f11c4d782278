"""A random generator in; a body out: the sizes of its segments and the positions of the markers on its skin.

Every segment has axes x forward, y left, z up when the body stands upright with hanging arms. The tables give a body of
`REFERENCE_HEIGHT` in metres, left side only: the right side mirrors y. Lengths are those of virtual people; marker places were
measured by eye on a skeleton.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, MarkerSet
from asterism.skeleton.build import BONES, REFERENCE_HEIGHT

LENGTHS = {name: length for name, length in BONES.items() if name != "hand"}
"""m, of a body of `REFERENCE_HEIGHT`. Its hands end the forearms."""

HEEL, BALL = (-0.050, 0.0), (0.125, 0.0)
"""Where the sole touches the floor: (forward, left) of the ankle joint."""

# name: (segment, forward, left, up); `up` of a limb is a share of its length, below its upper joint
CENTRAL: dict[str, tuple[str, float, float, float]] = {
    "SACR": ("pelvis", -0.105, 0.0, 0.085),
    "C7": ("thorax", -0.065, 0.0, 0.460),
    "T2": ("thorax", -0.085, 0.0, 0.415),
    "T6": ("thorax", -0.110, 0.0, 0.310),
    "T10": ("thorax", -0.105, 0.0, 0.215),
    "T12": ("thorax", -0.095, 0.0, 0.160),
    "CLAV": ("thorax", 0.055, 0.0, 0.375),
    "STRN": ("thorax", 0.110, 0.0, 0.220),
    "RBAK": ("thorax", -0.110, -0.090, 0.330),
}
SIDED: dict[str, tuple[str, float, float, float]] = {
    "FHD": ("head", 0.085, 0.070, 0.175),
    "BHD": ("head", -0.085, 0.065, 0.170),
    "ASI": ("pelvis", 0.075, 0.120, 0.080),
    "PSI": ("pelvis", -0.100, 0.048, 0.085),
    "SHO": ("thorax", -0.005, 0.175, 0.435),
    "UPA": ("upper arm", 0.010, 0.052, -0.45),
    "ELB": ("upper arm", -0.015, 0.042, -1.00),
    "FRM": ("forearm", 0.005, 0.038, -0.45),
    "WRA": ("forearm", 0.034, 0.012, -0.98),
    "WRB": ("forearm", -0.032, 0.014, -0.98),
    "FIN": ("forearm", 0.004, 0.020, -1.32),
    "THI": ("thigh", 0.020, 0.085, -0.55),
    "KNE": ("thigh", 0.000, 0.056, -1.00),
    "HFB": ("shank", -0.020, 0.055, -0.07),
    "TUB": ("shank", 0.050, 0.000, -0.13),
    "SHN": ("shank", 0.040, 0.005, -0.55),
    "TIB": ("shank", 0.010, 0.060, -0.50),
    "ANK": ("shank", 0.000, 0.038, -1.00),
    "MMA": ("shank", 0.008, -0.040, -0.99),
    "HEE": ("foot", -0.060, 0.000, -0.038),
    "PCA": ("foot", -0.062, 0.000, -0.015),
    "CPG": ("foot", -0.095, 0.000, -0.040),
    "LCA": ("foot", -0.030, 0.034, -0.048),
    "STL": ("foot", 0.000, -0.036, -0.030),
    "NAV": ("foot", 0.038, -0.034, -0.022),
    "P1M": ("foot", 0.065, -0.034, -0.030),
    "D1M": ("foot", 0.122, -0.038, -0.050),
    "P5M": ("foot", 0.040, 0.040, -0.055),
    "D5M": ("foot", 0.105, 0.046, -0.060),
    "TOE": ("foot", 0.130, 0.004, -0.040),
    "HLX": ("foot", 0.152, -0.022, -0.048),
}
LOWER_ON_THE_RIGHT = {"RTHI": 0.15, "RTIB": 0.15, "RUPA": 0.10, "RFRM": 0.10}
"""Wands sit at different heights left and right, as laboratories place them: share of the segment's length."""

SKIN = {
    "pelvis": 0.004,
    "thigh": 0.008,
    "shank": 0.005,
    "foot": 0.002,
    "thorax": 0.004,
    "head": 0.002,
    "upper arm": 0.006,
    "forearm": 0.004,
}
"""How far skin slides over bone while walking, in metres (standard deviation of the amplitude per axis)."""


@dataclass(frozen=True)
class Body:
    """One person: sizes in metres, and where the markers sit.

    lengths   segment name -> m
    size      stature relative to `REFERENCE_HEIGHT`
    segments  (M,) the segment of each marker ("left thigh", "pelvis", ...)
    places    (M, 3) m in the segment's axes
    slides    (M,) m, how far the skin slides under each marker
    """

    height: float
    size: float
    lengths: dict[str, float]
    segments: tuple[str, ...]
    places: Floats
    slides: Floats


def simulated_markers() -> tuple[str, ...]:
    """Names of all markers that the simulation can place."""
    return (*CENTRAL, *(side + name for side in "LR" for name in SIDED))


def markers_of(marker_set: MarkerSet) -> tuple[str, ...]:
    """For each marker of the set the simulated one that it means. Raises AsterismError where there is none."""
    meant = {marker_set.name_of(name): name for name in simulated_markers()}
    absent = [name for name in marker_set.names if name not in meant]
    if absent:
        raise AsterismError(
            f"marker set {marker_set.title}: the simulation cannot place {absent[0]}; it knows {', '.join(simulated_markers())}."
        )
    return tuple(meant[name] for name in marker_set.names)


def random_body(rng: np.random.Generator, height: float, markers: tuple[str, ...]) -> Body:
    """A body of this height (m) with its own proportions and its own marker places (8 mm off the table, wands more)."""
    size = height / REFERENCE_HEIGHT
    # Each length has its own share: tall people are no scaled short ones.
    proportion = dict(zip(LENGTHS, np.clip(rng.normal(1.0, 0.04, len(LENGTHS)), 0.9, 1.1), strict=True))
    lengths = {name: size * share * proportion[name] for name, share in LENGTHS.items()}
    girth = size * float(np.clip(rng.normal(1.0, 0.09), 0.8, 1.25))
    everywhere = simulated_markers()
    # For all markers, placed or not: a marker has the same place in each set that uses it.
    offsets = np.clip(rng.normal(0.0, 0.008, (len(everywhere), 3)), -0.02, 0.02)
    # Wands are placed by eye along the segment.
    along = np.clip(rng.normal(0.0, 0.05, len(everywhere)), -0.1, 0.1)
    segments, places = [], []
    for name in markers:
        segment, forward, left, up = CENTRAL[name] if name in CENTRAL else SIDED[name[1:]]
        number = everywhere.index(name)
        limb = segment in ("thigh", "shank", "upper arm", "forearm")
        # On a limb the height counts as a share of its length below the joint.
        if limb:
            wand = name[1:] in ("THI", "TIB", "UPA", "FRM", "SHN")
            up = (up + LOWER_ON_THE_RIGHT.get(name, 0.0) + wand * along[number]) * lengths[segment]
        else:
            up *= size * (proportion["trunk"] if segment == "thorax" else 1.0)
        sided = name not in CENTRAL
        # Shoulders widen the thorax, girth all other parts.
        across = proportion["shoulders"] * size if segment == "thorax" and sided else girth
        place = np.array([forward * (size if segment == "foot" else girth), left * across, up]) + offsets[number]
        # The tables are of the left side.
        if sided and name[0] == "R":
            place[1] = -place[1]
        # A marker of 8 mm radius does not sink into the floor.
        if segment == "foot":
            place[2] = max(place[2], 0.008 - lengths["ankle"])
        side = "" if not sided or segment in ("pelvis", "thorax", "head") else {"L": "left ", "R": "right "}[name[0]]
        segments.append(side + segment)
        places.append(place)
    slides = np.array([SKIN[segment.removeprefix("left ").removeprefix("right ")] for segment in segments])
    return Body(height, size, lengths, tuple(segments), np.array(places), slides)
