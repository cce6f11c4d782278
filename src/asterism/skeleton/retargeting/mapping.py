"""A skeleton over time, a character and its parts in; the character's motion, with how its feet stand before and after, out.

Bones turn in the room as those of the person do, from rest poses that are laid on each other limb by limb; hips move as far as legs are
long. Then feet are held where they stand, soles are laid on the floor, and legs are bent to reach them in closed form.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.recording import Event, Floats, SkeletonMotion
from asterism.recording.bone_names import FINGERS
from asterism.skeleton.retargeting.body_parts import SIDES, BodyParts, body_parts, refuse_four_legs
from asterism.skeleton.retargeting.contacts import (
    FootContacts,
    Sole,
    find_contacts,
    height_of,
    leg_length,
    sole_points,
    soles_of,
    stretches,
)
from asterism.skeleton.retargeting.legs import (
    ROUNDS,
    STRAIGHT,
    bend,
    groups_of,
    shift_to_reach,
    shortest,
    smooth_hull,
    smooth_offsets,
    within_reach,
)
from asterism.skeleton.retargeting.measures import FeetErrors, feet_errors

_UP, _AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
_STANDING = 0.7
"""Cosine to the vertical of thighs and shanks from which a rest pose stands: 45 degrees. Feet apart in a rest pose are at 15 degrees."""
_NEXT = {"thigh": "shank", "shank": "foot", "upper arm": "forearm", "forearm": "hand", "hand": "middle 1"}


@dataclass(frozen=True)
class Retargeted:
    """A character's motion.

    motion          of the character, in its own axes and rest pose
    copied          the same before feet are held: rotations by bone, root scaled
    contacts        of the character's feet, in a room with z up
    scale           of distances: the character's legs over the person's
    correspondence  for each bone of the character that is driven: its part, the person's bones, and how both were found
    free            the character's bones that keep their place on the bone above
    before, after   the errors of the feet in `copied` and in `motion`
    moved           (T, 3) m, in a room with z up, how far the hips were moved for legs to reach the floor
    findings        what a person should know
    """

    motion: SkeletonMotion
    copied: SkeletonMotion
    contacts: FootContacts
    scale: float
    correspondence: tuple[tuple[str, str, str, str], ...]
    free: tuple[str, ...]
    before: FeetErrors
    after: FeetErrors
    moved: Floats
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class _Standing:
    """A skeleton in a room with z up that stands facing x in its rest pose.

    onto  (B, 3, 3): the rotation of a bone in the skeleton's own terms is that in these, times `onto`
    """

    motion: SkeletonMotion
    parts: BodyParts
    onto: Floats
    reposed: bool


def retarget(
    motion: SkeletonMotion,
    character: SkeletonMotion,
    *,
    events: Iterable[Event] = (),
    bones: Mapping[str, Mapping[str, str]] | None = None,
    hands: bool = False,
    feet: bool = True,
) -> Retargeted:
    """The character moved as the person does.

    motion     of the person; bones that are missing in some frames are refused: fill them first
    character  whose bones, lengths and rest pose count; its own movement does not
    events     foot strikes and offs, times in s from the motion's first frame; without, contacts are found in the movement
    bones      "person" and "character" -> part -> name of a bone, "" for none, where names mislead
    hands      hands go where the person's are, as measured from the hips in the character's size, instead of arms that turn alike
    feet       feet are held where they stand

    Raises AsterismError where a leg of either is not found, either stands nowhere or on four legs, or a frame is missing.

    Cost: O(T B), about 1 s for a minute at 100 Hz.
    """
    bones = bones or {}
    if not np.isfinite(motion.rotations).all() or not np.isfinite(motion.root).all():
        raise AsterismError("bones of the motion are missing in some frames; fill them first, as by interpolation.")
    person = _standing(motion, bones.get("person"), "recording")
    figure = _standing(character, bones.get("character"), "character")
    events = list(events)
    seen = find_contacts(person.motion, person.parts, events)
    scale = leg_length(figure.motion, figure.parts) / leg_length(person.motion, person.parts)
    world, said = _rotations(person, figure)
    hips = _hips(person, seen.floor) * scale
    copied = _posed(figure, world, hips, motion.rate)
    contacts = replace(seen, belt=seen.belt * scale, floor=np.zeros(3), level={side: level * scale for side, level in seen.level.items()})
    soles = soles_of(figure.motion, figure.parts)
    result, moved = copied, np.zeros((len(motion), 3))
    if feet:
        result, moved = _with_feet_held(figure, world, hips, copied, contacts, soles)
    if hands:
        result = _with_hands_placed(person, figure, result, scale, seen.floor)
    if feet:
        result = _with_hands_lifted(figure, result)
    driven = {figure.motion.names.index(one) for _, one, _, _ in said}
    free = tuple(name for b, name in enumerate(figure.motion.names) if b not in driven)
    before, after = (feet_errors(one, soles, contacts) for one in (copied, result))
    return Retargeted(
        _own(figure, result, character),
        _own(figure, copied, character),
        contacts,
        scale,
        tuple(said),
        free,
        before,
        after,
        moved,
        tuple(_findings(person, figure, seen, scale, moved)),
    )


def _findings(person: _Standing, figure: _Standing, seen: FootContacts, scale: float, moved: Floats) -> list[Finding]:
    found = []
    for who, one in (("recording", person), ("character", figure)):
        if one.reposed:
            said = f"The {who}'s rest pose does not stand; its most upright frame was taken instead."
            found.append(Finding("retarget-rest-pose", Severity.NOTE, who, said, "Export it in a T pose where arms or legs are turned."))
        lacking = [p for p in ("head", *(f"{s} {p}" for s in SIDES for p in ("upper arm", "forearm", "hand"))) if p not in one.parts.bones]
        if lacking:
            said = f"The {who} has no bone for {', '.join(lacking)}."
            found.append(Finding("retarget-parts-missing", Severity.NOTE, who, said, "Name it with --bones if it is there."))
        guessed = [
            f"{part} is {one.motion.names[one.parts.bones[part]]}"
            for part, how in one.parts.how.items()
            if how == "tree" and part != "pelvis"
        ]
        if guessed:
            said = f"Bones of the {who} were told by where they hang, not by name: {', '.join(guessed)}."
            found.append(
                Finding("retarget-by-tree", Severity.WARNING, who, said, "Check them, and name those that are wrong with --bones.")
            )
    if seen.belt.any():
        said = f"The feet stand on a belt that moves at {np.linalg.norm(seen.belt):.2f} m/s; they are held on it."
        found.append(Finding("retarget-treadmill", Severity.NOTE, "", said, "Use --no-feet where they slide over the floor."))
    slope = float(np.linalg.norm(seen.floor[1:]))
    if slope > 0.01:
        said = f"The floor of the recording rises by {100 * slope:.1f} %; it was laid level."
        found.append(Finding("retarget-floor-slope", Severity.NOTE, "", said, "Calibrate the cameras' floor anew where it is level."))
    if not any(flags.any() for flags in seen.standing.values()):
        said = "No foot stands anywhere; feet are not held."
        found.append(Finding("retarget-no-contacts", Severity.WARNING, "", said, "Look whether feet slide in the recording."))
    most = float(np.linalg.norm(moved, axis=1).max(initial=0.0))
    if most > 0.05 * scale:
        said = f"The hips are moved by up to {1e3 * most:.0f} mm so that legs reach the floor."
        found.append(Finding("retarget-hips-moved", Severity.NOTE, "", said, "Look at the frames where both feet are far apart."))
    return found


# Rest poses.


def _standing(motion: SkeletonMotion, given: Mapping[str, str] | None, who: str) -> _Standing:
    parts = body_parts(motion, given, who)
    upright = motion.in_axes(_UP, _AHEAD)
    onto = np.tile(np.eye(3), (len(motion.names), 1, 1))
    if _stands(upright, parts):
        refuse_four_legs(upright, parts)
        return _Standing(upright, parts, onto, False)
    # A rest pose in which all bones lie along one axis says nothing of the body; a frame in which it stands does.
    frame = _most_upright(upright, parts)
    pose = upright.turned[frame]
    joints = upright.joints[frame]
    across = joints[parts.bones["left thigh"]] - joints[parts.bones["right thigh"]]
    heading = np.arctan2(across[1], across[0]) - np.pi / 2
    pose = Rotation.from_euler("z", -heading).as_matrix() @ pose
    above = np.array([max(parent, 0) for parent in upright.parents])
    turned = upright.turned @ pose.swapaxes(1, 2)
    rotations = turned[:, above].swapaxes(2, 3) @ turned
    rotations[:, 0] = turned[:, 0]
    offsets = np.einsum("bij,bj->bi", pose[above], upright.offsets)
    ends = np.einsum("bij,bj->bi", pose, upright.ends)
    standing = replace(upright, offsets=offsets, ends=ends, rotations=rotations)
    if not _stands(standing, parts):
        raise AsterismError(
            f"neither the rest pose of the {who} nor any of its frames stands upright; export it with a T pose as its rest pose."
        )
    refuse_four_legs(standing, parts)
    return _Standing(standing, parts, pose, True)


def _leg_directions(joints: Floats, parts: BodyParts) -> Floats:
    """(T, 4) cosines of thighs and shanks to straight down, of joints (T, B, 3)."""
    out = []
    for side in SIDES:
        for upper, lower in (("thigh", "shank"), ("shank", "foot")):
            bone = joints[:, parts.bones[f"{side} {lower}"]] - joints[:, parts.bones[f"{side} {upper}"]]
            out.append(-bone[:, 2] / np.maximum(np.linalg.norm(bone, axis=1), 1e-9))
    return np.stack(out, axis=1)


def _stands(motion: SkeletonMotion, parts: BodyParts) -> bool:
    joints = motion.rest_joints[None]
    trunk = joints[0, parts.spine[-1]] - joints[0, parts.bones["pelvis"]] if parts.spine else _UP
    return bool((_leg_directions(joints, parts) > _STANDING).all() and trunk[2] > 0)


def _most_upright(motion: SkeletonMotion, parts: BodyParts) -> int:
    joints = motion.joints
    score = _leg_directions(joints, parts).sum(axis=1)
    if parts.spine:
        trunk = joints[:, parts.spine[-1]] - joints[:, parts.bones["pelvis"]]
        score = score + 2 * trunk[:, 2] / np.maximum(np.linalg.norm(trunk, axis=1), 1e-9)
    # arms that hang tell their own rest direction best
    for side in SIDES:
        arm = parts.limb(side, "upper arm", "hand")
        if len(arm) == 2:
            bone = joints[:, arm[1]] - joints[:, arm[0]]
            score = score - 0.5 * bone[:, 2] / np.maximum(np.linalg.norm(bone, axis=1), 1e-9)
    return int(score.argmax())


def _own(figure: _Standing, result: SkeletonMotion, character: SkeletonMotion) -> SkeletonMotion:
    """The motion in the character's own axes and rest pose."""
    upright = character.in_axes(_UP, _AHEAD)
    turned = result.turned @ figure.onto
    above = np.array([max(parent, 0) for parent in result.parents])
    rotations = turned[:, above].swapaxes(2, 3) @ turned
    rotations[:, 0] = turned[:, 0]
    own = replace(upright, rotations=rotations, root=result.root, rate=result.rate)
    return own.in_axes(character.vertical, character.forward)


