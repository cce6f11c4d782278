"""A random generator in; the joint angles of a posture that people take, out."""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.angles import ANGLES, ARM, COLUMN, LEG, MOVABLE, limited, mirrored

_SPREAD_DEG = {"turn": 14, "palm": 25, "wrist": 7, "deviate": 6, "shrug": 4, "out": 4, "twist": 5, "yaw": 6, "pitch": 3}
"""How far people are from a posture of the book, by angle: degrees, standard deviation. Hands turn freely, feet stand on the floor."""


_BETWEEN_CENTRES_DEG = 8.0
"""How far postures are from the centre of their cluster: degrees, standard deviation, as the mean within clusters of the recorded ones is.
At half, what lies between the centres is foreign; at double, centres are no more than the book's."""


@dataclass(frozen=True)
class Posture:
    """Postures by name: of arms, legs and trunk, and how the body as a whole lies."""

    arms: str
    legs: str
    trunk: str
    whole: str = "upright"


@dataclass(frozen=True)
class Step:
    """One step of a movement: the posture to which it leads, s that it takes, and m by which the body is then above the floor."""

    posture: Posture
    seconds: float
    above: float = 0.0


@dataclass(frozen=True)
class PostureBook:
    """The postures of `postures.toml`.

    arms, legs  name -> ((angles) of the first side, (angles) of the other) in degrees, in the order of `ARM` and `LEG`
    trunk       name -> tilt, lean, side, spin in degrees
    whole       name -> lie, roll in degrees
    together    postures that go together
    share       (len(together),) how often each is taken, with a sum of 1
    movements   name -> steps, again and again
    """

    arms: dict[str, tuple[tuple[float, ...], tuple[float, ...]]]
    legs: dict[str, tuple[tuple[float, ...], tuple[float, ...]]]
    trunk: dict[str, tuple[float, ...]]
    whole: dict[str, tuple[float, ...]]
    together: tuple[Posture, ...]
    share: Floats
    movements: dict[str, tuple[Step, ...]]

    def standing(self) -> tuple[tuple[Posture, ...], Floats]:
        """Postures in which one stands upright, and their shares."""
        chosen = [i for i, posture in enumerate(self.together) if posture.legs in ("stand", "wide") and posture.trunk == "upright"]
        share = self.share[chosen]
        return tuple(self.together[i] for i in chosen), share / share.sum()


@cache
def posture_book() -> PostureBook:
    """The postures that virtual people take."""
    table = tomllib.loads(resources.files("asterism").joinpath("skeleton", "postures.toml").read_text(encoding="utf-8"))
    arms, legs = ({name: (tuple(rows[0]), tuple(rows[-1])) for name, rows in table[part].items()} for part in ("arms", "legs"))
    share = np.array([float(row[3]) for row in table["together"]])
    trunk, whole = ({name: tuple(row) for name, row in table[part].items()} for part in ("trunk", "whole"))
    together = tuple(Posture(*row[:3], *row[4:]) for row in table["together"])
    movements = {name: tuple(_step(*row) for row in rows) for name, rows in table["movements"].items()}
    return PostureBook(arms, legs, trunk, whole, together, share / share.sum(), movements)


def _step(arms: str, legs: str, trunk: str, seconds: float, whole: str = "upright", above: float = 0.0) -> Step:
    return Step(Posture(arms, legs, trunk, whole), seconds, above)


@cache
def recorded_postures() -> dict[str, Floats]:
    """Source -> (N, A) rad, postures that recorded people took: the centres of clusters in `recorded.toml`."""
    table = tomllib.loads(resources.files("asterism").joinpath("skeleton", "recorded.toml").read_text(encoding="utf-8"))
    return {source: limited(np.radians(np.array(rows, dtype=np.float64))) for source, rows in table.items()}


def like_a_recorded_one(rng: np.random.Generator, without: Collection[str]) -> Floats:
    """(A,) rad, a posture near one that somebody took who was recorded, with left and right exchanged in half of the draws.

    without: sources of `recorded_postures` that are left out.
    """
    rows = np.concatenate([rows for source, rows in recorded_postures().items() if source not in without])
    angles = rows[rng.integers(len(rows))] + np.radians(_BETWEEN_CENTRES_DEG) * rng.normal(size=len(ANGLES)) * MOVABLE
    return limited(mirrored(angles) if rng.random() < 0.5 else angles)


def any_posture(rng: np.random.Generator, apart: float) -> Posture:
    """A posture of the book; in a share `apart` of the draws arms, legs and trunk are drawn each by itself."""
    book = posture_book()
    if rng.random() >= apart:
        return book.together[rng.choice(len(book.together), p=book.share)]
    # most of the time it is the arms that do something, and the rest of the body stands
    arms = str(rng.choice(list(book.arms)))
    legs = str(rng.choice(list(book.legs))) if rng.random() < 0.6 else "stand"
    trunk = str(rng.choice(list(book.trunk))) if rng.random() < 0.6 else "upright"
    return Posture(arms, legs, trunk)


def taken(rng: np.random.Generator, posture: Posture, looseness: float = 1.0, exchanged: bool | None = None) -> Floats:
    """(A,) rad, the posture as one person takes it.

    looseness: times the spread of people about the book's angles; exchanged: whether left and right are, in half of the draws by default.
    """
    book = posture_book()
    exchanged = rng.random() < 0.5 if exchanged is None else exchanged
    degrees = np.zeros(len(ANGLES))
    for rows, names in ((book.arms[posture.arms], ARM), (book.legs[posture.legs], LEG)):
        # what both sides share of the deviation, and what each has of its own
        shared = rng.normal(0.0, 1.0, len(names))
        for side, row in zip(("right", "left") if exchanged else ("left", "right"), rows, strict=True):
            for j, name in enumerate(names):
                usual = row[j] if j < len(row) else 0.0
                spread = _SPREAD_DEG.get(name, 7.0 + 0.06 * abs(usual))
                degrees[COLUMN[f"{side} {name}"]] = usual + looseness * spread * (0.75 * shared[j] + 0.65 * rng.normal())
    mirror = -1.0 if exchanged else 1.0
    for name, usual in zip(("tilt", "lean", "side", "spin"), book.trunk[posture.trunk], strict=True):
        sign = mirror if name in ("side", "spin") else 1.0
        degrees[COLUMN[name]] = sign * usual + looseness * (4.0 + 0.12 * abs(usual)) * rng.normal()
    degrees[COLUMN["list"]] = 2.0 * looseness * rng.normal()
    # one looks ahead when the trunk leans
    degrees[COLUMN["nod"]] = -0.5 * degrees[COLUMN["lean"]] + 12.0 * looseness * rng.normal()
    degrees[COLUMN["look"]] = 18.0 * looseness * rng.normal()
    degrees[COLUMN["cock"]] = 6.0 * looseness * rng.normal()
    lie, roll = book.whole[posture.whole]
    tipped = bool(lie or roll)
    degrees[COLUMN["lie"]] = lie + 8.0 * tipped * looseness * rng.normal()
    degrees[COLUMN["roll"]] = mirror * roll + 8.0 * tipped * looseness * rng.normal()
    return limited(np.radians(degrees))
