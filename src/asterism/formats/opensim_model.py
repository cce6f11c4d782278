"""A model of OpenSim (.osim) in; its bodies where they are when all coordinates are zero, its joints and its coordinates, out.

Source: the files of OpenSim 2 to 4 and its documentation: bodies that hold their joint (to version 30000), joints with offset frames
(from 30500 on), and the functions of a custom joint's spatial transform.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError, guarded_reading
from asterism.recording import Floats

_GROUND = "ground"
_OFFSET_FRAMES = 30500
"""The version of the file from which joints stand beside the bodies, with offset frames."""


@dataclass(frozen=True)
class OsimJoint:
    """One joint.

    parent, child  names of bodies; "ground" for the room
    coordinates    names of its coordinates
    centre         (3,) m, its centre in the room, all coordinates zero: where the child's side of it is
    """

    name: str
    parent: str
    child: str
    coordinates: tuple[str, ...]
    centre: Floats


@dataclass(frozen=True)
class OsimModel:
    """The skeleton of a model, all coordinates zero: there a model of a person stands upright, x ahead, y up, z to its right.

    name       what the file calls it
    masses     body -> kg
    rotations  body -> (3, 3), from its axes to the room's; origins  body -> (3,) m in the room
    joints     child body -> joint
    coupled    coordinates that a constraint makes follow others, such as a patella's
    """

    name: str
    masses: Mapping[str, float]
    rotations: Mapping[str, Floats]
    origins: Mapping[str, Floats]
    joints: Mapping[str, OsimJoint]
    coupled: frozenset[str] = frozenset()

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
    """The skeleton of a model's file, of OpenSim 2 to 4. Muscles, markers and geometry are not read.

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
        bodies = {one.get("name", ""): one for one in model.findall("BodySet/objects/Body")}
        beside = list(model.findall("JointSet/objects/*"))
        hung = [_hung(joint) for joint in beside] if beside else [_held(name, body) for name, body in bodies.items()]
        joints = {one.child: one for one in hung if one is not None}
        masses = {name: float(body.findtext("mass") or 0.0) for name, body in bodies.items() if name != _GROUND}
        rotations, origins, found = {_GROUND: np.eye(3)}, {_GROUND: np.zeros(3)}, dict[str, OsimJoint]()
        waiting = list(joints.values())
        while waiting:
            ready = [one for one in waiting if one.parent in rotations]
            if not ready:
                raise AsterismError(f"{path}: {waiting[0].child} hangs on {waiting[0].parent}, which hangs on nothing; give a whole model.")
            for one in ready:
                waiting.remove(one)
                turn, centre = _placed(rotations[one.parent], origins[one.parent], one.outer)
                turn, centre = _placed(turn, centre, one.motion)
                # the child's frame lies at the joint, and the child where that is its place in it
                rotations[one.child] = turn @ one.inner[0].T
                origins[one.child] = centre - rotations[one.child] @ one.inner[1]
                found[one.child] = OsimJoint(one.name, one.parent, one.child, one.coordinates, centre)
        coupled = frozenset((one.text or "").strip() for one in model.iter("dependent_coordinate_name"))
        return OsimModel(model.get("name", path.stem), masses, rotations, origins, found, coupled)


_Frame = tuple[Floats, Floats]
_STILL: _Frame = (np.eye(3), np.zeros(3))


@dataclass(frozen=True)
class _Hung:
    """A joint as a file has it: frames on the parent and on the child, and how the second lies in the first, all coordinates zero."""

    name: str
    parent: str
    child: str
    coordinates: tuple[str, ...]
    outer: _Frame
    inner: _Frame
    motion: _Frame


def _placed(rotation: Floats, origin: Floats, frame: _Frame) -> _Frame:
    return rotation @ frame[0], origin + rotation @ frame[1]