# Rotations by bone.


def _rotations(person: _Standing, figure: _Standing) -> tuple[dict[int, Floats], list[tuple[str, str, str, str]]]:
    """bone of the character -> (T, 3, 3) its rotation in the room; and part, bone, the person's bones, and how they were found."""
    turned, world, said = person.motion.turned, dict[int, Floats](), list[tuple[str, str, str, str]]()
    mine, theirs = person.parts, figure.parts

    def drive(part: str, bone: int, rotation: Floats, sources: list[int], how: str) -> None:
        world[bone] = rotation
        said.append((part, figure.motion.names[bone], ", ".join(person.motion.names[b] for b in sources), how))

    def found_by(part: str) -> str:
        return " and ".join(dict.fromkeys(parts.how.get(part, "tree") for parts in (mine, theirs)))

    pelvis = mine.bones["pelvis"]
    drive("pelvis", theirs.bones["pelvis"], turned[:, pelvis], [pelvis], found_by("pelvis"))
    for part, own, other in (("spine", mine.spine, theirs.spine), ("neck", mine.neck, theirs.neck)):
        below = pelvis if part == "spine" else (mine.spine or (pelvis,))[-1]
        line = [below, *own, *([mine.bones["head"]] if part == "neck" and "head" in mine.bones else [])]
        ends = 1 if part == "neck" and "head" in mine.bones else 0
        for j, bone in enumerate(other, start=1):
            drive(part, bone, _between_bones(turned[:, line], j / (len(other) + ends)), line[1:] or line, "tree")
    if "head" in mine.bones and "head" in theirs.bones:
        drive("head", theirs.bones["head"], turned[:, mine.bones["head"]], [mine.bones["head"]], found_by("head"))
    for side in SIDES:
        laid = np.eye(3)
        for part in (
            "clavicle",
            "thigh",
            "shank",
            "foot",
            "toe",
            "upper arm",
            "forearm",
            "hand",
            *(f"{f} {n}" for f in FINGERS for n in (1, 2, 3)),
        ):
            name = f"{side} {part}"
            if name not in mine.bones or name not in theirs.bones:
                continue
            laid = _laid(person, figure, side, part, laid)
            drive(name, theirs.bones[name], turned[:, mine.bones[name]] @ laid, [mine.bones[name]], found_by(name))
    return world, said


