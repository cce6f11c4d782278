"""A random generator in; the joint angles of a posture that people take, out."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np

from asterism.recording import Floats
from asterism.skeleton.angles import ANGLES, ARM, COLUMN, LEG, limited

_SPREAD_DEG = {"turn": 14, "palm": 25, "wrist": 12, "deviate": 6, "shrug": 4, "out": 4, "twist": 5, "yaw": 6, "pitch": 3}
"""How far people are from a posture of the book, by angle: degrees, standard deviation. Hands turn freely, feet stand on the floor."""


@dataclass(frozen=True)
class Posture:
    """Postures by name: of arms, legs and trunk."""

    arms: str
    legs: str
    trunk: str


@dataclass(frozen=True)
class PostureBook:
    """The postures of `postures.toml`.

    arms, legs  name -> ((angles) of the first side, (angles) of the other) in degrees, in the order of `ARM` and `LEG`
    trunk       name -> tilt, lean, side, spin in degrees
    together    postures that go together
    share       (len(together),) how often each is taken, with a sum of 1
    """

    arms: dict[str, tuple[tuple[float, ...], tuple[float, ...]]]
    legs: dict[str, tuple[tuple[float, ...], tuple[float, ...]]]
    trunk: dict[str, tuple[float, ...]]
    together: tuple[Posture, ...]
    share: Floats

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
    trunk = {name: tuple(row) for name, row in table["trunk"].items()}
    return PostureBook(arms, legs, trunk, tuple(Posture(*row[:3]) for row in table["together"]), share / share.sum())


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


def taken(rng: np.random.Generator, posture: Posture, looseness: float = 1.0) -> Floats:
    """(A,) rad, the posture as one person takes it, with left and right exchanged in half of the draws.

    looseness: times the spread of people about the book's angles.
    """
    book = posture_book()
    exchanged = rng.random() < 0.5
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
    return limited(np.radians(degrees))
