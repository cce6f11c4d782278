"""Labelled trials of one person in; the person's skeleton out: bone lengths, joints, where each marker sits, and how much it moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.geometry import rotate_z_up
from asterism.recording import Floats, MarkerSet, Recording
from asterism.skeleton._tree_kernels import ROOT, pose_tree
from asterism.skeleton.inverse_kinematics import RULES as KINEMATICS
from asterism.skeleton.inverse_kinematics import Kinematics, solve_points
from asterism.skeleton.joints import JOINTS, SegmentJoint, Turn, lengths_of, scales_of
from asterism.skeleton.place_fit import RULES as PLACE_FIT
from asterism.skeleton.place_fit import STARTS, PlacedBody
from asterism.skeleton.place_learning import RULES as PLACES
from asterism.skeleton.place_learning import guess_places, lay_skeleton, marker_set_of, metres_apart
from asterism.skeleton.tree import Coordinate, JointMotion, KinematicTree, Point, TreeBone, TreeMarker

_REVERSED = frozenset(
    {
        "hip flexion",
        "shoulder flexion",
        "elbow flexion",
        "pronation",
        "wrist flexion",
        "wrist deviation",
        "girdle ahead",
        "ankle flexion",
        "foot inversion",
    }
)
"""Angles whose usual sense is left-handed about the axis of `joints.Turn`: a flexed thigh goes ahead, and y is to the left."""

_RANGES_DEG: Mapping[str, tuple[float, float]] = {
    "girdle up": (-10, 40),
    "girdle ahead": (-30, 30),
    "shoulder flexion": (-60, 180),
    "shoulder abduction": (-45, 180),
    "shoulder rotation": (-90, 90),
    "carrying angle": (-10, 25),
    "elbow flexion": (-10, 150),
    "pronation": (-110, 110),
    "wrist flexion": (-80, 80),
    "wrist deviation": (-40, 40),
    "hip abduction": (-40, 60),
    "hip flexion": (-45, 130),
    "hip rotation": (-50, 50),
    "knee flexion": (-15, 150),
    "knee rotation": (-30, 30),
    "knee abduction": (-10, 10),
    "foot rotation": (-35, 45),
    "ankle flexion": (-60, 45),
    "foot inversion": (-35, 35),
    "trunk rotation": (-60, 60),
    "trunk bending": (-40, 40),
    "trunk flexion": (-40, 90),
    "head rotation": (-80, 80),
    "head bending": (-40, 40),
    "head flexion": (-60, 60),
}
"""Degrees, ranges of motion of textbooks of anatomy, widened by the 10 degrees that supple people have beyond them."""

_BESIDE_FLEXION = (Turn("knee rotation", 2, 0.0, 5.0), Turn("knee abduction", 0, 0.0, 2.0))
"""What a knee does beside its flexion: with pins in the bones of people who walk it turns by 5 to 9 degrees and tilts by 1 to 6 (Lafortune
et al., J Biomech 25, 1992). The laying of the usual skeleton leaves it a hinge."""

_ENDS: Mapping[str, Point] = {"head": (0.0, 0.0, 0.25), "hand": (0.0, 0.0, -0.17), "foot": (0.19, 0.0, -0.06)}
"""m, of a body of 1.70 m: crown, fingertips, tip of the great toe."""


def joint_label(bone: str) -> str:
    """The name of a column of a recording that holds the joint of a bone, as a clinical model or a functional trial tells it.

    >>> joint_label("left thigh")
    'left thigh joint'
    """
    return f"{bone} joint"


_JOINT_COLUMNS = {joint_label(joint.segment): joint.segment for joint in JOINTS}


@dataclass(frozen=True)
class PersonRules:
    """How a skeleton is fitted to a person.

    frames       of the standing and of the moving trials that count, evenly spread: more say little that is new
    joint        m, how well the laying of the usual skeleton tells a joint's place beforehand: 11 to 19 mm at hips (Bell 1990)
    place        m, the same of a marker's place on its bone, beside what its name says
    centre       m, how far a joint is from where a column of a recording has it, in each pose
    alike        m, how far the two sides differ: half of adults have 2 % between the legs
    spread       m, how far a marker moves about its place beforehand: mostly skin that slides; half of what is believed, since what
                 the markers of a segment do together looks like a movement of the bone, and is not seen
    moves        poses in which the skin is elsewhere, as which all frames count: it follows the joints, frame after frame. At 40 hips
                 are drawn by 50 mm to where skin on thighs makes them seem to be; at 2 a movement hardly tells a joint
    rounds       of poses and places in turns at most
    done         m, step of all places below which they are done
    """

    frames: tuple[int, int] = (5, 35)
    joint: float = 0.015
    place: float = 0.02
    centre: float = 0.010
    alike: float = 0.006
    spread: float = 0.008
    moves: float = 6.0
    rounds: int = 12
    done: float = 0.0002


RULES = PersonRules()


@dataclass(frozen=True, eq=False)
class FittedPerson:
    """A person's skeleton.

    tree      bones, joints with coordinates, and markers with places and spreads
    title     of the marker set
    findings  what a person should know
    """

    tree: KinematicTree
    title: str
    findings: tuple[Finding, ...]

    @property
    def lengths(self) -> dict[str, float]:
        """m, from each bone's joint to that of the first bone that hangs on it, or to its end."""
        return lengths_of_bones(self.tree)