def _between_bones(turned: Floats, share: float) -> Floats:
    """(T, 3, 3) the rotation at a share of the way along a line of bones (T, n, 3, 3)."""
    at = share * (turned.shape[1] - 1)
    first = min(int(at + 1e-9), turned.shape[1] - 1)
    if first == turned.shape[1] - 1 or at - first < 1e-9:
        return turned[:, first]
    below = turned[:, first]
    turn = Rotation.from_matrix(below.swapaxes(1, 2) @ turned[:, first + 1]).as_rotvec()
    found: Floats = below @ Rotation.from_rotvec((at - first) * turn).as_matrix()
    return found


def _laid(person: _Standing, figure: _Standing, side: str, part: str, above: Floats) -> Floats:
    """(3, 3) what takes a bone of the character, in its rest pose, along the person's in theirs.

    above: of the bone before in the limb, for a bone whose direction nobody knows
    """
    if part == "clavicle":
        return np.eye(3)
    if part in ("foot", "toe"):
        # both soles are level in rest poses that stand: only where toes point to differs
        if part == "toe":
            return above
        headings = [np.arctan2(sole.ball[1], sole.ball[0]) for sole in (soles_of(one.motion, one.parts)[side] for one in (person, figure))]
        found: Floats = Rotation.from_euler("z", headings[0] - headings[1]).as_matrix()
        return found
    mine, theirs = (_direction(one, side, part) for one in (person, figure))
    return above if mine is None or theirs is None else shortest(theirs, mine)


