"""A skeleton in; which of its bones is which part of a body, and how that was found, out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, SkeletonMotion
from asterism.recording.bone_names import FINGERS, LIMB_PARTS, parts_of

SIDES = ("left", "right")
PART_NAMES = (
    *("pelvis", "neck", "head"),
    *(f"{side} {part}" for side in SIDES for part in (*LIMB_PARTS, *(f"{finger} {n}" for finger in FINGERS for n in (1, 2, 3)))),
)
"""The parts of the body to which bones are matched; the spine is what lies between pelvis and neck."""
_NEEDED = ("thigh", "shank", "foot")
_UPRIGHT = 0.5
"""Cosine of the angle to the vertical up to which a rest pose's trunk counts as upright: 60 degrees. Trunks of persons rest within 20
degrees of it, those of four-legged animals within 30 degrees of level."""


@dataclass(frozen=True)
class BodyParts:
    """The bones of a body.

    bones  part -> bone: "pelvis", "head", "left thigh", "left thumb 1", ...
    spine  the bones from above the pelvis up to the one that carries arms and neck
    neck   the bones between that and the head
    how    part -> "name", "tree" (where it hangs and lies) or "given"
    """

    bones: Mapping[str, int]
    spine: tuple[int, ...]
    neck: tuple[int, ...]
    how: Mapping[str, str]

    def limb(self, side: str, *parts: str) -> list[int]:
        """The bones of these parts of a side that there are."""
        return [self.bones[f"{side} {part}"] for part in parts if f"{side} {part}" in self.bones]


def body_parts(motion: SkeletonMotion, given: Mapping[str, str] | None = None, who: str = "skeleton") -> BodyParts:
    """Which bone is which part of the body: as given, else by their names, else by where they hang and lie in the rest pose.

    given  part -> name of the bone, or "" for none
    who    what messages call the skeleton

    Raises AsterismError where a bone that is given is not there, or a leg is not found.
    """
    given = dict(given or {})
    found = {part: bone for part, bone in parts_of(motion.names, motion.parents).items()}
    how = dict.fromkeys(found, "name")
    for part, name in given.items():
        if name and name not in motion.names:
            raise AsterismError(f"the bone {name!r} that is given for {part} is not there; the {who} has {', '.join(motion.names[:60])}.")
        found.pop(part, None)
        how.pop(part, None)
        if name:
            found[part], how[part] = motion.names.index(name), "given"
    _complete_limbs(motion, found, how, given)
    if any(f"{side} {part}" not in found for side in SIDES for part in ("thigh", "foot")):
        for part, bone in _by_tree(motion).items():
            if part not in given and part not in found and bone not in found.values():
                found[part], how[part] = bone, "tree"
    missing = [f"{side} {part}" for side in SIDES for part in _NEEDED if f"{side} {part}" not in found]
    if missing:
        raise AsterismError(
            f"the {who} has no bone for {', '.join(missing)}: its bones are {', '.join(motion.names[:30])}; "
            "name them in a TOML file of bones."
        )
    lines = {bone: _line(motion, bone) for bone in range(len(motion.names))}
    for side in SIDES:
        thigh, shank, foot = (found[f"{side} {part}"] for part in _NEEDED)
        if thigh not in lines[shank] or shank not in lines[foot]:
            raise AsterismError(
                f"{motion.names[thigh]}, {motion.names[shank]} and {motion.names[foot]} are not one leg, each hanging on the one before; "
                "name the bones in a TOML file of bones."
            )
    chest, pelvis = _trunk(motion, found, lines)
    if "pelvis" not in given:
        how["pelvis"] = "name" if found.get("pelvis") == pelvis else "tree"
        found["pelvis"] = pelvis
    spine = [bone for bone in lines[chest] if pelvis in lines[bone] and bone != pelvis]
    neck = [bone for bone in lines[found["head"]] if chest in lines[bone] and bone not in (chest, found["head"])] if "head" in found else []
    neck = [bone for bone in neck if bone not in spine]
    return BodyParts(found, tuple(spine), tuple(neck), how)


def refuse_four_legs(motion: SkeletonMotion, parts: BodyParts) -> None:
    """Raise AsterismError where the trunk lies level in the rest pose and the ends of the arms stand as low as the feet."""
    places, up, found = motion.rest_joints, motion.vertical, parts.bones
    height = places @ up
    hands = [found[part] for side in SIDES for part in (f"{side} hand", f"{side} forearm") if part in found]
    trunk = places[parts.spine[-1] if parts.spine else found["pelvis"]] - places[found["pelvis"]]
    length = float(np.linalg.norm(trunk))
    if not hands or length < 1e-9 or trunk @ up > _UPRIGHT * length:
        return
    feet, hips = (np.mean([height[found[f"{side} {part}"]] for side in SIDES]) for part in ("foot", "thigh"))
    if min(height[hand] for hand in hands) < feet + 0.3 * (hips - feet):
        raise AsterismError(
            "the character stands on four legs in its rest pose; a person's movement can be mapped to a character on two legs only."
        )


def _line(motion: SkeletonMotion, bone: int) -> list[int]:
    """The bones from the root to this one, it included."""
    out = [bone]
    while motion.parents[out[-1]] >= 0:
        out.append(motion.parents[out[-1]])
    return out[::-1]


def _shared(lines: list[list[int]]) -> int:
    """The last bone that all lines from the root have in common."""
    return next(bone for bone in reversed(lines[0]) if all(bone in line for line in lines))


def _complete_limbs(motion: SkeletonMotion, found: dict[str, int], how: dict[str, str], given: Mapping[str, str]) -> None:
    """A shank between thigh and foot, or a forearm between upper arm and hand, whose name says nothing: the bone half-way."""
    places = motion.rest_joints
    for side in SIDES:
        for upper, lower, end in (("thigh", "shank", "foot"), ("upper arm", "forearm", "hand")):
            parts = [f"{side} {part}" for part in (upper, lower, end)]
            if parts[1] in found or parts[1] in given or parts[0] not in found or parts[2] not in found:
                continue
            line = _line(motion, found[parts[2]])
            if found[parts[0]] not in line:
                continue
            between = line[line.index(found[parts[0]]) + 1 : -1]
            if between:
                first, last = places[found[parts[0]]], places[found[parts[2]]]
                middle = [np.linalg.norm(places[b] - first) - np.linalg.norm(last - places[b]) for b in between]
                found[parts[1]], how[parts[1]] = between[int(np.abs(middle).argmin())], "tree"


def _trunk(motion: SkeletonMotion, found: Mapping[str, int], lines: Mapping[int, list[int]]) -> tuple[int, int]:
    """The bone that carries arms and neck, and the one that carries legs and spine."""
    arms = [found[f"{s} {p}"] for s in SIDES for p in ("clavicle", "upper arm", "hand") if f"{s} {p}" in found]
    above = [lines[bone][:-1] for bone in [*arms, *([found["head"]] if "head" in found else [])]]
    legs = [lines[found[f"{side} thigh"]][:-1] for side in SIDES]
    pelvis = _shared([*legs, *above])
    return (_shared(above) if above else pelvis), pelvis


def _by_tree(motion: SkeletonMotion) -> dict[str, int]:
    """Legs, arms and head by where bones hang and lie in the rest pose, which must be symmetric about a plane.

    A limb is a line of bones to an end; legs are the two alike ones that end lowest, arms the two that end furthest apart, the head ends
    highest. The left is that of `forward`, which the feet show where names do not.
    """
    places, up, parents = motion.rest_joints, motion.vertical, motion.parents
    carrying = set(parents)
    ends = [bone for bone in range(len(parents)) if bone not in carrying]
    lines = {bone: _line(motion, bone) for bone in ends}
    size = float(np.ptp(places, axis=0).max()) or 1.0
    across, pairs = _mirrored(places, up, ends, size)
    if not pairs:
        return {}
    height = places @ up

    def limb(pair: tuple[int, int]) -> tuple[list[int], list[int]]:
        shared = _shared([lines[pair[0]], lines[pair[1]]])
        return tuple(line[line.index(shared) + 1 :] for line in (lines[pair[0]], lines[pair[1]]))  # type: ignore[return-value]

    limbs = [limb(pair) for pair in pairs]
    long_enough = [one for one in limbs if min(len(one[0]), len(one[1])) >= 3]
    if not long_enough:
        return {}
    legs = min(long_enough, key=lambda one: height[one[0][-1]] + height[one[1][-1]])
    found = dict[str, int]()
    # toes point ahead: they tell left from right
    ahead = np.mean([places[line[-1]] - places[line[2]] for line in legs], axis=0)
    ahead -= (ahead @ up) * up
    left = np.cross(up, ahead) if np.linalg.norm(ahead) > 0.01 * size else np.cross(up, motion.forward)
    if left @ across < 0:
        across = -across

    def take(pair: tuple[list[int], list[int]], parts: tuple[str, ...]) -> None:
        one, other = sorted(pair, key=lambda line: -float(places[line[-1]] @ across))
        for side, line in zip(SIDES, (one, other), strict=True):
            found.update({f"{side} {part}": bone for part, bone in zip(parts, _longest(places, line, len(parts)), strict=False)})

    take(legs, ("thigh", "shank", "foot"))
    rest = [one for one in long_enough if not set(one[0]) & set(legs[0]) and not set(one[0]) & set(legs[1])]
    if rest:
        arms = max(rest, key=lambda one: abs(float((places[one[0][-1]] - places[one[1][-1]]) @ across)))
        take(arms, ("upper arm", "forearm", "hand"))
    single = [end for end in ends if end not in {end for pair in pairs for end in pair}]
    if single:
        found["head"] = max(single, key=lambda end: float(height[end]))
    return found


def _mirrored(places: Floats, up: Floats, ends: list[int], size: float) -> tuple[Floats, list[tuple[int, int]]]:
    """The level axis about whose plane the ends lie most alike on both sides, and the pairs of ends."""
    best: tuple[float, Floats, list[tuple[int, int]]] = (np.inf, np.zeros(3), [])
    for axis in np.eye(3)[np.abs(up) < 0.5]:
        pairs, off = list[tuple[int, int]](), 0.0
        middle = places[0] @ axis
        for end in ends:
            beside = places[end] @ axis - middle
            if beside <= 0.01 * size:
                continue
            image = places[end] - 2 * beside * axis
            other = min(ends, key=lambda one: float(np.linalg.norm(places[one] - image)))
            distance = float(np.linalg.norm(places[other] - image))
            if distance < 0.05 * size:
                pairs.append((end, other))
                off += distance
        score = off - size * len(pairs)
        if score < best[0]:
            best = (score, axis, pairs)
    return best[1], best[2]


def _longest(places: Floats, line: list[int], count: int) -> list[int]:
    """The joints of a limb: the first, and those behind its two longest bones."""
    if len(line) <= count:
        return line
    lengths = [float(np.linalg.norm(places[b] - places[a])) for a, b in pairwise(line)]
    two = sorted(sorted(range(len(lengths)), key=lambda i: -lengths[i])[:2])
    return [line[two[0]], line[two[1]], line[two[1] + 1]][:count]
