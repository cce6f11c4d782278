"""A marker set and a seed in; labelled recordings of people who never lived, in many postures and movements, out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import axis_rotations
from asterism.recording import Floats, MarkerSet, Recording
from asterism.skeleton.angles import habits, limited
from asterism.skeleton.build import BuildRules, random_build
from asterism.skeleton.kinematics import markers, on_the_floor, pose, swung
from asterism.skeleton.movements import BY_STEPS, MOVEMENTS, heading, moving
from asterism.skeleton.postures import recorded_postures
from asterism.skeleton.worn import WearRules, places_of, put_on

ACT = "act"
"""In `VirtualRules`: one of the movements of the book, drawn for each recording."""

FEWEST_FRAMES = 5
"""Frames of one recording: fewer have no path over the floor."""


@dataclass(frozen=True)
class VirtualRules:
    """How virtual people are made.

    build  how they differ in build
    wear   how the markers are put on them
    share  of a person's frames in each of `MOVEMENTS`, or "act" for any of those that go step by step
    take   frames of one recording of each: postures of people who stand, and ways of walking, are one for each recording
    without  sources of recorded postures that are left out (`recorded.toml`), but not all, for an honest judgement on people of these
    noise  m, standard deviation of each coordinate: what cameras add
    """

    build: BuildRules = field(default_factory=BuildRules)
    wear: WearRules = field(default_factory=WearRules)
    share: tuple[tuple[str, float], ...] = (("walk", 0.2), ("run", 0.1), ("stand", 0.2), ("move", 0.4), ("act", 0.1))
    take: tuple[tuple[str, int], ...] = (("walk", 50), ("run", 50), ("stand", 12), ("move", 1000), ("act", 10))
    without: tuple[str, ...] = ()
    noise: float = 0.0005

    def __post_init__(self) -> None:
        unknown = {name for name, _ in (*self.share, *self.take)} - {*MOVEMENTS, ACT}
        if unknown:
            raise AsterismError(f"virtual people do not know how to {min(unknown)}; choose among {', '.join((*MOVEMENTS, ACT))}.")
        strangers = set(self.without) - set(recorded_postures())
        if strangers:
            raise AsterismError(f"there are no recorded postures of {min(strangers)}; leave out some of {', '.join(recorded_postures())}.")


def virtual_people(
    marker_set: MarkerSet | str,
    people: int = 80,
    frames: int = 200,
    rate: float = 50.0,
    seed: int = 0,
    rules: VirtualRules | None = None,
) -> list[Recording]:
    """Labelled recordings of virtual people who wear a marker set, several for each person.

    frames: of each person, about. Positions are in metres, z up; `metadata["subject"]` names the person. The same arguments give the same
    recordings, bit for bit, and a person differs neither by how many others there are nor by how often one is asked.
    O(people frames M). Raises AsterismError where the set does not say of every marker where it sits, or a number is none of people.

    >>> recordings = virtual_people("helen-hayes", people=2, frames=100, seed=1)
    >>> sorted({recording.metadata["subject"] for recording in recordings})
    ['V000', 'V001']
    >>> recordings[0].labels[:3], recordings[0].rate
    (('RASI', 'LASI', 'SACR'), 50.0)
    """
    worn_set, rules = MarkerSet.load(marker_set), rules or VirtualRules()
    if people < 1 or frames < FEWEST_FRAMES or not 0.0 < rate < np.inf:
        raise AsterismError(
            f"{people} virtual people with {frames} frames at {rate:g} Hz cannot be made; give 1 person, {FEWEST_FRAMES} frames at least."
        )
    places_of(worn_set)
    low, high = rules.build.heights
    # heights are spread evenly: twenty people drawn freely may all be tall
    places = np.random.default_rng([seed, people]).permutation(people)
    found = []
    for number in range(people):
        rng = np.random.default_rng([seed, number])
        build = random_build(rng, low + (high - low) * (places[number] + rng.random()) / people, rules.build)
        worn = put_on(rng, build, worn_set, rules.wear)
        held = habits(rng)
        for kind, (name, count, take) in enumerate(_takes(rules, frames)):
            own = np.random.default_rng([seed, number, kind, take])
            does = str(own.choice(BY_STEPS)) if name == ACT else name
            time = np.arange(count) / rate
            motion = moving(time, own, without=rules.without) if does == "move" else MOVEMENTS[does](time, own)
            angles = limited(motion.angles + held)
            segments = pose(build, angles)
            path = on_the_floor(segments.touch, rate)
            path[:, 2] += motion.above
            swings = np.random.default_rng([seed, number, kind, take, 1])
            positions = swung(worn, markers(worn, segments, angles) + path[:, None], rate, swings)
            positions = _in_the_room(positions, rate, own) + own.normal(0.0, rules.noise, positions.shape)
            about_it = {
                "file": f"virtual {number:03d} {does} {take}",
                "format": "virtual",
                "units": "m",
                "subject": f"V{number:03d}",
                "height": round(build.height, 3),
            }
            found.append(Recording(positions, worn_set.names, rate, metadata=about_it))
    return found


def _takes(rules: VirtualRules, frames: int) -> list[tuple[str, int, int]]:
    """Movement, number of frames and number of each recording of one person."""
    total, length = sum(share for _, share in rules.share), {name: 50 for name in MOVEMENTS} | dict(rules.take)
    found = []
    for name, share in rules.share:
        count = round(frames * share / total)
        if count < FEWEST_FRAMES:
            continue
        takes = max(1, count // length[name])
        found += [(name, max(FEWEST_FRAMES, count // takes), take) for take in range(takes)]
    return found


def _in_the_room(positions: Floats, rate: float, rng: np.random.Generator) -> Floats:
    """The positions (T, M, 3) turned and shifted to where someone is in the room."""
    turned = positions @ axis_rotations("z", heading(np.arange(len(positions)) / rate, rng)).swapaxes(1, 2)
    return np.asarray(turned + np.append(rng.uniform(-0.5, 0.5, 2), 0.0))