def _direction(one: _Standing, side: str, part: str) -> Floats | None:
    """The unit vector along a bone in the rest pose; None where it ends nowhere."""
    bone, places = one.parts.bones[f"{side} {part}"], one.motion.rest_joints
    finger, _, number = part.partition(" ")
    following = f"{finger} {int(number) + 1}" if finger in FINGERS else _NEXT[part]
    after = one.parts.bones.get(f"{side} {following}")
    along = places[after] - places[bone] if after is not None else one.motion.ends[bone]
    if not np.isfinite(along).all():
        below = [b for b, parent in enumerate(one.motion.parents) if parent == bone]
        along = np.mean([places[b] - places[bone] for b in below], axis=0) if below else np.zeros(3)
    length = float(np.linalg.norm(along))
    return along / length if length > 1e-6 else None


def _hips(person: _Standing, floor: Floats) -> Floats:
    """(T, 3) m, the middle of the hip joints, from the floor."""
    joints = person.motion.joints
    middle: Floats = np.mean([joints[:, person.parts.bones[f"{side} thigh"]] for side in SIDES], axis=0)
    return middle - height_of(floor, middle)[:, None] * _UP


def _posed(figure: _Standing, world: Mapping[int, Floats], hips: Floats, rate: float) -> SkeletonMotion:
    """The character with these rotations in the room (T, 3, 3), the middle of its hip joints at hips (T, 3)."""
    rest, parts = figure.motion, figure.parts
    pelvis = parts.bones["pelvis"]
    turned = np.empty((len(hips), len(rest.names), 3, 3))
    line = [pelvis]
    while rest.parents[line[-1]] >= 0:
        line.append(rest.parents[line[-1]])
    for b, parent in enumerate(rest.parents):
        # what is above the hips stays upright, what hangs on a bone goes with it
        turned[:, b] = world[b] if b in world else np.eye(3) if b in line or parent < 0 else turned[:, parent]
    above = np.array([max(parent, 0) for parent in rest.parents])
    rotations = turned[:, above].swapaxes(2, 3) @ turned
    rotations[:, 0] = turned[:, 0]
    posed = replace(rest, rotations=rotations, root=np.zeros((len(hips), 3)), rate=rate)
    middle = np.mean([posed.joints[:, parts.bones[f"{side} thigh"]] for side in SIDES], axis=0)
    return replace(posed, root=hips - middle)


