"""An OpenSim model (.osim, version 4) in; its bodies, joints, coordinates and markers as a kinematic tree out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError, guarded_reading
from asterism.recording import Floats
from asterism.skeleton.tree import Coordinate, Curve, JointMotion, KinematicTree, Point, TreeBone, TreeMarker

GROUND = "ground"

_AXES = {"PinJoint": ("z",), "UniversalJoint": ("x", "y"), "WeldJoint": ()}
"""Joints that turn about axes of their frame, one coordinate for each."""

Frame = tuple[Floats, Floats]
"""Axes (3, 3) and origin (3,) m of a frame in another one."""


def load_osim(path: str | Path, *, spread: float = 0.01) -> KinematicTree:
    """The kinematic tree of an OpenSim model, y up; its root is the ground, which does not move.

    spread  m, of its markers, which the file does not say; all alike count alike

    Joints: CustomJoint, PinJoint, UniversalJoint and WeldJoint. Functions: Constant, LinearFunction, SimmSpline, PiecewiseLinearFunction
    and MultiplierFunction. A coordinate that a CoordinateCouplerConstraint gives follows the other one. Locked coordinates stay at their
    default. Ranges hold where a coordinate is clamped, as in OpenSim. Muscles, masses and contacts are left alone.
    Raises AsterismError where the file is damaged, older than OpenSim 4, or has other joints or functions.
    """
    path = Path(path)
    with guarded_reading(path):
        model = ET.parse(path).getroot().find("Model")
        if model is None or model.find("JointSet") is None:
            raise AsterismError(f"{path}: no model of OpenSim 4 (no JointSet); open it in OpenSim 4 and save it.")
        if (unit := model.findtext("length_units", "meters").strip()) != "meters":
            raise AsterismError(f"{path}: its lengths are {unit}; save it in meters.")
        return _Model(path, model, spread).tree()


class _Model:
    """What is collected of a file on the way."""

    def __init__(self, path: Path, model: Element, spread: float) -> None:
        self.path, self.model, self.spread = path, model, spread
        self.joints = list(_objects(model, "JointSet"))
        self.coordinates: list[Coordinate] = []
        self.coupled = self._couplings()
        self.inside: dict[str, Frame] = {GROUND: (np.eye(3), np.zeros(3))}
        """Of each body the axes of the joint that carries it: the bone's own."""

    def tree(self) -> KinematicTree:
        """The tree."""
        bones = [TreeBone(GROUND, "", np.zeros(3))]
        waiting = [(joint, *self._sockets(joint)) for joint in self.joints]
        # The file may list a joint before that of its parent.
        while waiting:
            ready = [each for each in waiting if each[1][0] in self.inside]
            if not ready:
                raise AsterismError(
                    f"{self.path}: the joint {waiting[0][0].get('name')} hangs on {waiting[0][1][0]}, which hangs on nothing."
                )
            for joint, (parent, at), (child, own) in ready:
                axes, origin = self.inside[parent]
                self.inside[child] = own
                # The bone's axes are those of its joint, so places in the body's axes are turned into them.
                bones.append(TreeBone(child, parent, axes.T @ (at[1] - origin), self._motions(joint), axes.T @ at[0]))
            waiting = [each for each in waiting if each[2][0] not in self.inside]
        free = [c for c in self.coordinates if c.name not in self.coupled]
        title = self.model.get("name") or self.path.stem
        return KinematicTree(tuple(bones), tuple(free), self._markers(), False, title=title)

    def _sockets(self, joint: Element) -> tuple[tuple[str, Frame], tuple[str, Frame]]:
        """Parent and child of a joint: the body, and the joint's frame in it."""
        frames: dict[str, tuple[str, Frame]] = {}
        for frame in joint.findall("frames/PhysicalOffsetFrame"):
            turned = Rotation.from_euler("XYZ", _numbers(frame, "orientation", 3)).as_matrix()
            frames[frame.get("name", "")] = (_last(frame.findtext("socket_parent", "")), (turned, _numbers(frame, "translation", 3)))
        still = (np.eye(3), np.zeros(3))
        names = [_last(joint.findtext(f"socket_{which}_frame", "")) for which in ("parent", "child")]
        parent, child = (frames.get(name, (name, still)) for name in names)
        return parent, child

    def _motions(self, joint: Element) -> tuple[JointMotion, ...]:
        own = [self._coordinate(each) for each in joint.findall("coordinates/Coordinate")]
        if joint.tag in _AXES:
            self.coordinates += own
            axes = [_point(np.eye(3)["xyz".index(axis)]) for axis in _AXES[joint.tag]]
            return tuple(self._motion(axis, each.name, False, None) for axis, each in zip(axes, own, strict=True))
        if joint.tag != "CustomJoint":
            raise AsterismError(
                f"{self.path}: the joint {joint.get('name')} is a {joint.tag}; write it as a CustomJoint, {' or '.join(_AXES)}."
            )
        moves = {axis.get("name", ""): axis for axis in joint.findall("SpatialTransform/TransformAxis")}
        sliding = {(moves[f"translation{i}"].findtext("coordinates") or "").strip() for i in (1, 2, 3)}
        turning = {(moves[f"rotation{i}"].findtext("coordinates") or "").strip() for i in (1, 2, 3)}
        self.coordinates += [replace(each, slides=each.name in sliding - turning) for each in own]
        # Slides are along the axes of the parent's side of the joint, so they come before the turns.
        return tuple(
            motion
            for kind in ("translation", "rotation")
            for i in (1, 2, 3)
            if (motion := self._axis(moves[f"{kind}{i}"], kind)) is not None
        )

    def _axis(self, axis: Element, kind: str) -> JointMotion | None:
        coordinate = (axis.findtext("coordinates") or "").strip()
        if len(coordinate.split()) > 1:
            raise AsterismError(f"{self.path}: {axis.get('name')} depends on {coordinate}; only one coordinate for each axis is read.")
        given = next(each for each in axis if each.tag not in ("coordinates", "axis"))
        # Older files have the function in an element of its own.
        curve = self._curve(given[0] if given.tag == "function" else given)
        if not coordinate and not curve.cubics[0, 0]:
            return None
        plain = len(curve.knots) == 1 and curve.cubics[0].tolist() == [0.0, 1.0, 0.0, 0.0]
        along = _numbers(axis, "axis", 3)
        return self._motion(_point(along / np.linalg.norm(along)), coordinate, kind == "translation", None if plain else curve)

    def _motion(self, axis: Point, coordinate: str, slide: bool, curve: Curve | None) -> JointMotion:
        """A motion, of the coordinate that gives this one where they are coupled."""
        if coordinate not in self.coupled:
            return JointMotion(axis, coordinate, slide, curve)
        other, by = self.coupled[coordinate]
        identity = len(by.knots) == 1 and by.cubics[0].tolist() == [0.0, 1.0, 0.0, 0.0]
        if curve is not None and not identity:
            raise AsterismError(
                f"{self.path}: {coordinate} follows {other} by one function and moves its joint by another; leave one of them."
            )
        return JointMotion(axis, other, slide, curve if identity else by)

    def _coordinate(self, given: Element) -> Coordinate:
        low, high = _numbers(given, "range", 2)
        clamped, locked = (given.findtext(key, "false").strip() == "true" for key in ("clamped", "locked"))
        start = float(given.findtext("default_value", "0"))
        low, high = (float(low), float(high)) if clamped else (-np.inf, np.inf)
        return Coordinate(given.get("name", ""), start, np.inf, low, high, start, locked)

    def _couplings(self) -> dict[str, tuple[str, Curve]]:
        """Coordinates that follow another one: which, and by what function."""
        found: dict[str, tuple[str, Curve]] = {}
        for constraint in _objects(self.model, "ConstraintSet"):
            if constraint.tag != "CoordinateCouplerConstraint" or constraint.findtext("isEnforced", "true").strip() != "true":
                continue
            function = constraint.find("coupled_coordinates_function")
            others = constraint.findtext("independent_coordinate_names", "").split()
            if function is None or len(others) != 1:
                raise AsterismError(f"{self.path}: the constraint {constraint.get('name')} follows {len(others)} coordinates; one is read.")
            found[constraint.findtext("dependent_coordinate_name", "").strip()] = (others[0], self._curve(function[0]))
        return found

    def _curve(self, function: Element) -> Curve:
        if function.tag == "Constant":
            return Curve(np.zeros(1), np.array([[float(function.findtext("value", "0")), 0.0, 0.0, 0.0]]))
        if function.tag == "LinearFunction":
            slope, constant = _numbers(function, "coefficients", 2)
            return Curve(np.zeros(1), np.array([[constant, slope, 0.0, 0.0]]))
        if function.tag == "MultiplierFunction":
            inner = function.find("function")
            assert inner is not None
            curve = self._curve(inner[0])
            return Curve(curve.knots, float(function.findtext("scale", "1")) * curve.cubics)
        x, y = (np.array(function.findtext(key, "").split(), dtype=np.float64) for key in "xy")
        if len(x) < 2 or len(x) != len(y) or (np.diff(x) <= 0).any():
            raise AsterismError(f"{self.path}: a {function.tag} does not have two or more points in order; correct its x and y.")
        if function.tag == "PiecewiseLinearFunction":
            slopes = np.asarray(np.diff(y) / np.diff(x), dtype=np.float64)
            return Curve(x, np.column_stack([y, np.append(slopes, slopes[-1]), np.zeros((len(x), 2))]))
        if function.tag == "SimmSpline":
            return Curve(x, simm_spline(x, y))
        raise AsterismError(f"{self.path}: a function is a {function.tag}; write it as a SimmSpline.")

    def _markers(self) -> tuple[TreeMarker, ...]:
        markers = []
        for marker in _objects(self.model, "MarkerSet"):
            body = _last(marker.findtext("socket_parent_frame", ""))
            if body not in self.inside:
                raise AsterismError(f"{self.path}: the marker {marker.get('name')} is on {body}, which hangs on no joint.")
            axes, origin = self.inside[body]
            markers.append(
                TreeMarker(marker.get("name", ""), body, _point(axes.T @ (_numbers(marker, "location", 3) - origin)), self.spread)
            )
        return tuple(markers)


