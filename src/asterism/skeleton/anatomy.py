"""A standing person's markers, by their usual names, in; joint centres, bones with hinges and capsules of the rest pose out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.recording import Floats, canonical
from asterism.skeleton.body import Bone, Capsule, Hinge, Point, as_point

BONE_OF = {
    "pelvis": "LASI RASI SACR LPSI RPSI",
    "thorax": "C7 T2 T6 T10 T12 RBAK CLAV STRN LSHO RSHO LACR RACR",
    "head": "LFHD RFHD LBHD RBHD",
    "upper arm": "UPA UPR ELB ELBM",
    "forearm": "FRM WRA WRB",
    "hand": "FIN",
    "thigh": "THI KNE KNM MKN KNEM MEP",
    "shank": "TIB ANK MMA ANKM MMAL HFB TUB SHN",
    "foot": "HEE TOE PCA CPG LCA STL NAV P1M P5M D1M D5M HLX MT1 MT5 CAL",
}
"""Which bone a marker is on, by its name; of limbs without the first letter, which is the side."""

LIMBS = ("upper arm", "forearm", "hand", "thigh", "shank", "foot")

RADII = {
    "hips": (0.105, 0.105),
    "trunk": (0.105, 0.105),
    "neck": (0.05, 0.05),
    "head": (0.085, 0.085),
    "thigh": (0.078, 0.052),
    "shank": (0.052, 0.038),
    "foot": (0.034, 0.026),
    "upper arm": (0.045, 0.038),
    "forearm": (0.038, 0.028),
    "hand": (0.028, 0.022),
}
"""Capsules' radii (m) of a pelvis `PELVIS_WIDTH` wide: shares of segment girths in textbooks of anthropometry. Not chosen on recordings."""
PELVIS_WIDTH = 0.24
"""m, between the markers on the front of the pelvis of the body that `RADII` are for."""

_HINGES: dict[str, tuple[tuple[str, Point, float, float, float], ...]] = {
    "thorax": (("flexion", (0, 1, 0), 12, -40, 90), ("side", (1, 0, 0), 8, -40, 40), ("twist", (0, 0, 1), 12, -60, 60)),
    "head": (("flexion", (0, 1, 0), 15, -60, 60), ("side", (1, 0, 0), 10, -40, 40), ("twist", (0, 0, 1), 20, -80, 80)),
    "upper arm": (("raising", (0, -1, 0), 35, -70, 180), ("abduction", (1, 0, 0), 25, -60, 170), ("twist", (0, 0, 1), 30, -90, 90)),
    "forearm": (("flexion", (0, -1, 0), 35, 0, 150), ("turn", (0, 0, 1), 30, -110, 110)),
    "hand": (("flexion", (0, -1, 0), 15, -80, 80), ("side", (1, 0, 0), 12, -40, 40)),
    "thigh": (("flexion", (0, -1, 0), 25, -45, 130), ("abduction", (1, 0, 0), 8, -50, 60), ("twist", (0, 0, 1), 10, -50, 50)),
    "shank": (("flexion", (0, 1, 0), 30, -15, 150), ("twist", (0, 0, 1), 6, -30, 30)),
    "foot": (("flexion", (0, -1, 0), 15, -60, 50), ("inversion", (1, 0, 0), 8, -35, 35), ("turn", (0, 0, 1), 8, -35, 35)),
}
"""Hinges of each bone in their order: name, axis on the left, standard deviation, range (degrees). Ranges of motion of textbooks.
The right mirrors the left: abduction and twist there are positive outwards and to the right. How far an elbow extends depends on how it is
bent in the rest pose."""


@dataclass(frozen=True)
class Joints:
    """Joint centres (3,) m of a standing person: x ahead, y left, z up, the pelvis' middle at x = y = 0, the floor at z = 0."""

    places: Mapping[str, Floats]
    pelvis_width: float


def side_of(name: str) -> str:
    """ "left" or "right" for the name of a marker on a limb, else ""."""
    plain = canonical(name)
    known = {canonical(end) for bone in LIMBS for end in BONE_OF[bone].split()}
    return {"l": "left", "r": "right"}.get(plain[:1], "") if plain[1:] in known else ""


def bone_of(name: str) -> str | None:
    """The bone on which a marker of this name usually is ("left thigh"); None for names that are not known."""
    plain = canonical(name)
    for bone, names in BONE_OF.items():
        known = {canonical(each) for each in names.split()}
        if bone in LIMBS and plain[1:] in known and plain[:1] in ("l", "r"):
            return f"{'left' if plain[0] == 'l' else 'right'} {bone}"
        if bone not in LIMBS and plain in known:
            return bone
    return None