# Feet.


def _with_feet_held(
    figure: _Standing, world: Mapping[int, Floats], hips: Floats, copied: SkeletonMotion, contacts: FootContacts, soles: dict[str, Sole]
) -> tuple[SkeletonMotion, Floats]:
    """The copied motion with feet that stand, and (T, 3) m how far its hips were moved."""
    rate, parts = copied.rate, figure.parts
    belt = np.arange(len(copied))[:, None] / rate * contacts.belt
    world = dict(world)
    # knees, seat and head do not go through the floor; for feet, legs are bent, and arms for hands
    ends = {b for sole in soles.values() for b in (sole.foot, sole.toe)} | {
        parts.bones[one] for one in parts.bones if one.endswith(" hand")
    }
    pelvis = parts.bones["pelvis"]
    lines = {b: [b, *_above(copied, b)] for b in range(len(copied.names))}
    others = [b for b, line in lines.items() if pelvis in line and not ends & set(line)]
    hips = hips + smooth_hull(np.maximum(-_lowest(copied, others), 0.0), rate)[:, None] * _UP
    for side, sole in soles.items():
        turned = world.get(sole.foot, copied.turned[:, sole.foot])
        world[sole.foot] = _level(turned, sole, np.asarray(contacts.standing[side].all(axis=1)), rate)
    lifted = _posed(figure, world, hips, rate)
    targets, legs = dict[str, Floats](), list[tuple[Floats, float]]()
    for side, sole in soles.items():
        points = sole_points(_toe_flat(lifted, sole, contacts, side), sole) - belt[:, None]
        move = _held(points, contacts, side, rate)
        targets[side] = lifted.joints[:, sole.foot] + move
        thigh, knee = (lifted.joints[:, parts.bones[f"{side} {part}"]] for part in ("thigh", "shank"))
        ankle = lifted.joints[:, sole.foot]
        length = float(np.linalg.norm((knee - thigh)[0]) + np.linalg.norm((ankle - knee)[0]))
        legs.append((thigh, length))
    # who stands draws the hips along, a foot in the air does not
    stands = np.stack([contacts.standing[side].any(axis=1) for side in soles], axis=1)
    thighs = np.stack([thigh for thigh, _ in legs], axis=1)
    reach = STRAIGHT * np.array([length for _, length in legs])
    moved = shift_to_reach(thighs, np.stack([targets[side] for side in soles], axis=1), reach, stands, rate)
    posed = _posed(figure, world, hips + moved, rate)
    for k, side in enumerate(soles):
        hip = posed.joints[:, parts.bones[f"{side} thigh"]]
        near = within_reach(hip, targets[side], legs[k][1], stands[:, k], rate)
        world |= _bent(posed, parts, side, ("thigh", "shank", "foot"), near)
    result = _posed(figure, world, hips + moved, rate)
    for side, sole in soles.items():
        result = _toe_flat(result, sole, contacts, side)
    return result, moved


