"""A model of OpenSim (.osim) in; its bodies where they are when all coordinates are zero, its joints and its coordinates, out.

Source: the files of OpenSim 2 to 4 and its documentation: bodies that hold their joint (to version 30000), joints with offset frames
(from 30500 on), and the functions of a custom joint's spatial transform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError, guarded_reading
from asterism.recording import Floats

_GROUND = "ground"


OsimFrame = tuple[Floats, Floats]
"""Axes (3, 3) and origin (3,) m of a frame in another one."""


@dataclass(frozen=True)
class OsimFunction:
    """A function of one coordinate.

    kind   "Constant" with its value in y; "LinearFunction" or "PolynomialFunction" with their coefficients in y, the constant last;
           "SimmSpline", "NaturalCubicSpline", "GCVSpline" or "PiecewiseLinearFunction" through the points x, y
    scale  by which the value is multiplied, see MultiplierFunction
    """

    kind: str
    x: Floats
    y: Floats
    scale: float = 1.0

    @property
    def at_zero(self) -> float:
        """Its value at zero."""
        if not len(self.x):
            return self.scale * float(self.y[-1])
        if self.kind == "PiecewiseLinearFunction" or len(self.x) < 3:
            return self.scale * float(np.interp(0.0, self.x, self.y))
        if self.kind != "SimmSpline":
            return self.scale * float(CubicSpline(self.x, self.y, bc_type="natural")(0.0))
        at = int(np.clip(np.searchsorted(self.x, 0.0, side="right") - 1, 0, len(self.x) - 1))
        return self.scale * float(np.polyval(simm_spline(self.x, self.y)[at][::-1], -self.x[at]))


@dataclass(frozen=True)
class OsimAxis:
    """One of a custom joint's six motions: along or about `axis` (3,), by the function of the coordinates; none: by nothing."""

    turns: bool
    axis: Floats
    coordinates: tuple[str, ...]
    function: OsimFunction | None


@dataclass(frozen=True)
class OsimCoordinate:
    """One coordinate: its default and least and largest value, in rad or m, and whether it is kept within these, or at its default."""

    name: str
    default: float
    range: tuple[float, float]
    clamped: bool
    locked: bool


@dataclass(frozen=True)
class OsimCoupler:
    """A coordinate that follows others by a function."""

    dependent: str
    independent: tuple[str, ...]
    function: OsimFunction


@dataclass(frozen=True)
class OsimMarker:
    """A marker: (3,) m in its body's axes."""

    name: str
    body: str
    location: Floats


@dataclass(frozen=True)
class OsimJoint:
    """One joint.

    kind           "CustomJoint", "PinJoint", "WeldJoint", ...
    parent, child  names of bodies; "ground" for the room
    coordinates    names of its coordinates
    outer, inner   the joint's frame in the parent, and in the child
    axes           of a custom joint: three turns, then three translations, in the order of the file
    centre         (3,) m, its centre in the room, all coordinates zero: where the child's side of it is
    """

    name: str
    kind: str
    parent: str
    child: str
    coordinates: tuple[str, ...]
    outer: OsimFrame
    inner: OsimFrame
    axes: tuple[OsimAxis, ...]
    centre: Floats


@dataclass(frozen=True)
class OsimModel:
    """The skeleton of a model, all coordinates zero: there a model of a person stands upright, x ahead, y up, z to its right.

    name         what the file calls it
    masses       body -> kg
    rotations    body -> (3, 3), from its axes to the room's; origins  body -> (3,) m in the room
    joints       child body -> joint, a body after the one on which it hangs
    coordinates  by name; couplers  of those that follow others, such as a patella's
    markers      as the file has them
    """

    name: str
    masses: Mapping[str, float]
    rotations: Mapping[str, Floats]
    origins: Mapping[str, Floats]
    joints: Mapping[str, OsimJoint]
    coordinates: Mapping[str, OsimCoordinate]
    couplers: tuple[OsimCoupler, ...]
    markers: tuple[OsimMarker, ...]

    @property
    def mass(self) -> float:
        """kg."""
        return sum(self.masses.values())

    def in_body(self, body: str, point: Floats) -> Floats:
        """(3,) m, a point of the room in a body's axes."""
        return np.asarray((point - self.origins[body]) @ self.rotations[body])

    def below(self, body: str) -> list[str]:
        """A body and all that hang on it."""
        found = [body]
        for one in found:
            found += [joint.child for joint in self.joints.values() if joint.parent == one]
        return found


