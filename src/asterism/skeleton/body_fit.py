"""Labelled recordings in; a body model of the people in them out: segments, capsules, marker places, and how the joints move."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import fit_rigid, rotate_z_up
from asterism.recording import Floats, MarkerSet, Recording, canonical, is_unnamed, plain_name, without_subject
from asterism.skeleton import anatomy
from asterism.skeleton.arrays import PosePrior
from asterism.skeleton.body import ArticulatedBody, BodyMarker, Hinge, as_point
from asterism.skeleton.body_file import load_body, shipped_bodies
from asterism.skeleton.pose_kernels import HINGES, PLACE, fit_positions, place_bones

_ASIS_HEIGHT = 0.555
"""Height of the front of the pelvis as a share of stature, near the tables of Drillis and Contini (1966) for the hip (0.530)."""


@dataclass(frozen=True)
class BodyFitRules:
    """How bodies are learned. Round numbers; the last three were chosen on the simulated walks of `simulation`, not on recordings.

    noise           m, of measured positions
    steps           tries of Levenberg-Marquardt for each frame
    frames          frames of each recording that count, evenly spread
    rounds          how often places and poses take turns
    spread_share    standard deviation of a marker's place as a multiple of what was seen: few people show little of it
    least_spread    m, of a marker's place
    people_spread   m, of a marker's place on other people, beside what is seen, where only one person is known
    hinge_share     standard deviation of an angle as a multiple of what was seen
    least_angle     rad, smallest standard deviation of an angle
    sway            m, most that the median marker moves while somebody stands (standard deviation): swaying is 0.01, walking 0.1 in 0.5 s
    stand           s, for which somebody must stand
    poses           poses from which starts begin
    """

    noise: float = 0.004
    steps: int = 30
    frames: int = 40
    rounds: int = 2
    spread_share: float = 1.3
    least_spread: float = 0.008
    people_spread: float = 0.012
    hinge_share: float = 1.4
    least_angle: float = 0.1
    sway: float = 0.03
    stand: float = 0.5
    poses: int = 5


RULES = BodyFitRules()


def fit_body(
    standing: Sequence[Recording],
    moving: Sequence[Recording] = (),
    *,
    markers: MarkerSet | Sequence[str] | None = None,
    people: Sequence[str] = (),
    title: str = "body",
    height: float | None = None,
    rules: BodyFitRules = RULES,
) -> ArticulatedBody:
    """A body model of one person, or the mean of several.

    standing  one standing trial of each person, upright; labels by their usual names (Helen Hayes, Plug-in Gait, Oxford foot)
    moving    trials in which these or other people move, from which hinges' usual angles, marker spreads and starting poses are
              learned; `people` names the person of each standing and then of each moving trial. Without them hinges keep textbook ranges
    markers   which; by default all labelled ones that every standing trial has
    height    m, of the person or the mean one; by default from the height of the pelvis

    Markers with unknown names are put on the bone whose capsule is nearest. Markers of bones that the body lacks do not count.
    Raises AsterismError where no trial is given, or a needed marker is absent.
    """
    if not standing:
        raise AsterismError("a body is fitted to a standing trial; give one.")
    posed = [_upright(recording, rules) for recording in standing]
    wanted = None if markers is None else (markers if isinstance(markers, MarkerSet) else MarkerSet(tuple(markers)))
    names = _common_names(standing, posed, wanted)
    sizes = np.array([_asis_height(places) for places in posed])
    mean_size = float(np.mean(sizes))
    everything = sorted(set.intersection(*(set(places) for places in posed)))
    # People of all sizes are scaled to the mean one before their markers are averaged.
    mean = {
        name: np.mean([places[name] * (mean_size / size) for places, size in zip(posed, sizes, strict=True)], axis=0) for name in everything
    }
    body = _rest_body(mean, names, title, mean_size / _ASIS_HEIGHT if height is None else height)
    if wanted is not None:
        body = replace(body, aliases={name: tuple(spelled) for name, spelled in wanted.aliases.items() if name in body.labels})
    given = tuple(people) or tuple(str(i) for i in range(len(standing) + len(moving)))
    if len(given) != len(standing) + len(moving):
        raise AsterismError(f"{len(given)} people are named for {len(standing) + len(moving)} recordings; name one for each.")
    # One standing trial shows no movement and no second person: the person's own size and places are all that is known.
    if len(standing) == 1 and not moving:
        return replace(_moving_as_usual(body, rules), scale_spread=(0.03, 0.01))
    return _learned(body, [*standing, *moving], given, bool(moving), rules)


def _moving_as_usual(body: ArticulatedBody, rules: BodyFitRules) -> ArticulatedBody:
    """The body with spreads, usual angles and poses of the shipped body that has most of its markers: one trial does not show them."""
    shipped = max((load_body(name) for name in shipped_bodies()), key=lambda each: _in_common(each, body))
    markers = {canonical(marker.name): marker.spread for marker in shipped.markers}
    number = {hinge.name: j for j, hinge in enumerate(shipped.hinges)}

    def usual(hinge: Hinge) -> Hinge:
        if hinge.name not in number:
            return hinge
        known = shipped.hinges[number[hinge.name]]
        return replace(hinge, usual=min(max(known.usual, hinge.low), hinge.high), spread=known.spread)

    bones = tuple(replace(bone, hinges=tuple(usual(hinge) for hinge in bone.hinges)) for bone in body.bones)
    hinges = [hinge for bone in bones for hinge in bone.hinges]
    poses = {
        name: tuple(angles[number[hinge.name]] if hinge.name in number else hinge.usual for hinge in hinges)
        for name, angles in shipped.poses.items()
    }
    # Markers that no shipped body has move on the skin as those do that are known least.
    spreads = [markers.get(canonical(marker.name), rules.people_spread) for marker in body.markers]
    worn = tuple(replace(marker, spread=spread) for marker, spread in zip(body.markers, spreads, strict=True))
    return replace(body, bones=bones, markers=worn, poses=poses)


def _in_common(one: ArticulatedBody, other: ArticulatedBody) -> float:
    """The markers that two bodies share, as a share of all that either has."""
    mine, theirs = ({canonical(name) for name in body.labels} for body in (one, other))
    return len(mine & theirs) / len(mine | theirs)


def _standing(points: Floats, rate: float, rules: BodyFitRules, where: str) -> Floats:
    """The frames (T', M, 3) around which somebody stands still in a trial (T, M, 3) m. Raises AsterismError where nobody does."""
    count = min(max(round(rules.stand * rate), 2), len(points))
    if count < 2:
        return points
    starts = range(0, len(points) - count + 1, max(count // 2, 1))
    # The scatter of a marker within a window; the median over markers, since an arm may move.
    with np.errstate(invalid="ignore"):
        moved = np.array([np.nanmedian(np.sqrt(np.nansum(np.nanvar(points[s : s + count], axis=0), axis=1))) for s in starts])
    still = moved <= rules.sway
    if not still.any():
        raise AsterismError(
            f"{where}: nobody stands still in it: the markers move by {100 * np.nanmin(moved):.0f} cm or more in {rules.stand:g} s; "
            "give a standing trial, and this one as --moving."
        )
    # The stillest window, and all others that are as still as a person who stands.
    chosen = np.zeros(len(points), dtype=np.bool_)
    for s in np.array(starts)[still]:
        chosen[s : s + count] = True
    return points[chosen]


def _upright(recording: Recording, rules: BodyFitRules) -> dict[str, Floats]:
    """Mean places (3,) m of the labelled markers in the axes of a rest pose, by canonical names. Raises as `_standing`."""
    # The body faces along x with its left at y, whichever way the person stood.
    where = str(recording.metadata.get("file", "the recording"))
    points = _standing(rotate_z_up(recording.positions, recording.vertical), recording.rate, rules, where)
    some = np.asarray(np.isfinite(points[:, :, 0]).any(axis=0))
    middle = np.full(points.shape[1:], np.nan)
    middle[some] = np.nanmedian(points[:, some], axis=0)
    places = {plain_name(label): middle[i] for i, label in enumerate(recording.labels) if some[i] and not is_unnamed(label)}
    front = [places.get("lasi"), places.get("rasi")]
    backs = [places[name] for name in ("sacr", "lpsi", "rpsi") if name in places]
    if front[0] is None or front[1] is None or not backs:
        raise AsterismError(f"{where}: a body needs the pelvis' markers (LASI, RASI, and SACR or LPSI and RPSI); label them.")
    left = (front[0] - front[1]) * np.array([1.0, 1.0, 0.0])
    left /= np.linalg.norm(left)
    axes = np.array([[left[1], -left[0], 0.0], left, [0.0, 0.0, 1.0]])
    origin = 0.5 * (0.5 * (front[0] + front[1]) + np.mean(backs, axis=0))
    # The floor is a marker's radius below the lowest marker.
    known = [place for name, place in places.items() if anatomy.bone_of(name) is not None]
    origin[2] = min(place[2] for place in known) - 0.015
    return {name: axes @ (place - origin) for name, place in places.items()}


def _asis_height(places: Mapping[str, Floats]) -> float:
    return float(0.5 * (places["lasi"][2] + places["rasi"][2]))


def _common_names(standing: Sequence[Recording], posed: Sequence[Mapping[str, Floats]], wanted: MarkerSet | None) -> tuple[str, ...]:
    """The markers that the body gets: those wanted, or the physical ones that all standing trials have. Raises AsterismError."""
    first = [without_subject(label) for label in standing[0].labels if not is_unnamed(label)]
    spelled = {canonical(label): label for label in first}
    if wanted is None:
        # Several trials must agree in what a marker is; an unknown name of one trial is taken as it is worn.
        names = [spelled[key] for key in spelled if all(key in places for places in posed)]
        known = [name for name in names if anatomy.bone_of(name) is not None]
        return tuple(known if len(standing) > 1 else names)
    for recording, places in zip(standing, posed, strict=True):
        for name in wanted.names:
            if canonical(name) not in places:
                column = next((label for label in recording.labels if wanted.name_of(label) == name), None)
                if column is None or plain_name(column) not in places:
                    raise AsterismError(f"{recording.metadata.get('file', 'the recording')}: there is no marker {name}; label it.")
                places[canonical(name)] = places[plain_name(column)]  # type: ignore[index]
    return wanted.names


def _rest_body(mean: Mapping[str, Floats], names: Sequence[str], title: str, height: float) -> ArticulatedBody:
    joints = anatomy.joints_of(mean)
    worn = {bone for name in names if (bone := anatomy.bone_of(name)) is not None}
    bones = anatomy.bones_of(joints, worn)
    capsules = anatomy.capsules_of(joints, bones)
    markers = []
    for name in names:
        place = mean[canonical(name)]
        bone = anatomy.bone_of(name) or min(capsules, key=lambda part: _outside(place, part.start, part.end, part.radii[0])).bone
        markers.append(BodyMarker(name, bone, as_point(place)))
    return ArticulatedBody(title, height, bones, tuple(markers), capsules)


def _outside(place: Floats, start: Sequence[float], end: Sequence[float], radius: float) -> float:
    """How far a place is outside a capsule, m."""
    begin, along = np.array(start), np.array(end) - np.array(start)
    share = float(np.clip((place - begin) @ along / max(along @ along, 1e-12), 0.0, 1.0))
    return float(np.linalg.norm(place - begin - share * along)) - radius


@dataclass(frozen=True, eq=False)
class PosedFrames:
    """A body posed to known markers. poses (T, 9 + J), rotations (T, 3, 3), costs (T,) nats; world axes with z up."""

    poses: Floats
    rotations: Floats
    costs: Floats


def pose_recording(body: ArticulatedBody, positions: Floats, *, scales: Floats | None = None, rules: BodyFitRules = RULES) -> PosedFrames:
    """The poses of a body whose markers' positions (T, M, 3) m are known, z up; each frame starts at the last one's pose.

    scales (3,): the person's, then fixed; by default every frame finds its own. Frames with fewer than four markers are NaN.
    """
    arrays = body.arrays
    size = HINGES + len(body.hinges)
    poses, rotations, costs = (
        np.full((len(positions), size), np.nan),
        np.full((len(positions), 3, 3), np.nan),
        np.full(len(positions), np.nan),
    )
    known = known_of(body, np.array([0.0, 0.0, 1.0]))
    # A given size is not fitted, so the three scales are left out of what is free.
    free = np.array([i for i in range(size) if scales is None or i >= PLACE], dtype=np.int64)
    pose, rotation = np.zeros(size), np.eye(3)
    warm = False
    for t, points in enumerate(positions):
        there = np.isfinite(points[:, 0])
        if there.sum() < 4:
            warm = False
            continue
        # A frame after a gap starts from the rigid fit of the rest pose, since the last pose is too old.
        if not warm:
            rotation, place = fit_rigid(arrays.places[there], points[there])
            pose = np.concatenate([np.ones(3), place, np.zeros(3), arrays.usual])
        if scales is not None:
            pose[:3] = scales
        costs[t] = fit_positions(arrays, known, np.ascontiguousarray(points), rules.noise, rules.steps, free, pose, rotation)
        poses[t], rotations[t] = pose, rotation
        warm = True
    return PosedFrames(poses, rotations, costs)


def known_of(body: ArticulatedBody, vertical: Floats, *, tilt: float = 0.25, scale: tuple[float, float] | None = None) -> PosePrior:
    """What is known of a body before any image: about upright (`tilt` rad), about the model's size."""
    common, single = body.scale_spread if scale is None else scale
    return PosePrior(np.asarray(vertical, dtype=np.float64), np.ones(3), np.array([common**-2.0, single**-2.0]), tilt**-2.0)


def _learned(
    body: ArticulatedBody, recordings: Sequence[Recording], people: Sequence[str], moving: bool, rules: BodyFitRules
) -> ArticulatedBody:
    """The body with mean places of the markers, their spreads, and where there are moving trials the hinges' usual angles and poses."""
    points = [_chosen_positions(recording, body, rules.frames) for recording in recordings]
    who = sorted(set(people))
    # Poses depend on where the markers sit and markers are placed by the poses, so both are found in turns.
    for _ in range(rules.rounds):
        offsets, angles, scales = [], [], []
        for person in who:
            own = [positions for positions, name in zip(points, people, strict=True) if name == person]
            # One size for each person: the median over frames, which single bad fits do not move.
            scale = np.nanmedian(np.concatenate([pose_recording(body, positions, rules=rules).poses[:, :3] for positions in own]), axis=0)
            fits = [pose_recording(body, positions, scales=scale, rules=rules) for positions in own]
            offsets.append(np.concatenate([rest_places(body, fit, positions) for fit, positions in zip(fits, own, strict=True)]))
            angles.append(np.concatenate([fit.poses[:, HINGES:] for fit in fits]))
            scales.append(scale)
        body = _with_offsets(body, offsets, rules)
        if moving:
            body = _with_motion(body, np.concatenate(angles), rules)
        body = _with_sizes(body, np.array(scales))
    return body


def _chosen_positions(recording: Recording, body: ArticulatedBody, most: int) -> Floats:
    columns = MarkerSet(body.labels, aliases=body.aliases).columns_of(recording.labels)
    points = rotate_z_up(recording.positions, recording.vertical)
    chosen = np.unique(np.linspace(0, len(points) - 1, min(most, len(points))).round().astype(np.int64))
    out = np.full((len(chosen), len(columns), 3), np.nan)
    out[:, columns >= 0] = points[chosen][:, columns[columns >= 0]]
    return out


def rest_places(body: ArticulatedBody, fit: PosedFrames, positions: Floats) -> Floats:
    """(T, M, 3) m: where each measured marker sits on its bone, in the rest pose relative to the root's pivot."""
    arrays = body.arrays
    out = np.full(positions.shape, np.nan)
    turned, moved = np.empty((len(body.bones), 3, 3)), np.empty((len(body.bones), 3))
    by_scale, axes, pivots = np.empty((len(body.bones), 3, 3)), np.empty((len(body.hinges), 3)), np.empty((len(body.hinges), 3))
    for t in range(len(positions)):
        if not np.isfinite(fit.poses[t, 0]):
            continue
        place_bones(
            arrays.parents,
            arrays.pivots,
            arrays.hinge_starts,
            arrays.axes,
            fit.poses[t],
            fit.rotations[t],
            turned,
            moved,
            by_scale,
            axes,
            pivots,
        )
        away = positions[t] - moved[arrays.bones]
        out[t] = np.einsum("mik,mi->mk", turned[arrays.bones], away) / fit.poses[t, :3]
    return out


def _with_offsets(body: ArticulatedBody, offsets: Sequence[Floats], rules: BodyFitRules) -> ArticulatedBody:
    means = np.array([np.nanmean(part, axis=0) for part in offsets])
    mean = np.nanmean(means, axis=0)
    # Two kinds of scatter: skin over one person's bones, and hands that place markers differently on each person.
    within = np.nanmean(np.array([np.nanvar(part, axis=0).mean(axis=1) for part in offsets]), axis=0)
    several = len(offsets) > 2
    between = np.nanvar(means, axis=0, ddof=1).mean(axis=1) if several else np.full(len(mean), rules.people_spread**2)
    spread = np.maximum(rules.spread_share * np.sqrt(within + between), rules.least_spread)
    root = np.array(body.bones[0].pivot)
    return replace(
        body,
        markers=tuple(
            replace(marker, place=as_point(place + root), spread=float(each))
            for marker, place, each in zip(body.markers, mean, spread, strict=True)
        ),
    )


def _with_motion(body: ArticulatedBody, angles: Floats, rules: BodyFitRules) -> ArticulatedBody:
    angles = angles[np.isfinite(angles).all(axis=1)]
    spread = np.maximum(rules.hinge_share * angles.std(axis=0), rules.least_angle)
    usual = angles.mean(axis=0)
    place = 0
    bones = []
    for bone in body.bones:
        # Each hinge keeps the range that anatomy allows: what a person showed narrows where it usually is, not what it can do.
        hinges = []
        for hinge in bone.hinges:
            middle = float(np.clip(usual[place], hinge.low, hinge.high))
            hinges.append(replace(hinge, usual=middle, spread=max(float(spread[place]), hinge.spread)))
            place += 1
        bones.append(replace(bone, hinges=tuple(hinges)))
    poses = {f"pose {i + 1}": tuple(float(x) for x in pose) for i, pose in enumerate(_apart(angles / spread, rules.poses) * spread)}
    return replace(body, bones=tuple(bones), poses=poses | _raised_arms(body, usual))


def _raised_arms(body: ArticulatedBody, usual: Floats) -> dict[str, tuple[float, ...]]:
    """Poses with the arms ahead and aside, from which no walk starts; none for a body without arms."""
    poses = {}
    for name, hinge_name, degrees in (("arms ahead", "upper arm raising", 80.0), ("arms aside", "upper arm abduction", 70.0)):
        angles = usual.copy()
        raised = [j for j, hinge in enumerate(body.hinge_names) if hinge.endswith(hinge_name)]
        angles[raised] = np.radians(degrees)
        if raised:
            poses[name] = tuple(float(x) for x in angles)
    return poses


def _apart(points: Floats, count: int) -> Floats:
    """Centres of so many groups of points (n, d): k-means, started at points far from each other. Deterministic. O(n count d)."""
    centres = [points.mean(axis=0)]
    # The next start is the point that no centre is near yet, so that rare poses get a centre of their own.
    for _ in range(count - 1):
        nearest = np.min([((points - centre) ** 2).sum(axis=1) for centre in centres], axis=0)
        centres.append(points[int(np.argmax(nearest))])
    found = np.array(centres)
    for _ in range(20):
        # Lloyd's iterations; twenty are more than such small sets take.
        group = np.argmin(((points[:, None] - found[None]) ** 2).sum(axis=2), axis=1)
        found = np.array([points[group == i].mean(axis=0) if (group == i).any() else found[i] for i in range(count)])
    return found


def _with_sizes(body: ArticulatedBody, scales: Floats) -> ArticulatedBody:
    """People's sizes among those seen; few people show little of it, so it is never below the spread of a usual group."""
    common = scales.mean(axis=1)
    single = (scales - common[:, None]).std() if len(scales) > 2 else 0.04
    return replace(body, scale_spread=(max(0.12, float(common.std())), max(0.04, float(single))))