def _above(motion: SkeletonMotion, bone: int) -> list[int]:
    out = []
    while motion.parents[bone] >= 0:
        bone = motion.parents[bone]
        out.append(bone)
    return out


def _level(turned: Floats, sole: Sole, flat: NDArray[np.bool_], rate: float) -> Floats:
    """(T, 3, 3) the rotation of a foot whose sole is level and keeps its direction while heel and ball both stand."""
    if not flat.any():
        return turned
    ahead = turned @ (sole.ball - sole.heel)
    heading = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    rest = np.arctan2((sole.ball - sole.heel)[1], (sole.ball - sole.heel)[0])
    wanted = np.zeros((len(turned), 1, 3))
    for a, b in stretches(flat):
        level = Rotation.from_euler("z", np.median(heading[a:b]) - rest).as_matrix()
        wanted[a:b, 0] = Rotation.from_matrix(level @ turned[a:b].swapaxes(1, 2)).as_rotvec()
    turn = smooth_offsets(wanted, flat[:, None].astype(np.float64), rate)
    turn[flat] = wanted[flat, 0]
    found: Floats = Rotation.from_rotvec(turn).as_matrix() @ turned
    return found


def _held(points: Floats, contacts: FootContacts, side: str, rate: float) -> Floats:
    """(T, 3) m, how a foot is moved so that its points (T, 3, 3) stand still where they stand, and none goes below the floor."""
    standing = contacts.standing[side]
    weight = standing.astype(np.float64)
    # over the floor a point may stand anywhere, but at one place
    over = smooth_offsets(-points[:, :2, :2], weight, rate, groups_of(standing))
    level = np.nan_to_num(contacts.level[side])
    up = (level - points[:, :2, 2])[:, :, None]
    ground = np.where(standing, level, 0.0)
    needed = np.maximum(ground[:, :2] - points[:, :2, 2], (ground[:, 1] - points[:, 2, 2])[:, None]).max(axis=1)
    lift = smooth_offsets(up, weight, rate)[:, 0]
    low, sole_length = np.zeros(len(points)), float(np.linalg.norm(points[0, 1] - points[0, 0]))
    for _ in range(ROUNDS):
        deep = needed - lift
        if deep.max() <= 1e-4 * sole_length:
            break
        # frames that go below are asked to be on the floor, as long as they would
        low = np.where(deep > 0, 1.0, low)
        lift = smooth_offsets(np.concatenate([up, needed[:, None, None]], axis=1), np.column_stack([weight, low]), rate)[:, 0]
    return np.column_stack([over, np.maximum(lift, needed)])


def _toe_flat(motion: SkeletonMotion, sole: Sole, contacts: FootContacts, side: str) -> SkeletonMotion:
    """The motion with toes that bend up where they would go below what the ball stands on."""
    if sole.toe < 0:
        return motion
    points = sole_points(motion, sole)
    ground = np.where(contacts.standing[side][:, 1], np.nan_to_num(contacts.level[side][:, 1]), 0.0)
    joint = motion.joints[:, sole.toe]
    along = points[:, 2] - joint
    flat = np.linalg.norm(along[:, :2], axis=1)
    length = np.linalg.norm(along, axis=1)
    rise = np.clip((np.maximum(points[:, 2, 2], np.minimum(ground, points[:, 1, 2])) - joint[:, 2]) / np.maximum(length, 1e-9), -1.0, 1.0)
    angle = np.arcsin(rise) - np.arctan2(along[:, 2], flat)
    axis = np.cross(along, _UP)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)
    turn = Rotation.from_rotvec(axis * np.maximum(angle, 0.0)[:, None]).as_matrix()
    rotations = motion.rotations.copy()
    above = motion.turned[:, sole.foot]
    rotations[:, sole.toe] = above.swapaxes(1, 2) @ turn @ above @ rotations[:, sole.toe]
    return replace(motion, rotations=rotations)


