"""Models of OpenSim for tests: bodies and joints named as in gait2392, with round lengths, in the files of OpenSim 4 and of OpenSim 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np

LEGS = {
    "femur": ("pelvis", "hip", (-0.06, -0.07, 0.085), ("flexion", "adduction", "rotation"), 9.0),
    "tibia": ("femur", "knee", (-0.005, -0.40, 0.0), ("angle",), 3.7),
    "talus": ("tibia", "ankle", (0.0, -0.42, 0.0), ("angle",), 0.1),
    "calcn": ("talus", "subtalar", (-0.05, -0.04, 0.01), ("angle",), 1.2),
    "toes": ("calcn", "mtp", (0.18, 0.0, 0.0), ("angle",), 0.2),
}
"""Of the right side: the body above, the joint, where it is in that body (m), its coordinates, and the body's mass (kg)."""
ARMS = {
    "humerus": ("torso", "shoulder", (0.0, 0.37, 0.17), ("flexion", "adduction", "rotation"), 2.0),
    "ulna": ("humerus", "elbow", (0.01, -0.28, 0.0), ("angle",), 0.6),
    "radius": ("ulna", "radioulnar", (0.0, -0.01, 0.02), ("rotation",), 0.6),
    "hand": ("radius", "wrist", (0.0, -0.24, 0.01), ("angle", "adduction"), 0.5),
}
"""As `LEGS`."""
LUMBAR = (-0.10, 0.08, 0.0)
TURNS = {"flexion": "0 0 1", "adduction": "1 0 0", "rotation": "0 1 0", "angle": "0 0 1", "extension": "0 0 1", "bending": "1 0 0"}
Joint = tuple[str, str, str, str, tuple[float, float, float], list[str], float]


def joints(*, arms: bool = False) -> list[Joint]:
    """Name, body above, body, sort, place, coordinates and mass of each."""
    free = [f"pelvis_{name}" for name in ("tilt", "list", "rotation", "tx", "ty", "tz")]
    found: list[Joint] = [("ground_pelvis", "ground", "pelvis", "pelvis", (0.0, 0.0, 0.0), free, 11.0)]
    for letter, sign in (("r", 1.0), ("l", -1.0)):
        for body, (above, joint, place, coordinates, mass) in (LEGS | ARMS if arms else LEGS).items():
            parent = above if above in ("pelvis", "torso") else f"{above}_{letter}"
            own = [f"{joint}_{one}_{letter}" for one in coordinates]
            found.append((f"{joint}_{letter}", parent, f"{body}_{letter}", joint, (place[0], place[1], sign * place[2]), own, mass))
    back = [f"lumbar_{one}" for one in ("extension", "bending", "rotation")]
    return [*found, ("back", "pelvis", "torso", "back", LUMBAR, back, 34.0)]


def centres() -> dict[str, np.ndarray]:
    """Where each body is in the room, all coordinates zero: no joint of the model turns its body."""
    found = {"ground": np.zeros(3)}
    for _, parent, body, _, place, _, _ in joints():
        found[body] = found[parent] + place
    return found


def _axes(sort: str, name: str, coordinates: list[str], old: bool) -> str:
    """The spatial transform: rotations first. The knee's height is a spline of its angle, as in gait2392."""
    left = name.endswith("_l")
    if sort == "pelvis":
        turns = [("0 0 1", coordinates[0], 1.0), ("1 0 0", coordinates[1], 1.0), ("0 1 0", coordinates[2], 1.0)]
        moved = [(f"{int(k == 0)} {int(k == 1)} {int(k == 2)}", coordinates[3 + k], 1.0) for k in range(3)]
    else:
        turns = [(TURNS[one.removesuffix("_r").removesuffix("_l").split("_")[-1]], one, 1.0) for one in coordinates]
        turns = [(axis, one, -1.0 if left and axis != "0 0 1" else 1.0) for axis, one, _ in turns]
        turns += [(axis, "", 0.0) for axis in ("1 0 0", "0 1 0", "0 0 1") if axis not in [used for used, _, _ in turns]]
        moved = [("1 0 0", "", 0.0), ("0 1 0", coordinates[0] if sort == "knee" else "", 0.0), ("0 0 1", "", 0.0)]
    text = ""
    for kind, axes in (("rotation", turns), ("translation", moved)):
        for number, (axis, coordinate, factor) in enumerate(axes, 1):
            attribute = "" if old else ' name="function"'
            if sort == "knee" and kind == "translation" and coordinate:
                function = f"<SimmSpline{attribute}><x>-2 -1 0.5 1</x><y>0.02 0.01 -0.005 -0.01</y></SimmSpline>"
            elif coordinate:
                function = f"<LinearFunction{attribute}><coefficients>{factor} 0</coefficients></LinearFunction>"
            else:
                function = f"<Constant{attribute}><value>0</value></Constant>"
            function = f"<function>{function}</function>" if old else function
            named = f"<coordinates>{coordinate}</coordinates><axis>{axis}</axis>{function}"
            text += f'<TransformAxis name="{kind}{number}">{named}</TransformAxis>'
    return f"<SpatialTransform>{text}</SpatialTransform>"