def _hung(joint: ElementTree.Element) -> _Hung:
    """A joint that stands beside the bodies."""
    frames = {one.get("name", ""): one for one in joint.iter("PhysicalOffsetFrame")}

    def side(which: str) -> tuple[str, _Frame]:
        path = next((one.text or "" for one in joint.iter() if one.tag.startswith(f"socket_{which}_frame")), "")
        name = path.rsplit("/", 1)[-1].strip()
        offset = frames.get(name)
        if offset is None:
            return name, _STILL
        below = next((one.text or "" for one in offset.iter() if one.tag == "socket_parent" or one.tag.startswith("socket_parent_")), "")
        return below.rsplit("/", 1)[-1].strip(), _frame(offset.findtext("orientation"), offset.findtext("translation"))

    (parent, outer), (child, inner) = side("parent"), side("child")
    return _Hung(joint.get("name", ""), parent, child, _coordinates(joint), outer, inner, _motion(joint))


def _held(name: str, body: ElementTree.Element) -> _Hung | None:
    """The joint that a body of an older file holds; None for the ground."""
    joint = next(iter(body.findall("Joint/*")), None)
    if joint is None:
        return None
    outer = _frame(joint.findtext("orientation_in_parent"), joint.findtext("location_in_parent"))
    inner = _frame(joint.findtext("orientation"), joint.findtext("location"))
    parent = (joint.findtext("parent_body") or "").strip()
    # some of these files let a joint count from the child to the parent, which all zeros do not tell
    return _Hung(joint.get("name", ""), parent, name, _coordinates(joint), outer, inner, _motion(joint))


def _coordinates(joint: ElementTree.Element) -> tuple[str, ...]:
    return tuple(one.get("name", "") for one in joint.iter("Coordinate"))


def _numbers(text: str | None) -> Floats:
    return np.array([float(word) for word in (text or "0 0 0").split()])


def _frame(orientation: str | None, translation: str | None) -> _Frame:
    """Axes by turns about x, y and z, each of the axes turned already, and the origin."""
    return Rotation.from_euler("XYZ", _numbers(orientation)).as_matrix(), _numbers(translation)


def _motion(joint: ElementTree.Element) -> _Frame:
    """How the child's frame lies in the parent's, all coordinates zero: of a custom joint by its functions, of others not moved."""
    transform = joint.find("SpatialTransform")
    if transform is None:
        return _STILL
    turn, moved = np.eye(3), np.zeros(3)
    for axis in transform.findall("TransformAxis"):
        along, value = _numbers(axis.findtext("axis")), _at_zero(_function_of(axis))
        if axis.get("name", "").startswith("rotation"):
            turn = turn @ Rotation.from_rotvec(along * value).as_matrix()
        else:
            moved = moved + along * value
    return turn, moved


def _function_of(holder: ElementTree.Element) -> ElementTree.Element | None:
    """The function of an axis or of another function: below <function>, or, in newer files, named so."""
    below = holder.find("function")
    if below is not None:
        return next(iter(below), None)
    return next((one for one in holder if one.get("name") == "function"), None)


def _at_zero(function: ElementTree.Element | None) -> float:
    """A function's value at zero."""
    if function is None:
        return 0.0
    kind = function.tag
    if kind == "Constant":
        return float(function.findtext("value") or 0.0)
    if kind in ("LinearFunction", "PolynomialFunction"):
        return float(_numbers(function.findtext("coefficients"))[-1])
    if kind == "MultiplierFunction":
        return float(function.findtext("scale") or 1.0) * _at_zero(_function_of(function))
    if kind in ("SimmSpline", "NaturalCubicSpline", "GCVSpline", "PiecewiseLinearFunction"):
        x, y = _numbers(function.findtext("x")), _numbers(function.findtext("y"))
        return _spline_at_zero(x, y, straight=kind.startswith("Piecewise") or len(x) < 3)
    raise AsterismError(f"it has a joint with the function {kind}, whose value is not known; use a model with splines or polynomials.")


def _spline_at_zero(x: Sequence[float] | Floats, y: Sequence[float] | Floats, straight: bool) -> float:
    return float(np.interp(0.0, x, y)) if straight else float(CubicSpline(x, y, bc_type="natural")(0.0))