def _bent(motion: SkeletonMotion, parts: BodyParts, side: str, limb: tuple[str, str, str], target: Floats) -> dict[int, Floats]:
    """The rotations in the room of the two bones of a limb whose end is at the target (T, 3)."""
    upper, lower, end = (parts.bones[f"{side} {part}"] for part in limb)
    joints, turned = motion.joints, motion.turned
    # knees flex backwards and elbows ahead, about axes that lie across where the limb hangs; in the rest pose it may point elsewhere
    along = motion.rest_joints[lower] - motion.rest_joints[upper]
    hangs = shortest(-_UP, along / max(float(np.linalg.norm(along)), 1e-9)) if along.any() else np.eye(3)
    hinge = turned[:, upper] @ hangs @ np.array([0.0, 1.0 if limb[0] == "thigh" else -1.0, 0.0])
    first, second = bend(joints[:, upper], joints[:, lower], joints[:, end], target, hinge)
    return {upper: first @ turned[:, upper], lower: second @ turned[:, lower]}


_ARM = ("upper arm", "forearm", "hand")


def _with_hands_placed(person: _Standing, figure: _Standing, result: SkeletonMotion, scale: float, floor: Floats) -> SkeletonMotion:
    """The motion with wrists where the person's are, from the floor under the hips, in the character's size."""
    joints = person.motion.joints
    for side in SIDES:
        if all(f"{side} {part}" in parts.bones for part in _ARM for parts in (person.parts, figure.parts)):
            wrist = joints[:, person.parts.bones[f"{side} hand"]]
            result = _arm_to(figure, result, side, scale * (wrist - height_of(floor, wrist)[:, None] * _UP))
    return result


def _with_hands_lifted(figure: _Standing, result: SkeletonMotion) -> SkeletonMotion:
    """The motion with arms bent where hands or fingers would go through the floor: long arms of somebody who leans on them."""
    for side in SIDES:
        if any(f"{side} {part}" not in figure.parts.bones for part in _ARM):
            continue
        hand = figure.parts.bones[f"{side} hand"]
        low = _lowest(result, [b for b in range(len(result.names)) if hand in (b, *_above(result, b))])
        if low.min() < 0:
            lift = smooth_hull(np.maximum(-low, 0.0), result.rate)
            result = _arm_to(figure, result, side, result.joints[:, hand] + lift[:, None] * _UP)
    return result


def _arm_to(figure: _Standing, result: SkeletonMotion, side: str, target: Floats) -> SkeletonMotion:
    """The motion with a wrist at the target (T, 3); the hand stays turned as it is, and all else on its bone."""
    changed, hand = _bent(result, figure.parts, side, _ARM, target), figure.parts.bones[f"{side} hand"]
    turned, rotations = result.turned.copy(), result.rotations.copy()
    for b, parent in enumerate(result.parents[1:], start=1):
        turned[:, b] = changed[b] if b in changed else turned[:, b] if b == hand else turned[:, parent] @ rotations[:, b]
        rotations[:, b] = turned[:, parent].swapaxes(1, 2) @ turned[:, b]
    return replace(result, rotations=rotations)


def _lowest(motion: SkeletonMotion, bones: list[int]) -> Floats:
    """(T,) m, the lowest joint or end of these bones."""
    ends = [b for b in bones if np.isfinite(motion.ends[b]).all()]
    return np.concatenate([motion.joints[:, bones, 2], motion.tips[:, ends, 2]], axis=1).min(axis=1)
