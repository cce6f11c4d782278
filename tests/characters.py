"""Characters of any proportions for tests and benchmarks: bones as animation programs name and pose them, without a movement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.geometry import axis_rotations
from asterism.recording import SkeletonMotion
from asterism.skeleton.angles import limited
from asterism.skeleton.build import BuildRules, random_build
from asterism.skeleton.kinematics import on_the_floor, pose
from asterism.skeleton.movements import MOVEMENTS


def character(
    legs: float = 1.0, arms: float = 1.0, size: float = 1.0, spine: int = 3, down: float = 0.0, without: tuple[str, ...] = ()
) -> SkeletonMotion:
    """A figure of 1.75 m with y up that faces z, in a T pose, named as by Mixamo.

    legs, arms  lengths as shares of usual ones
    size        of the whole figure
    spine       bones between hips and neck
    down        degrees by which the arms hang from the T pose
    without     parts that are left out: "toe", "hand", "clavicle", "neck", "head"
    """
    bones: list[tuple[str, str, tuple[float, float, float]]] = [("Hips", "", (0.0, 0.0, 0.0))]
    names = ["Spine", *(f"Spine{i}" for i in range(1, spine))]
    for i, name in enumerate(names):
        bones.append((name, names[i - 1] if i else "Hips", (0.0, 0.10 if not i else 0.28 / max(1, spine - 1), 0.0)))
    chest = names[-1] if names else "Hips"
    if "neck" not in without:
        bones.append(("Neck", chest, (0.0, 0.16, 0.0)))
    if "head" not in without:
        bones.append(("Head", "Neck" if "neck" not in without else chest, (0.0, 0.09, 0.01)))
    cosine, sine = np.cos(np.radians(down)), np.sin(np.radians(down))
    ends: dict[str, tuple[float, float, float]] = {"Head": (0.0, 0.20, 0.0)}
    for side, sign in (("Left", 1.0), ("Right", -1.0)):
        shoulder = chest
        if "clavicle" not in without:
            bones.append((f"{side}Shoulder", chest, (sign * 0.05, 0.13, 0.0)))
            shoulder = f"{side}Shoulder"
        along = np.array([sign * cosine, -sine, 0.0])
        bones.append((f"{side}Arm", shoulder, (sign * (0.13 if "clavicle" not in without else 0.18), 0.0, 0.0)))
        bones.append((f"{side}ForeArm", f"{side}Arm", tuple(0.28 * arms * along)))
        if "hand" not in without:
            bones.append((f"{side}Hand", f"{side}ForeArm", tuple(0.26 * arms * along)))
        ends[f"{side}Hand" if "hand" not in without else f"{side}ForeArm"] = tuple(0.17 * along)
        bones.append((f"{side}UpLeg", "Hips", (sign * 0.09, -0.05, 0.0)))
        bones.append((f"{side}Leg", f"{side}UpLeg", (0.0, -0.44 * legs, 0.005)))
        bones.append((f"{side}Foot", f"{side}Leg", (0.0, -0.43 * legs, -0.01)))
        if "toe" not in without:
            bones.append((f"{side}ToeBase", f"{side}Foot", (sign * 0.01, -0.07, 0.13)))
            ends[f"{side}ToeBase"] = (0.0, 0.0, 0.07)
        else:
            ends[f"{side}Foot"] = (0.0, -0.07, 0.17)
    order = [name for name, _, _ in bones]
    parents = tuple(order.index(parent) if parent else -1 for _, parent, _ in bones)
    offsets = size * np.array([offset for _, _, offset in bones])
    tips = size * np.array([ends.get(name, (np.nan,) * 3) for name in order])
    rotations = np.tile(np.eye(3), (1, len(order), 1, 1))
    root = np.array([[0.0, size * (0.05 + 0.87 * legs + 0.07), 0.0]])
    return SkeletonMotion(tuple(order), parents, offsets, tips, rotations, root, 30.0, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))


def virtual_person(movement: str = "walk", seconds: float = 2.4, seed: int = 1, rate: float = 100.0) -> SkeletonMotion:
    """A virtual person of 1.70 m who moves over the floor, z up, facing x: the skeleton of the house, with feet of one bone."""
    rng = np.random.default_rng(seed)
    build = random_build(rng, 1.70, BuildRules(proportion=0.0, asymmetry=0.0, short_limb=0.0))
    done = MOVEMENTS[movement](np.arange(int(seconds * rate)) / rate, rng)
    segments = pose(build, limited(done.angles))
    path = on_the_floor(segments.touch, rate)
    path[:, 2] += done.above
    order = ["pelvis", "thorax", "head"]
    hangs = {"pelvis": "", "thorax": "pelvis", "head": "thorax"}
    for side in ("left", "right"):
        for part, above in (
            ("clavicle", "thorax"),
            ("upper arm", "clavicle"),
            ("forearm", "upper arm"),
            ("hand", "forearm"),
            ("thigh", "pelvis"),
        ):
            order.append(f"{side} {part}")
            hangs[order[-1]] = above if above in ("thorax", "pelvis") else f"{side} {above}"
        for part, above in (("shank", "thigh"), ("foot", "shank")):
            order.append(f"{side} {part}")
            hangs[order[-1]] = f"{side} {above}"
    parents = tuple(order.index(hangs[name]) if hangs[name] else -1 for name in order)
    turned = np.stack([segments.axes[name] for name in order], axis=1)
    places = np.stack([segments.origin[name] for name in order], axis=1)
    rotations, offsets = turned.copy(), np.zeros((len(order), 3))
    for b, parent in enumerate(parents[1:], start=1):
        rotations[:, b] = turned[:, parent].swapaxes(1, 2) @ turned[:, b]
        offsets[b] = turned[0, parent].T @ (places[0, b] - places[0, parent])
    tips = {"head": (0.0, 0.0, 0.25), "hand": (0.0, 0.0, -0.17), "foot": (0.19, 0.0, -0.078)}
    ends = np.array([tips.get(name.split(" ")[-1], (np.nan,) * 3) for name in order])
    return SkeletonMotion(tuple(order), parents, offsets, ends, rotations, places[:, 0] + path, rate)


def stepping_person(speed: float = 0.8, seconds: float = 2.4, rate: float = 100.0) -> SkeletonMotion:
    """The bones of `virtual_person` on legs that step: each foot lies flat and still for 0.6 of a cycle of 1.2 s, else it swings."""
    person = virtual_person("stand", seconds, rate=rate)
    time = np.arange(len(person)) / rate
    names, lengths = person.names, person.lengths
    turned = np.tile(np.eye(3), (len(person), len(names), 1, 1))
    root = np.stack([speed * time, np.zeros(len(time)), np.full(len(time), 0.82)], axis=1)
    for side, begin in (("left", 0.0), ("right", 0.6)):
        cycle = (time + begin) / 1.2
        phase, count = cycle % 1.0, np.floor(cycle)
        swing = np.clip((phase - 0.6) / 0.4, 0.0, 1.0)
        ahead = swing - np.sin(2 * np.pi * swing) / (2 * np.pi)
        x = speed * 1.2 * (count + ahead + 0.3 - begin / 1.2) - root[:, 0]
        z = 0.078 + 0.1 * np.sin(np.pi * swing) ** 2 - root[:, 2]
        thigh, shank = (lengths[names.index(f"{side} {part}")] for part in ("thigh", "shank"))
        far = np.hypot(x, z)
        knee = np.pi - np.arccos(np.clip((thigh**2 + shank**2 - far**2) / (2 * thigh * shank), -1, 1))
        hip = np.arctan2(x, -z) + np.arccos(np.clip((thigh**2 + far**2 - shank**2) / (2 * thigh * far), -1, 1))
        turned[:, names.index(f"{side} thigh")] = axis_rotations("y", -hip)
        turned[:, names.index(f"{side} shank")] = axis_rotations("y", knee - hip)
    rotations = turned.copy()
    for b, parent in enumerate(person.parents[1:], start=1):
        rotations[:, b] = turned[:, parent].swapaxes(1, 2) @ turned[:, b]
    return replace(person, rotations=rotations, root=root)