def joints_of(markers: Mapping[str, Floats]) -> Joints:
    """Joint centres from the markers (3,) m of a standing person, by canonical names, in the axes of `Joints`.

    Hips by Bell, Pedersen and Brand (1990): 0.36 of the pelvis' width beside, 0.22 behind and 0.30 below the middle of its front. Other
    joints from the markers beside them, or where an upright body usually has them. Raises AsterismError where the pelvis, a knee or an
    ankle cannot be placed.
    """

    def mean(*names: str) -> Floats | None:
        found = [markers[canonical(name)] for name in names if canonical(name) in markers]
        return np.mean(found, axis=0) if found else None

    # The pelvis sets the axes and the size of all that has no marker of its own.
    left_front, right_front, back = mean("LASI"), mean("RASI"), mean("SACR", "LPSI", "RPSI")
    if left_front is None or right_front is None or back is None:
        raise AsterismError("a body needs the pelvis' markers (LASI, RASI, and SACR or LPSI and RPSI); label them.")
    width = float(np.linalg.norm(left_front - right_front))
    size = width / PELVIS_WIDTH
    front = 0.5 * (left_front + right_front)
    middle = 0.5 * (front + back)
    places = {"pelvis": middle, "waist": middle + size * np.array([-0.01, 0.0, 0.09])}
    # Without a marker, the neck and the head stand where they are over an average pelvis, scaled by its width.
    neck = mean("C7", "CLAV")
    neck = middle + size * np.array([-0.02, 0.0, 0.46]) if neck is None else neck + np.array([0.0, 0.0, -0.01])
    head = mean("LFHD", "RFHD", "LBHD", "RBHD")
    places |= {"neck": neck, "head": neck + size * np.array([0.03, 0.0, 0.17]) if head is None else head}
    for side, letter, sign in (("left", "L", 1.0), ("right", "R", -1.0)):
        out = np.array([0.0, sign * size, 0.0])
        places[f"{side} hip"] = front + width * np.array([-0.22, 0.36 * sign, -0.30])
        knee, ankle, heel, toe = (mean(letter + end) for end in ("KNE", "ANK", "HEE", "TOE"))
        inner_knee, inner_ankle = mean(letter + "KNM", letter + "MKN", letter + "KNEM"), mean(letter + "MMA", letter + "ANKM")
        # The inner markers of a limb are often worn in static trials only; without them half a limb's thickness is taken off.
        if knee is None or ankle is None:
            raise AsterismError(f"a body needs {letter}KNE and {letter}ANK; label them.")
        places[f"{side} knee"] = knee - 0.048 * out if inner_knee is None else 0.5 * (knee + inner_knee)
        places[f"{side} ankle"] = ankle - 0.034 * out if inner_ankle is None else 0.5 * (ankle + inner_ankle)
        # Without foot markers a foot stands flat below its ankle.
        flat = places[f"{side} ankle"] * np.array([1.0, 1.0, 0.0])
        places[f"{side} heel"] = flat + size * np.array([-0.03, 0.0, 0.03]) if heel is None else heel + size * np.array([0.03, 0.0, 0.0])
        places[f"{side} toe"] = flat + size * np.array([0.14, 0.0, 0.02]) if toe is None else toe + size * np.array([0.02, 0.0, -0.015])
        shoulder, elbow = mean(letter + "SHO", letter + "ACR"), mean(letter + "ELB")
        wrist, finger = mean(letter + "WRA", letter + "WRB"), mean(letter + "FIN")
        # Without arm markers an arm hangs down, a little away from the trunk; the wrist and finger follow the forearm's direction.
        shoulder = neck + size * np.array([0.02, 0.15 * sign, -0.07]) if shoulder is None else shoulder + size * np.array([0, 0, -0.045])
        elbow = shoulder + size * np.array([-0.03, 0.08 * sign, -0.25]) if elbow is None else elbow - 0.03 * out
        wrist = elbow + size * np.array([0.05, 0.03 * sign, -0.2]) if wrist is None else wrist
        finger = wrist + 0.35 * (wrist - elbow) if finger is None else finger
        places |= {f"{side} shoulder": shoulder, f"{side} elbow": elbow, f"{side} wrist": wrist, f"{side} finger": finger}
    return Joints(places, width)


