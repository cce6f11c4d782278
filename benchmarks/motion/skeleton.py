"""Inverse kinematics against OpenSim's own, and against the bones of simulated people whose skin moves; its speed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from time import process_time
from xml.etree import ElementTree

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

import asterism
from asterism.motion.joints import fit_joint
from asterism.motion.rigid import estimate_limb_motion
from asterism.recording import Recording
from asterism.skeleton import Kinematics, KinematicsRules, fit_person, load_osim, solve_kinematics
from asterism.skeleton.inverse_kinematics import solve_points
from asterism.skeleton.osim_file import with_coordinate_weights
from asterism.skeleton.tree import Coordinate, JointMotion, KinematicTree, TreeBone, TreeMarker
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure

SEED = 20261126
PEOPLE = 12
RATE = 100.0
SKIN_M = 0.010
"""RMS of a marker about its place on the bone."""


def opensim_ik(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The walk of Gait2354 with the model, weights and coordinate tasks of OpenSim's own setup: RMS by coordinate; frames a second."""
    at = folder() / "gait-events" / "opensim"
    setup = ElementTree.parse(at / "subject01_Setup_IK.xml").getroot()
    # Weight 1 is a marker of 1 cm; only their ratios matter.
    markers, coordinates = (
        {task.get("name", ""): 1e4 * float(task.findtext("weight", "0")) for task in setup.iter(f"IK{kind}Task")}
        for kind in ("Marker", "Coordinate")
    )
    tree = with_coordinate_weights(load_osim(at / "subject01_simbody.osim"), coordinates)
    # The model's room is that of the file, y up, and needs no turning.
    walk = replace(asterism.read(at / "subject01_walk1.trc", markers=None), vertical=np.array([0.0, 0.0, 1.0]))
    table = (at / "subject01_walk1_ik.mot").read_text(encoding="utf-8").partition("endheader\n")[2].splitlines()
    names, theirs = table[0].split(), np.array([line.split() for line in table[1:] if line.strip()], dtype=np.float64)
    rules = KinematicsRules(tails=0.0, smooth=False)
    for title, chosen in (("frame by frame", rules), ("smoothed", replace(rules, smooth=True))):
        found = solve_kinematics(tree, walk, weights=markers, rules=chosen)
        frames = np.abs(walk.times[:, None] - theirs[:, 0]).argmin(axis=0)
        off = np.array(
            [
                np.sqrt(np.mean((np.degrees(found.coordinates[frames, i]) - theirs[:, names.index(c.name)]) ** 2))
                for i, c in enumerate(tree.coordinates)
                if not c.slides
            ]
        )
        row = f"inverse kinematics of Gait2354, {title}"
        yield Figure(f"{row}: largest RMS of a coordinate to OpenSim's", "<= 1", float(off.max()), "degrees", len(frames))
        begun = process_time()
        for _ in range(1 if benchmark.quick else 5):
            solve_kinematics(tree, walk, weights=markers, rules=chosen)
        taken = (process_time() - begun) / (1 if benchmark.quick else 5)
        yield Figure(f"{row}: frames a second of one core", "none", len(walk) / taken, "frames/s", len(walk))