def read_osim(path: str | Path) -> OsimModel:
    """The skeleton of a model's file, of OpenSim 2 to 4. Muscles and geometry are not read.

    Raises AsterismError, naming the file, where it holds no model, or joints that hang on no body, in a circle, or by an unknown function.
    """
    path = Path(path)
    with guarded_reading(path, "save it again from OpenSim"):
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as problem:
            raise AsterismError(f"{path} is no model of OpenSim ({problem}); give an .osim file.") from problem
        model = root if root.tag == "Model" else root.find("Model")
        if model is None:
            raise AsterismError(f"{path} holds no model of OpenSim; give an .osim file.")
        if (unit := (model.findtext("length_units") or "meters").strip()) != "meters":
            raise AsterismError(f"{path}: its lengths are in {unit}; save it in meters.")
        bodies = {one.get("name", ""): one for one in model.findall("BodySet/objects/Body")}
        beside = list(model.findall("JointSet/objects/*"))
        waiting = [_beside_bodies(joint) for joint in beside] if beside else [*filter(None, map(_held, bodies.values()))]
        rotations, origins, found = {_GROUND: np.eye(3)}, {_GROUND: np.zeros(3)}, dict[str, OsimJoint]()
        while waiting:
            ready = [one for one in waiting if one.parent in rotations]
            if not ready:
                raise AsterismError(f"{path}: {waiting[0].child} hangs on {waiting[0].parent}, which hangs on nothing; give a whole model.")
            for one in ready:
                turn, centre = _placed(*_placed(rotations[one.parent], origins[one.parent], one.outer), _at_rest(one.axes))
                # the child's frame lies at the joint, and the child where that is its place in it
                rotations[one.child] = turn @ one.inner[0].T
                origins[one.child] = centre - rotations[one.child] @ one.inner[1]
                found[one.child] = replace(one, centre=centre)
            waiting = [one for one in waiting if one.child not in rotations]
        return OsimModel(
            name=model.get("name", path.stem),
            masses={name: float(body.findtext("mass") or 0.0) for name, body in bodies.items() if name != _GROUND},
            rotations=rotations,
            origins=origins,
            joints=found,
            coordinates={one.name: one for one in map(_coordinate, model.iter("Coordinate"))},
            couplers=tuple(map(_coupler, _enforced(model))),
            markers=tuple(map(_marker, model.findall("MarkerSet/objects/Marker"))),
        )


_STILL: OsimFrame = (np.eye(3), np.zeros(3))


def _placed(rotation: Floats, origin: Floats, frame: OsimFrame) -> OsimFrame:
    return rotation @ frame[0], origin + rotation @ frame[1]


def _beside_bodies(joint: Element) -> OsimJoint:
    """A joint that stands beside the bodies."""
    frames = {one.get("name", ""): one for one in joint.iter("PhysicalOffsetFrame")}

    def side(which: str) -> tuple[str, OsimFrame]:
        path = next((one.text or "" for one in joint.iter() if one.tag.startswith(f"socket_{which}_frame")), "")
        offset = frames.get(_last(path))
        if offset is None:
            return _last(path), _STILL
        below = next((one.text or "" for one in offset.iter() if one.tag == "socket_parent" or one.tag.startswith("socket_parent_")), "")
        return _last(below), _frame(offset.findtext("orientation"), offset.findtext("translation"))

    (parent, outer), (child, inner) = side("parent"), side("child")
    return _joint(joint, parent, child, outer, inner)


def _held(body: Element) -> OsimJoint | None:
    """The joint that a body of an older file holds; None for the ground."""
    joint = next(iter(body.findall("Joint/*")), None)
    if joint is None:
        return None
    outer = _frame(joint.findtext("orientation_in_parent"), joint.findtext("location_in_parent"))
    inner = _frame(joint.findtext("orientation"), joint.findtext("location"))
    return _joint(joint, (joint.findtext("parent_body") or "").strip(), body.get("name", ""), outer, inner)