def bones_of(joints: Joints, worn: set[str]) -> tuple[Bone, ...]:
    """The bones that carry markers, with their hinges; a bone that carries none moves with its parent, and so has no entry.

    worn: names of bones with markers. A bone between two that carry markers is kept.
    """
    chain = {"thorax": "pelvis", "head": "thorax"}
    pivots = {"thorax": "waist", "head": "neck"}
    for side in ("left", "right"):
        for bone, parent, joint in (
            ("thigh", "pelvis", "hip"),
            ("shank", f"{side} thigh", "knee"),
            ("foot", f"{side} shank", "ankle"),
            ("upper arm", "thorax", "shoulder"),
            ("forearm", f"{side} upper arm", "elbow"),
            ("hand", f"{side} forearm", "wrist"),
        ):
            chain[f"{side} {bone}"] = parent
            pivots[f"{side} {bone}"] = f"{side} {joint}"
    # A bone between two that carry markers has to be there, or the lower one would hang in the air.
    needed = {"pelvis"}
    for bone in worn:
        while bone not in needed:
            needed.add(bone)
            bone = chain[bone]
    bones = [Bone("pelvis", "", as_point(joints.places["pelvis"]))]
    for bone, parent in chain.items():
        if bone in needed:
            bones.append(Bone(bone, parent, as_point(joints.places[pivots[bone]]), _hinges(bone, joints)))
    return tuple(bones)


_HYPEREXTENSION = 10.0
"""Degrees that an elbow goes beyond the straight arm (textbooks: 0 to 10)."""


def _elbow_bend(joints: Joints, side: str) -> float:
    """Degrees that an elbow is bent in the rest pose, seen from the side."""
    shoulder, elbow, wrist = (joints.places[f"{side} {joint}"] for joint in ("shoulder", "elbow", "wrist"))
    upper, lower = elbow - shoulder, wrist - elbow
    return float(np.degrees(np.arctan2(lower[0], -lower[2]) - np.arctan2(upper[0], -upper[2])))


def _hinges(bone: str, joints: Joints) -> tuple[Hinge, ...]:
    side, _, plain = bone.partition(" ")
    plain, right = (plain, side == "right") if side in ("left", "right") else (bone, False)
    hinges = []
    for name, axis, spread, low, high in _HINGES[plain]:
        # The elbow's range is counted from the straight arm, and the rest pose may be bent.
        if (plain, name) == ("forearm", "flexion"):
            low = min(-_elbow_bend(joints, side) - _HYPEREXTENSION, -_HYPEREXTENSION)
        # The right side mirrors the left: a turn about x or z changes its sign, one about y does not.
        turned = (-axis[0], axis[1], -axis[2]) if right else axis
        unit = tuple(float(x) + 0.0 for x in turned)
        hinges.append(
            Hinge(f"{bone} {name}", (unit[0], unit[1], unit[2]), 0.0, *(float(np.radians(degrees)) for degrees in (spread, low, high)))
        )
    return tuple(hinges)


def capsules_of(joints: Joints, bones: tuple[Bone, ...]) -> tuple[Capsule, ...]:
    """Capsules of the whole body: trunk, head and limbs. A part without a bone of its own moves with the nearest bone above it.

    Arms without markers are left out: nobody knows where they are, and in doubt a marker counts as visible.
    """
    size, at = joints.pelvis_width / PELVIS_WIDTH, joints.places
    names = {bone.name for bone in bones}
    trunk = "thorax" if "thorax" in names else "pelvis"
    parts: list[tuple[str, str, str, Floats, Floats]] = [
        ("neck", "neck", trunk, at["neck"], at["head"]),
        (
            "head",
            "head",
            # A part without a bone of its own moves with the nearest bone above it.
            "head" if "head" in names else trunk,
            at["head"] - size * np.array([0, 0, 0.04]),
            at["head"] + size * np.array([0, 0, 0.06]),
        ),
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        waist = at["pelvis"] + size * np.array([0.0, 0.05 * sign, 0.05])
        chest = 0.5 * (at["neck"] + at[f"{side} shoulder"]) + size * np.array([0.0, 0.0, -0.08])
        parts += [
            (f"{side} hips", "hips", "pelvis", at[f"{side} hip"], waist),
            (f"{side} trunk", "trunk", trunk, waist + 0.25 * (chest - waist), chest),
            (f"{side} thigh", "thigh", f"{side} thigh", at[f"{side} hip"], at[f"{side} knee"]),
            (f"{side} shank", "shank", f"{side} shank", at[f"{side} knee"], at[f"{side} ankle"]),
            (f"{side} foot", "foot", f"{side} foot", at[f"{side} heel"], at[f"{side} toe"]),
            (f"{side} upper arm", "upper arm", f"{side} upper arm", at[f"{side} shoulder"], at[f"{side} elbow"]),
            (f"{side} forearm", "forearm", f"{side} forearm", at[f"{side} elbow"], at[f"{side} wrist"]),
        ]
        hand = f"{side} hand" if f"{side} hand" in names else f"{side} forearm"
        parts.append((f"{side} hand", "hand", hand, at[f"{side} wrist"], at[f"{side} finger"]))
    return tuple(
        Capsule(name, bone, as_point(start), as_point(end), (size * RADII[kind][0], size * RADII[kind][1]))
        for name, kind, bone, start, end in parts
        if bone in names
    )