def _coordinate(name: str) -> str:
    kind = "translational" if name.endswith(("tx", "ty", "tz")) else "rotational"
    return f'<Coordinate name="{name}"><motion_type>{kind}</motion_type><default_value>0</default_value><range>-3 3</range></Coordinate>'


def _body(name: str, mass: float) -> str:
    inertia = f"{mass * 0.01:.4f}"
    return f"<mass>{mass}</mass><mass_center>0 0 0</mass_center><inertia>{inertia} {inertia} {inertia} 0 0 0</inertia>"


def written_model(path: Path, *, arms: bool = False) -> Path:
    """In the form of OpenSim 4."""
    bodies = "".join(f'<Body name="{body}">{_body(body, mass)}</Body>' for _, _, body, _, _, _, mass in joints(arms=arms))
    text = ""
    for name, parent, body, sort, place, coordinates, _ in joints(arms=arms):
        inside = "".join(_coordinate(one) for one in coordinates)
        above = "/ground" if parent == "ground" else f"/bodyset/{parent}"
        frames = "".join(
            f'<PhysicalOffsetFrame name="{one}"><socket_parent>{below}</socket_parent><translation>{where}</translation>'
            f"<orientation>0 0 0</orientation></PhysicalOffsetFrame>"
            for one, below, where in (("above", above, "{} {} {}".format(*place)), ("below", f"/bodyset/{body}", "0 0 0"))
        )
        text += (
            f'<CustomJoint name="{name}"><socket_parent_frame>above</socket_parent_frame><socket_child_frame>below</socket_child_frame>'
            f"<coordinates>{inside}</coordinates><frames>{frames}</frames>{_axes(sort, name, coordinates, old=False)}</CustomJoint>"
        )
    sets = f"<BodySet><objects>{bodies}</objects></BodySet><JointSet><objects>{text}</objects></JointSet>"
    return _saved(path, "40000", f'<Model name="round"><gravity>0 -9.81 0</gravity>{sets}</Model>')


def written_old_model(path: Path) -> Path:
    """In the form of OpenSim 3: each body holds its joint."""
    text = '<Body name="ground"><mass>0</mass></Body>'
    for name, parent, body, sort, place, coordinates, mass in joints():
        inside = "".join(_coordinate(one) for one in coordinates)
        text += (
            f'<Body name="{body}">{_body(body, mass)}<Joint><CustomJoint name="{name}"><parent_body>{parent}</parent_body>'
            f"<location_in_parent>{place[0]} {place[1]} {place[2]}</location_in_parent><orientation_in_parent>0 0 0</orientation_in_parent>"
            "<location>0 0 0</location><orientation>0 0 0</orientation>"
            f"<CoordinateSet><objects>{inside}</objects></CoordinateSet>"
            f"{_axes(sort, name, coordinates, old=True)}</CustomJoint></Joint></Body>"
        )
    return _saved(path, "30000", f'<Model name="round"><gravity>0 -9.81 0</gravity><BodySet><objects>{text}</objects></BodySet></Model>')


def _saved(path: Path, version: str, inside: str) -> Path:
    path.write_text(f'<?xml version="1.0" encoding="UTF-8"?>\n<OpenSimDocument Version="{version}">{inside}</OpenSimDocument>\n', "utf-8")
    return path
