"""An OpenSim model (.osim) in; its bodies, joints, coordinates and markers as a kinematic tree out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.opensim_model import OsimFunction, OsimJoint, OsimModel, read_osim, simm_spline
from asterism.recording import Floats
from asterism.skeleton.tree import Coordinate, Curve, JointMotion, KinematicTree, Point, TreeBone, TreeMarker

_GROUND = "ground"
_TURNS = {"PinJoint": "z", "UniversalJoint": "xy", "WeldJoint": ""}
"""Joints that turn about axes of their frame, one coordinate for each."""


def load_osim(path: str | Path, *, spread: float = 0.01) -> KinematicTree:
    """The kinematic tree of an OpenSim model, y up; its root is the ground, which does not move.

    spread  m, of its markers, which the file does not say; all alike count alike

    Joints: CustomJoint, PinJoint, UniversalJoint and WeldJoint. Functions: constants, lines, SimmSpline and
    PiecewiseLinearFunction. A coordinate that a coupler gives follows the other one. Locked coordinates stay at their default. Ranges hold
    where a coordinate is clamped, as in OpenSim. Muscles, masses and contacts are left alone.
    Raises AsterismError as `read_osim` does, and where the file has other joints or functions.
    """
    model = read_osim(path)
    try:
        return _tree(model, spread)
    except AsterismError as problem:
        raise AsterismError(f"{path}: {problem}") from problem


def _tree(model: OsimModel, spread: float) -> KinematicTree:
    coupled = {coupler.dependent: coupler for coupler in model.couplers}
    # The axes of each bone are those of the joint that carries it, so places in the body's axes are turned into them.
    own = {_GROUND: (np.eye(3), np.zeros(3))} | {joint.child: joint.inner for joint in model.joints.values()}

    def local(body: str, place: Floats) -> Floats:
        if body not in own:
            raise AsterismError(f"{body} carries a marker and hangs on no joint; give a whole model.")
        axes, origin = own[body]
        return np.asarray(axes.T @ (place - origin))

    curves = _coupled_curves(model)
    bones, sliding, turning = [TreeBone(_GROUND, "", np.zeros(3))], set[str](), set[str]()
    for joint in model.joints.values():
        motions = _motions(joint, curves)
        frame = own[joint.parent][0].T @ joint.outer[0]
        bones.append(TreeBone(joint.child, joint.parent, local(joint.parent, joint.outer[1]), motions, frame))
        for motion in motions:
            (sliding if motion.slide else turning).add(motion.coordinate)
    named = [name for joint in model.joints.values() for name in joint.coordinates if name not in coupled]
    coordinates = []
    for name in named:
        given = model.coordinates[name]
        low, high = given.range if given.clamped else (-np.inf, np.inf)
        slides = name in sliding - turning
        coordinates.append(Coordinate(name, given.default, np.inf, low, high, given.default, given.locked, slides))
    markers = tuple(TreeMarker(one.name, one.body, _point(local(one.body, one.location)), spread) for one in model.markers)
    return KinematicTree(tuple(bones), tuple(coordinates), markers, False, title=model.name)


def _coupled_curves(model: OsimModel) -> dict[str, tuple[str, Curve | None]]:
    """Coordinates that follow another one: which, and by what function, None for itself."""
    found = {}
    for coupler in model.couplers:
        if len(coupler.independent) != 1:
            raise AsterismError(f"{coupler.dependent} follows {len(coupler.independent)} coordinates; let it follow one.")
        found[coupler.dependent] = (coupler.independent[0], _curve(coupler.function))
    return found


def _motions(joint: OsimJoint, coupled: Mapping[str, tuple[str, Curve | None]]) -> tuple[JointMotion, ...]:
    if joint.kind in _TURNS:
        axes = [_point(np.eye(3)["xyz".index(axis)]) for axis in _TURNS[joint.kind]]
        return tuple(_motion(axis, name, False, None, coupled) for axis, name in zip(axes, joint.coordinates, strict=True))
    if joint.kind != "CustomJoint":
        raise AsterismError(f"the joint {joint.name} is a {joint.kind}; write it as a CustomJoint, {' or '.join(_TURNS)}.")
    motions = []
    # Slides are along the axes of the parent's side of the joint, so they come before the turns.
    for axis in sorted(joint.axes, key=lambda one: one.turns):
        if len(axis.coordinates) > 1:
            raise AsterismError(f"an axis of the joint {joint.name} follows {', '.join(axis.coordinates)}; let it follow one coordinate.")
        curve = None if axis.function is None else _curve(axis.function)
        name = axis.coordinates[0] if axis.coordinates else ""
        if name or (curve is not None and curve.cubics[0, 0]):
            motions.append(_motion(_point(axis.axis / np.linalg.norm(axis.axis)), name, not axis.turns, curve, coupled))
    return tuple(motions)


def _motion(axis: Point, name: str, slide: bool, curve: Curve | None, coupled: Mapping[str, tuple[str, Curve | None]]) -> JointMotion:
    """A motion, of the coordinate that gives this one where they are coupled."""
    if name not in coupled:
        return JointMotion(axis, name, slide, curve)
    other, by = coupled[name]
    if curve is not None and by is not None:
        raise AsterismError(f"{name} follows {other} by one function and moves its joint by another; leave one of them.")
    return JointMotion(axis, other, slide, by if curve is None else curve)


def _curve(function: OsimFunction) -> Curve | None:
    """The function as cubic pieces; None where it is the coordinate itself."""
    x, y = function.x, function.scale * function.y
    if not len(x):
        if len(y) > 2 and function.kind != "Constant":
            raise AsterismError(f"a joint has a {function.kind} of degree {len(y) - 1}; write it as a SimmSpline.")
        rows = np.zeros((1, 4))
        rows[0, : len(y)] = y[::-1]
        return None if rows[0].tolist() == [0.0, 1.0, 0.0, 0.0] else Curve(np.zeros(1), rows)
    if len(x) < 2 or (np.diff(x) <= 0).any():
        raise AsterismError(f"a {function.kind} does not have two or more points in order; correct its x.")
    if function.kind == "SimmSpline":
        return Curve(x, simm_spline(x, y))
    if function.kind == "PiecewiseLinearFunction":
        slopes = np.asarray(np.diff(y) / np.diff(x), dtype=np.float64)
        return Curve(x, np.column_stack([y, np.append(slopes, slopes[-1]), np.zeros((len(x), 2))]))
    raise AsterismError(f"a function of a joint is a {function.kind}; write it as a SimmSpline.")


def with_coordinate_weights(tree: KinematicTree, weights: Mapping[str, float]) -> KinematicTree:
    """The tree with coordinates that are pulled to their defaults, by OpenSim's weights: per rad2, as markers' are per m2."""
    pulled = tuple(replace(c, spread=weights[c.name] ** -0.5) if weights.get(c.name) else c for c in tree.coordinates)
    return replace(tree, coordinates=pulled)


def _point(place: Floats) -> Point:
    return (float(place[0]), float(place[1]), float(place[2]))