def simm_spline(x: Floats, y: Floats) -> Floats:
    """(K, 4) coefficients from each of K points on, the constant first; the last row goes on straight.

    The third derivative at both ends is that of the cubic through the four points there (Forsythe, Malcolm and Moler, Computer Methods for
    Mathematical Computations, 1977, ch. 4), as SIMM has it. O(K^3).
    """
    count, width = len(x), np.diff(x)
    slope = np.diff(y) / width
    second = np.zeros(count)
    if count > 2:
        # Unknowns are sixths of the second derivatives at the points.
        system, right = np.zeros((count, count)), np.zeros(count)
        for i in range(1, count - 1):
            system[i, i - 1 : i + 2] = width[i - 1], 2.0 * (width[i - 1] + width[i]), width[i]
            right[i] = slope[i] - slope[i - 1]
        system[0, :2], system[-1, -2:] = (-width[0], width[0]), (width[-1], -width[-1])
        if count > 3:
            thirds = [
                ((slope[i + 2] - slope[i + 1]) / (x[i + 3] - x[i + 1]) - (slope[i + 1] - slope[i]) / (x[i + 2] - x[i])) / (x[i + 3] - x[i])
                for i in (0, count - 4)
            ]
            right[0], right[-1] = width[0] ** 2 * thirds[0], -(width[-1] ** 2) * thirds[1]
        second = np.asarray(np.linalg.solve(system, right), dtype=np.float64)
    first = np.append(slope - width * (second[1:] + 2.0 * second[:-1]), 0.0)
    third = np.append(np.diff(second) / width, 0.0)
    first[-1] = slope[-1] + width[-1] * (second[-2] + 2.0 * second[-1])
    out = np.column_stack([y, first, 3.0 * second, third])
    out[-1, 2:] = 0.0
    return out


def with_coordinate_weights(tree: KinematicTree, weights: Mapping[str, float]) -> KinematicTree:
    """The tree with coordinates that are pulled to their defaults, by weights OpenSim's weights: per rad2, as markers' are per m2."""
    pulled = tuple(replace(c, spread=weights[c.name] ** -0.5) if weights.get(c.name) else c for c in tree.coordinates)
    return replace(tree, coordinates=pulled)


def _objects(model: Element, name: str) -> list[Element]:
    """What a set of the model holds."""
    return [each for objects in model.findall(f"{name}/objects") for each in objects]


def _last(path: str) -> str:
    """The last part of a path of components: /bodyset/torso is the torso."""
    return path.strip().rpartition("/")[2]


def _numbers(element: Element, key: str, count: int) -> Floats:
    numbers = np.array(element.findtext(key, "").split(), dtype=np.float64)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise AsterismError(f"{element.get('name') or element.tag} has not {count} finite numbers as its {key}.")
    return numbers


def _point(place: Floats) -> Point:
    return (float(place[0]), float(place[1]), float(place[2]))