def lengths_of_bones(tree: KinematicTree) -> dict[str, float]:
    """m, from each bone's joint to that of the first bone that hangs on it, or to its end; bones without either are left out."""
    found = {name: float(np.linalg.norm(end)) for name, end in tree.ends.items()}
    for bone in reversed(tree.bones):
        if bone.parent and bone.parent not in tree.ends:
            found[bone.parent] = float(np.linalg.norm(bone.offset))
    return {name: found[name] for name in tree.bone_names if name in found}


def fit_person(
    standing: Sequence[Recording], moving: Sequence[Recording] = (), *, markers: MarkerSet | None = None, rules: PersonRules = RULES
) -> FittedPerson:
    """The skeleton of one person, from standing trials, moving ones, or both.

    markers  the set that is worn; by default all named markers. Where its places are not said they are known by their names in the shipped
             sets, and markers of unknown names sit where they are seen on the skeleton

    Columns of joints (`joint_label`) are no markers: they tell where joints are. `with_joint_centres` of `motion.clinical` adds those of
    Plug-in-Gait. The usual skeleton is laid on some frames by the places of the set (`place_learning`). Joints, marker places and their
    spreads are then found together with the poses, as in a bundle adjustment: a joint is where both bones carry it alike, as far as the
    movement tells, and where the laying has it else. Deterministic; one to three seconds.
    Raises AsterismError where many markers are far from where their names say, fewer than six markers are known, or no trial is given.
    """
    recordings = [*standing, *moving]
    if not recordings:
        raise AsterismError("a skeleton is fitted to trials of a person; give a standing one, a moving one, or both.")
    named = [recording.select([label for label in recording.labels if label not in _JOINT_COLUMNS]) for recording in recordings]
    known = marker_set_of(named, "skeleton") if markers is None else markers
    shares = (rules.frames[0] if standing and moving else sum(rules.frames) if standing else 0, rules.frames[1] if moving else 0)
    frames = [_spread_frames(part, known, count) for part, count in ((standing, shares[0]), (moving, shares[1]))]
    points, joints = (np.concatenate([part[which] for part in frames if len(part[which])]) for which in (0, 1))
    body, worn, segments, displaced = _laid(known, recordings[0], points)
    tree = _tree(body, worn, segments, known.title or "skeleton", rules)
    columns = [known.names.index(name) for name in worn]
    findings = [*([] if standing else [_no_standing(recordings[0])]), *_several_people(recordings), *displaced]
    told = [i for i, bone in enumerate(_JOINT_COLUMNS.values()) if bone in tree.bone_names and np.isfinite(joints[:, i]).any()]
    centres = [TreeMarker(list(_JOINT_COLUMNS)[i], list(_JOINT_COLUMNS.values())[i], (0.0, 0.0, 0.0), rules.centre) for i in told]
    measured = np.concatenate([points[:, columns], joints[:, told]], axis=1)
    tree = refine(tree.with_markers([*tree.markers, *centres]), measured, rules)
    return FittedPerson(tree.with_markers(tree.markers[: len(columns)]), known.title, tuple(findings))