def kinematics_speed(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """26 segments with three coordinates each below a free root, three markers on each, smoothed, a tenth of the markers missing."""
    rng = np.random.default_rng(SEED)
    # Five chains from the root, as limbs and trunk are.
    bones = [TreeBone("0", "", np.zeros(3))]
    for n in range(1, 26):
        above = "0" if n % 5 == 1 else str(n - 1)
        turns = tuple(JointMotion(axis, f"{n} {i}") for i, axis in enumerate(((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))))
        bones.append(TreeBone(str(n), above, rng.normal(0, 0.2, 3), turns))
    coordinates = tuple(Coordinate(motion.coordinate, 0.0, 0.6, -1.5, 1.5) for bone in bones for motion in bone.motions)
    places = rng.normal(0, 0.07, (26, 3, 3)).tolist()
    markers = tuple(TreeMarker(f"{bone.name}-{i}", bone.name, tuple(places[b][i])) for b, bone in enumerate(bones) for i in range(3))
    tree, frames = KinematicTree(tuple(bones), coordinates, markers), 200 if benchmark.quick else 2000
    time = np.arange(frames)[:, None] / RATE
    swings = 0.4 * np.sin(2 * np.pi * (rng.uniform(0.3, 1.5, 75) * time + rng.uniform(0, 1, 75)))
    still = Kinematics(
        tree, swings, np.tile(np.eye(3), (frames, 1, 1)), np.column_stack([time, 0 * time, 0 * time]), np.empty(0), np.empty(0),
        np.ones(frames, dtype=np.bool_), RATE, np.array([0.0, 0.0, 1.0]), 1.0,
    )  # fmt: skip
    points = still.marker_positions + rng.normal(0, 0.003, (frames, len(markers), 3))
    points[rng.random(points.shape[:2]) < 0.1] = np.nan
    weights = np.full(points.shape[:2], 1e4)
    solve_points(tree, points[:50], weights[:50], RATE)
    begun = process_time()
    found = solve_points(tree, points, weights, RATE)
    taken = process_time() - begun
    row = "inverse kinematics of 26 segments, 81 numbers"
    yield Figure(f"{row}: frames a second of one core", ">= 1000", frames / taken, "frames/s", frames)
    off = np.degrees(np.sqrt(np.mean((found.coordinates - swings) ** 2)))
    yield Figure(f"{row}: RMS of a coordinate, 3 mm of noise", "none", float(off), "degrees", frames)


@dataclass(frozen=True)
class Walker:
    """A simulated person: standing and walking recordings; by segment the true (T, 3, 3) axes and (T, 3) m origins of both, in order."""

    static: Recording
    walk: Recording
    axes: dict[str, np.ndarray]
    origins: dict[str, np.ndarray]
    on: dict[str, str]


_PARENTS = {f"{side} {name}": "pelvis" if name == "thigh" else f"{side} {above}" for side in ("left", "right")
            for name, above in (("thigh", ""), ("shank", "thigh"), ("foot", "shank"))}  # fmt: skip
_SPOTS = {
    "thigh": {"TH1": (0.05, 0.08, 0.4), "TH2": (-0.01, 0.09, 0.42), "TH3": (-0.01, 0.085, 0.63), "TH4": (0.05, 0.07, 0.6),
              "FLE": (0.0, 0.05, 1.0)},
    "shank": {"SK1": (0.04, 0.05, 0.37), "SK2": (-0.03, 0.06, 0.4), "SK3": (-0.03, 0.05, 0.56), "SK4": (0.03, 0.05, 0.53),
              "FAL": (0.0, 0.035, 1.0)},
    "foot": {"FCC": (-0.055, 0.0, 0.055), "FM1": (0.125, -0.04, 0.06), "FM2": (0.135, 0.01, 0.055), "FM5": (0.105, 0.06, 0.06)},
}  # fmt: skip
"""Where the markers of CAST sit: m ahead, outwards; and below the upper joint, of thigh and shank as a share of their length."""


def walker(number: int) -> Walker:
    """Stand for half a second, then walk five strides; nothing of it is from the skeleton that is fitted to it.

    Hips turn about three axes, knees about an axis that is oblique in the body and also screw and tilt with their flexion, ankles about
    two oblique axes. Skin moves by joint angles and their squares, swings after each strike and drifts; some of it all markers of a segment
    share.
    """
    rng = np.random.default_rng([SEED, number])
    height = rng.uniform(1.5, 1.9)
    thigh, shank, wide = height * rng.normal(0.245, 0.008), height * rng.normal(0.246, 0.008), height * rng.normal(0.052, 0.003)
    frames, stood = 500, 50
    time = np.concatenate([np.zeros(stood), np.arange(frames) / RATE])
    moving = (np.arange(stood + frames) >= stood).astype(float)
    phase = 2 * np.pi * rng.uniform(0.8, 1.1) * time
    origins = {"pelvis": np.column_stack([1.2 * time, 0.02 * np.sin(phase), 0.53 * height + moving * 0.02 * np.cos(2 * phase)])}
    pelvis = moving[:, None] * np.radians([3.0, 2.0, 5.0]) * np.column_stack([np.sin(phase), np.sin(2 * phase), np.sin(phase + 1.0)])
    axes = {"pelvis": Rotation.from_euler("ZXY", np.radians([rng.normal(0, 20), 0, 0]) + pelvis[:, [2, 0, 1]]).as_matrix()}
    on, spots, drive = dict[str, str](), dict[str, np.ndarray](), {"pelvis": np.column_stack([np.sin(phase), np.cos(phase)])}
    # The hip joint lies behind, below and medial of the spine by the shares of Bell et al. (1990), off by 10 mm on each person.
    moved = rng.normal(0, 0.006, 3)
    for name, spot in {"IAS": (0.055, 0.125, 0.075), "IPS": (-0.10, 0.045, 0.085)}.items():
        for letter, sign in (("L", 1.0), ("R", -1.0)):
            placed = (np.array(spot) + moved) * (1.0, sign, 1.0)
            on[letter + name], spots[letter + name] = "pelvis", placed * height / 1.7
    for side, letter, sign, shift in (("left", "L", 1.0, 0.0), ("right", "R", -1.0, np.pi)):
        p = phase + shift
        flexion = np.radians(9.0) + moving * np.radians(21.0) * np.cos(p)
        hip = np.column_stack([-flexion, sign * np.radians(6.0) * moving * np.sin(p), sign * np.radians(7.0) * moving * np.sin(p + 0.6)])
        knee = np.radians(6.0) + moving * np.radians(28.0) * (1.0 + np.sin(p - 2.2)) * (0.6 + 0.4 * np.sin(p - 1.9))
        screw = np.column_stack([sign * 0.05 * knee, sign * 0.12 * np.sin(knee)])
        askew = Rotation.from_rotvec(np.radians([2.0, 0.0, 4.0]) * rng.normal(size=3))
        bent = askew * Rotation.from_euler("YXZ", np.column_stack([knee, screw])) * askew.inv()
        ankle = moving * np.radians(12.0) * np.sin(p + 2.6)
        tilted = Rotation.from_rotvec(np.radians([8.0, 0.0, sign * 8.0]))
        foot = tilted * Rotation.from_euler("YX", np.column_stack([ankle, sign * 0.3 * ankle])) * tilted.inv()
        axes[f"{side} thigh"] = axes["pelvis"] @ Rotation.from_euler("YXZ", hip).as_matrix()
        axes[f"{side} shank"] = axes[f"{side} thigh"] @ bent.as_matrix()
        axes[f"{side} foot"] = axes[f"{side} shank"] @ foot.as_matrix()
        origins[f"{side} thigh"] = origins["pelvis"] + axes["pelvis"] @ np.array([0.0, sign * wide, 0.0])
        origins[f"{side} shank"] = origins[f"{side} thigh"] - thigh * axes[f"{side} thigh"][:, :, 2]
        origins[f"{side} foot"] = origins[f"{side} shank"] - shank * axes[f"{side} shank"][:, :, 2]
        drive |= {f"{side} thigh": np.column_stack([flexion, knee]), f"{side} shank": np.column_stack([knee, ankle])}
        drive[f"{side} foot"] = np.column_stack([ankle, knee])
        for part, length in (("thigh", thigh), ("shank", shank), ("foot", height / 1.7)):
            for name, (ahead, out, down) in _SPOTS[part].items():
                on[letter + name] = f"{side} {part}"
                spots[letter + name] = np.array([ahead * height / 1.7, sign * out * height / 1.7, -down * length])
    labels, positions = tuple(on), np.empty((len(time), len(on), 3))
    strikes = np.concatenate([[0.0], np.diff(np.floor(phase / np.pi)) > 0])
    shared = {segment: _skin(rng, own, strikes) for segment, own in drive.items()}
    for m, name in enumerate(labels):
        segment = on[name]
        skin = 0.6 * shared[segment] + 0.8 * _skin(rng, drive[segment], strikes)
        # 10 mm of movement about where it is in the standing trial.
        skin = moving[:, None] * (skin - skin[stood - 1])
        skin *= SKIN_M / np.sqrt((skin[stood:] ** 2).sum(axis=1).mean())
        at = spots[name] + rng.normal(0, 0.006, 3) + skin
        positions[:, m] = origins[segment] + np.einsum("tij,tj->ti", axes[segment], at)
    positions += rng.normal(0, 0.0005, positions.shape)
    static, walk = (
        Recording(positions[part], labels, RATE, metadata={"file": f"walker {number}"}) for part in (slice(stood), slice(stood, None))
    )
    return Walker(static, walk, axes, origins, on)


def _skin(rng: np.random.Generator, drive: np.ndarray, strikes: np.ndarray) -> np.ndarray:
    """(T, 3) how skin moves, RMS 1 by part: with angles and their squares, after strikes, and slowly by itself."""
    driven = np.column_stack([drive, drive**2]) @ rng.normal(size=(4, 3))
    ring = np.arange(40) / RATE
    ringing = np.exp(-ring / 0.06) * np.sin(2 * np.pi * rng.uniform(5.0, 12.0) * ring)
    struck = np.convolve(strikes, ringing)[: len(strikes), None] * rng.normal(size=3)
    drifting = gaussian_filter1d(rng.normal(size=(len(drive), 3)), 30.0, axis=0)
    out = np.zeros((len(drive), 3))
    for part, share in ((driven, 1.0), (struck, 0.4), (drifting, 0.4)):
        out += share * part / max(float(np.sqrt(((part - part.mean(axis=0)) ** 2).sum(axis=1).mean())), 1e-9)
    return out


def skeleton(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Joint rotations since the standing trial and joint centres of simulated people, against SVD per segment and frame with SCoRE."""
    people = [walker(number) for number in range(2 if benchmark.quick else PEOPLE)]
    found = [_errors(one) for one in people]
    count = sum(len(one.walk) for one in people)
    for name, asked in (("hip", "none"), ("knee", "none"), ("ankle", "none"), ("all joints", "<= 0.8")):
        ours, theirs = (np.sqrt(np.mean([own[name][which] ** 2 for own in found])) for which in (0, 1))
        row = f"10 mm of soft tissue, rotation of {name}, RMS of each axis"
        yield Figure(f"{row}: skeleton", "none", float(np.degrees(ours)), "degrees", count)
        yield Figure(f"{row}: ratio to SVD per frame", asked, float(ours / theirs), "ratio", count)
    for name in ("hip centre", "knee centre"):
        ours, theirs = (1000 * np.sqrt(np.mean([own[name][which] ** 2 for own in found])) for which in (0, 1))
        yield Figure(f"10 mm of soft tissue, {name}, RMS distance: skeleton", "none", float(ours), "mm", count)
        yield Figure(f"10 mm of soft tissue, {name}: ratio to SCoRE", "none", float(ours / theirs), "ratio", count)
    within = np.concatenate([own["within"][0] for own in found])
    yield Figure(
        "10 mm of soft tissue: knee flexion within 2 of its standard deviations", "none", float(within.mean()), "fraction", len(within)
    )
    stretch = max(float(own["stretch"][0]) for own in found)
    yield Figure("length of a bone over time: largest change", "<= 1e-9", stretch, "m", count)


def _errors(one: Walker) -> dict[str, np.ndarray]:
    """(2,) RMS of ours and of the peers', rad and m."""
    person = fit_person([one.static], [one.walk])
    moves, stands = (solve_kinematics(person.tree, recording) for recording in (one.walk, one.static))
    at = person.tree.bone_names.index
    stood = len(one.static)
    both = np.concatenate([one.static.positions, one.walk.positions])
    limbs = {
        segment: estimate_limb_motion(both[:, [m for m, name in enumerate(one.walk.labels) if one.on[name] == segment]], "svd")
        for segment in one.axes
    }
    squares: dict[str, list[np.ndarray]] = {}
    within, stretch = list[np.ndarray](), 0.0
    for child, parent in _PARENTS.items():
        truth = _since(one.axes[parent], one.axes[child], stood)
        peer = _since(limbs[parent].rotations, limbs[child].rotations, stood)
        turned = [np.concatenate([part.posed[0][:, at(name)] for part in (stands, moves)]) for name in (parent, child)]
        ours = _since(turned[0], turned[1], stood)
        joint = {"thigh": "hip", "shank": "knee", "foot": "ankle"}[child.split()[1]]
        errors = [((truth.inv() * each).as_rotvec() ** 2).mean() for each in (ours, peer)]
        squares.setdefault(joint, []).append(np.array(errors))
        squares.setdefault("all joints", []).append(np.array(errors))
        centre = np.concatenate([part.posed[1][:, at(child)] for part in (stands, moves)])
        if joint != "ankle":
            middle = np.nanmean(both[:, [m for m, name in enumerate(one.walk.labels) if one.on[name] in (parent, child)]], axis=1)
            score = fit_joint(limbs[parent], limbs[child], near=middle).centres(limbs[parent], limbs[child])
            off = [((each - one.origins[child])[stood:] ** 2).sum(axis=1).mean() for each in (centre, score)]
            squares.setdefault(f"{joint} centre", []).append(np.array(off))
        if joint == "knee":
            flexion = truth.as_rotvec()[:, 1]
            column = [c.name for c in person.tree.coordinates].index(f"{child.split()[0]} knee flexion")
            told = moves.coordinates[:, column] - np.median(stands.coordinates[:, column])
            within.append(np.abs(told - flexion) < 2.0 * moves.sd[:, 6 + column])
            lengths = np.linalg.norm(moves.posed[1][:, at(child.replace("shank", "foot"))] - moves.posed[1][:, at(child)], axis=1)
            stretch = max(stretch, float(np.ptp(lengths)))
    out = {name: np.sqrt(np.mean(own, axis=0)) for name, own in squares.items()}
    return out | {"within": np.array([np.concatenate(within)]), "stretch": np.array([stretch])}


def _since(parent: np.ndarray, child: np.ndarray, stood: int) -> Rotation:
    """How the child has turned in the parent since the standing trial, in each frame of the walk."""
    turned = Rotation.from_matrix(parent.swapaxes(1, 2) @ child)
    return turned[stood:] * turned[:stood].mean().inv()