def _joint(joint: Element, parent: str, child: str, outer: OsimFrame, inner: OsimFrame) -> OsimJoint:
    coordinates = tuple(one.get("name", "") for one in joint.iter("Coordinate"))
    axes = tuple(
        OsimAxis(
            axis.get("name", "").startswith("rotation"),
            _numbers(axis, "axis"),
            tuple((axis.findtext("coordinates") or "").split()),
            _function(_function_of(axis)),
        )
        for axis in joint.findall("SpatialTransform/TransformAxis")
    )
    return OsimJoint(joint.get("name", ""), joint.tag, parent, child, coordinates, outer, inner, axes, np.zeros(3))


def _coordinate(given: Element) -> OsimCoordinate:
    low, high = _numbers(given, "range", "-inf inf")
    clamped, locked = (given.findtext(key, "false").strip() == "true" for key in ("clamped", "locked"))
    return OsimCoordinate(given.get("name", ""), float(given.findtext("default_value") or 0.0), (low, high), clamped, locked)


def _enforced(model: Element) -> list[Element]:
    return [one for one in model.iter("CoordinateCouplerConstraint") if (one.findtext("isEnforced") or "true").strip() == "true"]


def _coupler(given: Element) -> OsimCoupler:
    function = _function(next(iter(given.find("coupled_coordinates_function") or ()), None))
    if function is None:
        raise AsterismError(f"its constraint {given.get('name')} has no function; save it again from OpenSim.")
    independent = tuple((given.findtext("independent_coordinate_names") or "").split())
    return OsimCoupler((given.findtext("dependent_coordinate_name") or "").strip(), independent, function)


def _marker(given: Element) -> OsimMarker:
    body = next((one.text or "" for one in given if one.tag.startswith("socket_parent_frame") or one.tag == "body"), "")
    return OsimMarker(given.get("name", ""), _last(body), _numbers(given, "location"))


def _last(path: str) -> str:
    """The last part of a path of components: /bodyset/torso is the torso."""
    return path.strip().rpartition("/")[2]


def _numbers(element: Element, key: str, usual: str = "0 0 0") -> Floats:
    return np.array([float(word) for word in (element.findtext(key) or usual).split()])


def _frame(orientation: str | None, translation: str | None) -> OsimFrame:
    """Axes by turns about x, y and z, each of the axes turned already, and the origin."""
    turns, place = ([float(word) for word in (text or "0 0 0").split()] for text in (orientation, translation))
    return Rotation.from_euler("XYZ", turns).as_matrix(), np.array(place)


def _at_rest(axes: Sequence[OsimAxis]) -> OsimFrame:
    """How the child's frame lies in the parent's, all coordinates zero: of a custom joint by its functions, of others not moved."""
    turn, moved = np.eye(3), np.zeros(3)
    for axis in axes:
        value = 0.0 if axis.function is None else axis.function.at_zero
        if axis.turns:
            turn = turn @ Rotation.from_rotvec(axis.axis * value).as_matrix()
        else:
            moved = moved + axis.axis * value
    return turn, moved


def _function_of(holder: Element) -> Element | None:
    """The function of an axis or of another function: below <function>, or, in newer files, named so."""
    below = holder.find("function")
    if below is not None:
        return next(iter(below), None)
    return next((one for one in holder if one.get("name") == "function"), None)


def _function(given: Element | None) -> OsimFunction | None:
    if given is None:
        return None
    if given.tag == "MultiplierFunction":
        inner = _function(_function_of(given))
        return None if inner is None else replace(inner, scale=inner.scale * float(given.findtext("scale") or 1.0))
    if given.tag == "Constant":
        return OsimFunction(given.tag, np.zeros(0), _numbers(given, "value", "0"))
    if given.tag in ("LinearFunction", "PolynomialFunction"):
        return OsimFunction(given.tag, np.zeros(0), _numbers(given, "coefficients", "0"))
    if given.tag in ("SimmSpline", "NaturalCubicSpline", "GCVSpline", "PiecewiseLinearFunction"):
        x, y = _numbers(given, "x"), _numbers(given, "y")
        if len(x) < 2 or len(x) != len(y) or (np.diff(x) <= 0).any():
            raise AsterismError(f"a {given.tag} does not have two or more points in order; correct its x and y.")
        return OsimFunction(given.tag, x, y)
    raise AsterismError(f"it has a joint with the function {given.tag}, whose value is not known; use a model with splines or polynomials.")


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