def _no_standing(recording: Recording) -> Finding:
    where = str(recording.metadata.get("file", "the recording"))
    return Finding(
        "skeleton-no-static",
        Severity.NOTE,
        where,
        "no standing trial: the skeleton is fitted to the moving one alone, and its angles count from the usual posture.",
        "Give the person's standing trial with --static.",
    )


def _several_people(recordings: Sequence[Recording]) -> list[Finding]:
    people = sorted({str(name) for recording in recordings if (name := recording.metadata.get("subject"))})
    if len(people) < 2:
        return []
    sentence = f"the trials name several people: {', '.join(people)}. Bones are fitted to all of them."
    return [Finding("skeleton-several-people", Severity.WARNING, ", ".join(people), sentence, "Give the trials of one person.")]


def _spread_frames(recordings: Sequence[Recording], known: MarkerSet, count: int) -> tuple[Floats, Floats]:
    """(F, M, 3) m, so many frames of trials, z up, the fullest of each stretch; and (F, J, 3) m, the joints of `_JOINT_COLUMNS` in them."""
    parts, joints = list[Floats](), list[Floats]()
    told = MarkerSet(tuple(_JOINT_COLUMNS))
    for recording in recordings:
        columns = known.columns_of(recording.labels)
        stretches = [part for part in np.array_split(np.arange(len(recording)), max(count // len(recordings), 1)) if len(part)]
        shown = np.isfinite(recording.positions[:, columns[columns >= 0], 0]).sum(axis=1)
        # Of equally full frames the middle one: ends of trials are where people come and go.
        chosen = [part[np.nonzero(shown[part] == shown[part].max())[0]] for part in stretches]
        frames = [int(best[len(best) // 2]) for best in chosen]
        upright = rotate_z_up(recording.positions[frames], recording.vertical)
        for kept, its in ((parts, columns), (joints, told.columns_of(recording.labels))):
            points = np.full((len(frames), len(its), 3), np.nan)
            points[:, its >= 0] = upright[:, its[its >= 0]]
            kept.append(points)
    if not parts:
        return np.empty((0, len(known), 3)), np.empty((0, len(told), 3))
    return np.concatenate(parts), np.concatenate(joints)


def _laid(known: MarkerSet, first: Recording, points: Floats) -> tuple[PlacedBody, list[str], list[str], list[Finding]]:
    """The usual skeleton laid on frames: the body, the markers that it wears, the segment of each, and findings of those that are far off.

    Raises AsterismError where so many are not that the names are not of this body.
    """
    guessed, doubts = guess_places(known, PLACES)
    whole = Recording(points, known.names, first.rate, metadata=first.metadata)
    body, worn, places = lay_skeleton(known, whole, guessed, doubts, PLACES, PLACE_FIT)
    at = [np.array(place.at) + shift for place, shift in zip(places, body.shifts, strict=True)]
    judged = {name: metres_apart(at[i], guessed[name]) for i, name in enumerate(worn) if name in guessed and not guessed[name].wand}
    where = str(first.metadata.get("file", "the recording"))
    far = [name for name, away in judged.items() if away > max(PLACES.far, 3.0 * guessed[name].spread)]
    if len(far) > max(2.0, PLACES.astray * len(judged)):
        raise AsterismError(
            f"{where}: {len(far)} of {len(judged)} markers ({', '.join(far[:5])}, ...) are far from where their names say: left and right "
            "are exchanged, the recording is mirrored, or the names are of another set; correct them, or give the set with --markers."
        )
    displaced = [
        Finding(
            "skeleton-marker-displaced",
            Severity.WARNING,
            f"{where}, {name}",
            f"{name} sits {1000 * judged[name]:.0f} mm from where its name says.",
            "Check its label, also against that of its other side; the skeleton took it for right.",
        )
        for name in far
        if judged[name] > 2.0 * PLACES.far
    ]
    return replace(body, shifts=np.array(at)), worn, [place.segment for place in places], displaced


def _tree(body: PlacedBody, worn: Sequence[str], segments: Sequence[str], title: str, rules: PersonRules) -> KinematicTree:
    """The laid skeleton as a kinematic tree, of the bones that carry markers and those between them."""
    lengths, size = lengths_of(body.sizes), float(np.exp(body.sizes[0]))
    by_name = {joint.segment: joint for joint in JOINTS}
    needed = set[str]()
    for segment in segments:
        while segment:
            needed.add(segment)
            segment = by_name[segment].carrier
    # A pelvis that carries nothing, with nothing but the trunk on it, says nothing.
    alone = "pelvis" not in segments and not any(by_name[name].carrier == "pelvis" and name != "thorax" for name in needed)
    if alone:
        needed.discard("pelvis")
    bones, coordinates, ends = list[TreeBone](), list[Coordinate](), dict[str, Point]()
    for joint in JOINTS:
        if joint.segment not in needed:
            continue
        root = not bones
        offset = (
            np.zeros(3)
            if root
            else size * np.array(joint.at) + sum((lengths[name] * np.array(by) for name, by in joint.along), np.zeros(3))
        )
        turns = () if root else (*joint.turns, *_more(joint))
        bones.append(
            TreeBone(joint.segment, "" if root else joint.carrier, offset, tuple(JointMotion(_axis(joint, t), t.name) for t in turns))
        )
        coordinates += [_coordinate(turn) for turn in turns]
        plain = joint.segment.removeprefix("left ").removeprefix("right ")
        if plain in _ENDS:
            ends[joint.segment] = _point(size * np.array(_ENDS[plain]))
    markers = tuple(
        TreeMarker(name, segment, _point(at * scales_of(body.sizes, segment)), rules.spread)
        for name, segment, at in zip(worn, segments, body.shifts, strict=True)
    )
    starts = np.array([[_started(c, posture) for c in coordinates] for posture in STARTS]).reshape(len(STARTS), -1)
    return KinematicTree(tuple(bones), tuple(coordinates), markers, True, ends, starts, title)


def _more(joint: SegmentJoint) -> tuple[Turn, ...]:
    """The turns of a joint beside those with which the usual skeleton is laid."""
    side, _, plain = joint.segment.rpartition(" ")
    return tuple(replace(turn, name=f"{side} {turn.name}") for turn in _BESIDE_FLEXION) if plain == "shank" else ()


def _point(place: Floats) -> Point:
    return (float(place[0]), float(place[1]), float(place[2]))


def _plain(name: str) -> str:
    return name.removeprefix("left ").removeprefix("right ")


def _axis(joint: SegmentJoint, turn: Turn) -> Point:
    """The axis about which the angle has its usual sense; the right side is the left one's mirror image."""
    sign = -1.0 if _plain(turn.name) in _REVERSED else 1.0
    sign *= -1.0 if joint.segment.startswith("right ") and turn.axis != 1 else 1.0
    return _point(sign * np.eye(3)[turn.axis])


def _coordinate(turn: Turn) -> Coordinate:
    plain = _plain(turn.name)
    left = turn.usual if not (turn.name.startswith("right ") and turn.axis != 1) else -turn.usual
    usual = float(np.radians(-left if plain in _REVERSED else left))
    low, high = (float(np.radians(degrees)) for degrees in _RANGES_DEG[plain])
    return Coordinate(turn.name, usual, float(np.radians(turn.spread)), low, high, usual)


def _started(coordinate: Coordinate, posture: Mapping[str, float]) -> float:
    """rad, a coordinate in a posture of `STARTS`, whose degrees are right-handed about the axes of `joints`."""
    plain = _plain(coordinate.name)
    return float(np.radians(posture[plain] * (-1.0 if plain in _REVERSED else 1.0))) if plain in posture else coordinate.usual


def refine(tree: KinematicTree, points: Floats, rules: PersonRules = RULES) -> KinematicTree:
    """The tree with its joints, marker places and spreads as frames (F, M, 3) m of its markers show them, z up.

    Gauss and Newton over joints, places and the poses of all frames together; the poses are taken out of the equations frame by frame (the
    Schur complement of a bundle adjustment). What frames do not tell stays where it was: see `PersonRules`. O(rounds F (D + G)^2 G) of G
    numbers of joints and places.
    """
    first = tree
    for _ in range(rules.rounds):
        found = _solved(tree, points)
        normal, right, spreads = _equations(tree, found, points)
        count = min(rules.moves / len(points), 1.0)
        normal, right = count * normal, count * right
        _add_priors(first, tree, normal, right, rules)
        step = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        tree = _moved(tree, step, spreads, rules)
        if np.abs(step).max() < rules.done:
            break
    return tree


def _solved(tree: KinematicTree, points: Floats) -> Kinematics:
    variance = np.array([marker.spread**2 + KINEMATICS.noise**2 for marker in tree.markers])
    return solve_points(tree, points, np.tile(1.0 / variance, (len(points), 1)), 100.0, rules=replace(KINEMATICS, smooth=False))


def _equations(tree: KinematicTree, found: Kinematics, points: Floats) -> tuple[Floats, Floats, Floats]:
    """The normal equations of joints and places (G, G), their right side (G,), and the spread that each marker shows (M,) m."""
    arrays, bones, markers = tree.arrays, len(tree.bones), len(tree.markers)
    size, numbers = 3 * (bones + markers), ROOT + len(tree.coordinates)
    normal, right = np.zeros((size, size)), np.zeros(size)
    squares, freedom = np.full(markers, 1e-12), np.full(markers, 1e-9)
    variance = np.array([marker.spread**2 + KINEMATICS.noise**2 for marker in tree.markers])
    hangs = _hangs(tree)
    # (M, N) whether a marker moves with an entry, and (N, D) which number of a step the entry is.
    of_entry = np.repeat(np.arange(bones), np.diff(arrays.entry_starts))
    with_entry = hangs[arrays.bones][:, of_entry]
    numbered = np.eye(numbers)[arrays.numbers]
    known = np.concatenate([np.zeros(ROOT), arrays.precision])
    turned, _ = found.posed
    model = found.marker_positions
    for t in range(len(points)):
        seen = np.nonzero(np.isfinite(points[t, :, 0]))[0]
        if len(seen) < 3:
            continue
        # The same weights as the poses have.
        weight = (KINEMATICS.tails + 3.0) / (KINEMATICS.tails + found.misses[t, seen] ** 2 / variance[seen]) / variance[seen]
        twists = _twists(tree, found, t)
        swept = twists[:, 3:] + np.cross(twists[None, :, :3], (model[t, seen] - found.places[t])[:, None])
        pose = np.einsum("snx,nd->sxd", swept * with_entry[seen][:, :, None], numbered).reshape(-1, numbers)
        own = np.zeros((len(seen), 3, bones + markers, 3))
        own[:, :, 1:bones] = hangs[arrays.bones[seen], None, 1:, None] * turned[t, arrays.parents[1:]].swapaxes(0, 1)
        own[np.arange(len(seen)), :, bones + seen] = turned[t, arrays.bones[seen]]
        flat, away, weights = own.reshape(-1, size), (points[t, seen] - model[t, seen]).ravel(), np.repeat(weight, 3)
        inner = pose.T @ (weights[:, None] * pose) + np.diag(known + KINEMATICS.ridge)
        crossed = pose.T @ (weights[:, None] * flat)
        # What is known of the pose pulls, too, and its pull is part of the equations.
        pulled = pose.T @ (weights * away)
        pulled[ROOT:] -= arrays.precision * (found.coordinates[t] - arrays.usual)
        solved = np.linalg.solve(inner, np.column_stack([crossed, pulled, pose.T]))
        normal += flat.T @ (weights[:, None] * flat) - crossed.T @ solved[:, :size]
        right += flat.T @ (weights * away) - crossed.T @ solved[:, size]
        used = weights * np.einsum("nd,dn->n", pose, solved[:, size + 1 :])
        # Of a marker's squares the pose takes a share; the spread is of what remains.
        squares[seen] += weight * variance[seen] * (away.reshape(-1, 3) ** 2).sum(axis=1)
        freedom[seen] += np.maximum(3.0 - used.reshape(-1, 3).sum(axis=1), 0.1)
    return normal, right, np.asarray(np.sqrt(squares / freedom), dtype=np.float64)


def _hangs(tree: KinematicTree) -> np.ndarray:
    """(B, B) whether a bone is another one or hangs on it."""
    hangs = np.eye(len(tree.bones), dtype=np.bool_)
    for bone, parent in enumerate(tree.arrays.parents[1:], start=1):
        hangs[bone] |= hangs[parent]
    return hangs


def _twists(tree: KinematicTree, found: Kinematics, t: int) -> Floats:
    """(N, 6) how the bones of a frame move, see `pose_tree`."""
    arrays, bones = tree.arrays, len(tree.bones)
    turned, joints, twists = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((len(arrays.numbers), 6))
    pose_tree(arrays, found.coordinates[t], found.turns[t], found.places[t], turned, joints, twists)
    return twists


def _add_priors(first: KinematicTree, tree: KinematicTree, normal: Floats, right: Floats, rules: PersonRules) -> None:
    """What is known of joints and places beforehand, added in place."""
    bones = len(tree.bones)
    # A joint's own place on its bone is the bone's origin.
    places = np.repeat([1e-5 if marker.name in _JOINT_COLUMNS else rules.place for marker in tree.markers], 3)
    for precision, before, now, start in (
        (rules.joint**-2.0, first.arrays.offsets, tree.arrays.offsets, 0),
        (places**-2.0, first.arrays.places, tree.arrays.places, 3 * bones),
    ):
        rows = np.arange(start, start + now.size)
        normal[rows, rows] += precision
        right[rows] -= precision * (now - before).ravel()
    # The two sides are about mirror images of each other.
    names = tree.bone_names
    mirror = np.array([1.0, -1.0, 1.0])
    for b, name in enumerate(names):
        other = name.replace("left ", "right ", 1)
        if other == name or other not in names or not tree.bones[b].parent:
            continue
        o = names.index(other)
        for k in range(3):
            i, j = 3 * b + k, 3 * o + k
            apart = tree.arrays.offsets[b, k] - mirror[k] * tree.arrays.offsets[o, k]
            precision = rules.alike**-2.0
            normal[i, i] += precision
            normal[j, j] += precision
            normal[i, j] -= precision * mirror[k]
            normal[j, i] -= precision * mirror[k]
            right[i] -= precision * apart
            right[j] += precision * mirror[k] * apart


def _moved(tree: KinematicTree, step: Floats, spreads: Floats, rules: PersonRules) -> KinematicTree:
    bones = len(tree.bones)
    # Two centimetres at once: beyond that the equations say little.
    steps = np.clip(step, -0.02, 0.02).reshape(-1, 3)
    believed = np.sqrt(0.5 * (spreads**2 + rules.spread**2))
    believed[[marker.name in _JOINT_COLUMNS for marker in tree.markers]] = rules.centre
    moved = [replace(bone, offset=bone.offset + by) for bone, by in zip(tree.bones[1:], steps[1:bones], strict=True)]
    worn = [
        replace(marker, place=_point(np.array(marker.place) + by), spread=float(spread))
        for marker, by, spread in zip(tree.markers, steps[bones:], believed, strict=True)
    ]
    return replace(tree, bones=(tree.bones[0], *moved), markers=tuple(worn))
