"""Kinematic trees: their kernels against plain twins, and the movement that inverse kinematics finds against the movement that was."""

from __future__ import annotations

import numpy as np
import pytest
import twins_skeleton as twins
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from asterism.errors import AsterismError
from asterism.formats.opensim_model import simm_spline
from asterism.recording import Recording
from asterism.skeleton import load_body, solve_kinematics, tree_of
from asterism.skeleton._smooth_kernels import likelihood, smoothed_variances, smoothing_step
from asterism.skeleton._tree_kernels import assemble, factorise, inverse_diagonal, pose_tree, shared_variances, solve_factored
from asterism.skeleton.inverse_kinematics import KinematicsRules, Solving
from asterism.skeleton.osim_file import load_osim
from asterism.skeleton.tree import Coordinate, Curve, JointMotion, KinematicTree, TreeBone, TreeMarker

pytestmark = pytest.mark.kernels

GAUSS = KinematicsRules(tails=0.0)
"""Plain least squares."""


@pytest.fixture(scope="module")
def leg() -> KinematicTree:
    """A leg whose knee slides with its angle, with a kneecap on the thigh that moves with the same angle; the pelvis is free."""
    slide = Curve(np.array([-1.0, 0.0, 1.0]), np.array([[0.01, 0.02, 0.0, 0.01], [0.04, 0.05, 0.03, 0.0], [0.12, 0.1, 0.0, 0.0]]))
    askew = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix()
    bones = (
        TreeBone("pelvis", "", np.zeros(3)),
        TreeBone(
            "thigh", "pelvis", np.array([0.0, 0.1, -0.1]), (JointMotion((0, -1, 0), "flexion"), JointMotion((1, 0, 0), "abduction")), askew
        ),
        TreeBone(
            "kneecap", "thigh", np.array([0.05, 0.0, -0.4]), (JointMotion((0, 0, 1), "knee", True, slide), JointMotion((0, 1, 0), "knee"))
        ),
        TreeBone(
            "shank", "thigh", np.array([0.0, 0.0, -0.4]), (JointMotion((1, 0, 0), "knee", True, slide), JointMotion((0, 1, 0), "knee"))
        ),
        TreeBone("foot", "shank", np.array([0.0, 0.0, -0.4]), (JointMotion((0, 0, 1), "", False, slide), JointMotion((0, -1, 0), "ankle"))),
    )
    coordinates = tuple(Coordinate(name, 0.1, 0.5, -0.3, 1.5) for name in ("flexion", "abduction", "knee", "ankle"))
    rng = np.random.default_rng(3)
    markers = tuple(
        TreeMarker(f"{bone.name}{i}", bone.name, tuple(rng.normal(0, 0.08, 3).tolist()), 0.01 + 0.002 * i)
        for bone in bones
        for i in range(3)
    )
    return KinematicTree(bones, coordinates, markers)


def _solving(tree: KinematicTree, tails: float = 0.0) -> Solving:
    return Solving(tails, np.full(len(tree.coordinates), 130.0), 1e-4, 60, 1e-6, 9.0, 50.0)


def _equations(tree, q, turn, place, points, weights, tails=0.0):
    """The kernels' cost, normal equations (as a full matrix) and gradient."""
    arrays, bones, size = tree.arrays, len(tree.bones), 6 + len(q)
    turned, joints, twists = np.empty((bones, 3, 3)), np.empty((bones, 3)), np.empty((len(arrays.numbers), 6))
    pose_tree(arrays, q, turn, place, turned, joints, twists)
    hessian, gradient, misses = np.zeros((size, size)), np.empty(size), np.empty(len(points))
    work = (points, weights, q, place, turned, joints, twists, np.empty((bones, 16)), hessian, gradient, misses)
    cost = assemble(arrays, _solving(tree, tails), *work)
    return cost, hessian, gradient


def test_the_composite_bodies_give_the_normal_equations_of_the_jacobian(leg) -> None:
    rng = np.random.default_rng(5)
    q, turn, place = rng.uniform(-0.2, 1.4, 4), Rotation.from_rotvec([0.4, 1.0, -2.0]).as_matrix(), np.array([3.0, -2.0, 1.0])
    points = twins.markers_of(leg, q, turn, place) + rng.normal(0, 0.01, (15, 3))
    points[4] = np.nan
    weights = rng.uniform(1e3, 1e4, 15)
    cost, lower, gradient = _equations(leg, q, turn, place, points, weights)
    there = np.isfinite(points[:, 0])
    slopes = twins.jacobian(leg, q, turn, place).reshape(15, 3, -1)[there].reshape(-1, 10)
    away, w = (points - twins.markers_of(leg, q, turn, place))[there].ravel(), np.repeat(weights[there], 3)
    usual, precision = leg.arrays.usual, leg.arrays.precision
    full = slopes.T @ (w[:, None] * slopes) + np.diag([*[1e-4] * 6, *(precision + 1e-4)])
    pull = slopes.T @ (w * away)
    pull[6:] -= precision * (q - usual)
    assert np.allclose(np.tril(lower), np.tril(full), atol=1e-4 * np.abs(full).max() ** 0.5)
    assert np.allclose(gradient, pull, atol=1e-6 * np.abs(pull).max())
    assert cost == pytest.approx(0.5 * (w * away**2).sum() + 0.5 * (precision * (q - usual) ** 2).sum())


def test_the_factor_of_the_branches_solves_and_inverts(leg) -> None:
    rng = np.random.default_rng(6)
    q, turn, place = rng.uniform(0.0, 1.0, 4), np.eye(3), np.zeros(3)
    points = twins.markers_of(leg, q, turn, place) + rng.normal(0, 0.01, (15, 3))
    _, lower, gradient = _equations(leg, q, turn, place, points, np.full(15, 1e4))
    full = np.tril(lower) + np.tril(lower, -1).T
    factor, inverse, variances = np.zeros_like(full), np.zeros_like(full), np.empty(10)
    assert factorise(leg.arrays, lower, 0.0, factor)
    solution = gradient.copy()
    solve_factored(leg.arrays, factor, solution)
    inverse_diagonal(leg.arrays, factor, inverse, variances)
    assert np.allclose(full @ solution, gradient, rtol=1e-8)
    assert np.allclose(variances, np.diag(np.linalg.inv(full)), rtol=1e-6)
    assert not factorise(leg.arrays, -lower, 0.0, factor), "a matrix that is not positive definite has no factor"


def test_what_markers_of_a_bone_do_together_moves_the_numbers_as_a_shift_does(leg) -> None:
    rng = np.random.default_rng(11)
    q, turn, place = rng.uniform(0.0, 1.0, (1, 4)), np.eye(3)[None], np.zeros((1, 3))
    points = twins.markers_of(leg, q[0], turn[0], place[0])[None]
    points[0, 3] = np.nan
    weights, shared, out = rng.uniform(1e3, 1e4, (1, 15)), rng.uniform(1e-5, 1e-4, 5), np.empty((1, 10))
    shared_variances(leg.arrays, _solving(leg), points, weights, shared, q, turn, place, out)
    lower = _equations(leg, q[0], turn[0], place[0], points[0], weights[0])[1]
    slopes, there = twins.jacobian(leg, q[0], turn[0], place[0]).reshape(15, 3, 10), np.isfinite(points[0, :, 0])
    pulls = (slopes * (weights[0] * there)[:, None, None]).reshape(5, 3, 3, 10).sum(axis=1)
    answers = np.linalg.solve(np.tril(lower) + np.tril(lower, -1).T, pulls.reshape(15, 10).T).reshape(10, 5, 3)
    assert np.allclose(out[0], (shared[:, None] * answers**2).sum(axis=(1, 2)), rtol=1e-4)


def test_frames_are_smoothed_as_by_one_dense_matrix(leg) -> None:
    rng = np.random.default_rng(7)
    frames, blocks, entries = 12, [], []
    for _ in range(frames):
        q = rng.uniform(0.0, 1.0, 4)
        points = twins.markers_of(leg, q, np.eye(3), np.zeros(3))
        lower = _equations(leg, q, np.eye(3), np.zeros(3), points, np.full(15, 1e2))[1]
        blocks.append(np.tril(lower) + np.tril(lower, -1).T)
        arrays = leg.arrays
        pairs = [(k, arrays.row_columns[p]) for k in range(10) for p in range(arrays.row_starts[k], arrays.row_starts[k + 1])]
        entries.append([*np.diag(lower), *(lower[k, j] for k, j in pairs)])
    penalties, right, steps = rng.uniform(0.1, 1e4, 10), rng.normal(0, 1, (frames, 10)), np.empty((frames, 10))
    values, basis = eigh(np.mean(blocks, axis=0), np.diag(penalties))
    smoothing_step(leg.arrays, np.array(entries), penalties, np.ascontiguousarray(basis), values, right, 1e-9, steps)
    expected = np.linalg.solve(twins.smoothing_matrix(np.array(blocks), penalties), right.ravel()).reshape(frames, 10)
    assert np.allclose(steps, expected, atol=2e-3 * np.abs(expected).max())


def test_a_courses_likelihood_and_variances_are_those_of_its_covariance() -> None:
    rng = np.random.default_rng(8)
    noise, ratio, values = rng.uniform(0.5, 2.0, 14), 0.3, rng.normal(0, 1, 14).cumsum()
    bends = twins.second_differences(14)
    # Second differences tell all but the course's own straight line, which the diffuse start takes.
    covariance = bends @ np.diag(noise) @ bends.T + ratio * np.eye(12)
    seen = bends @ values
    scale = seen @ np.linalg.solve(covariance, seen) / 12
    other = likelihood(values, noise, 3.0)
    covariance_3 = bends @ np.diag(noise) @ bends.T + 3.0 * np.eye(12)
    scale_3 = seen @ np.linalg.solve(covariance_3, seen) / 12
    gain = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(covariance_3)[1] + 12 * np.log(scale / scale_3)
    found = likelihood(values, noise, ratio)
    assert found[1] == pytest.approx(scale, rel=1e-5)
    assert found[0] - other[0] == pytest.approx(gain, rel=1e-5)
    # Values that say nothing are as if they were not there.
    hidden = np.where(np.arange(14) % 5 == 0, np.inf, noise)
    assert likelihood(values, hidden, ratio)[1] == pytest.approx(likelihood(np.where(np.isinf(hidden), 99.0, values), hidden, ratio)[1])
    assert likelihood(values, hidden, ratio)[1] == pytest.approx(likelihood(values, np.minimum(hidden, 1e9), ratio)[1] * 12 / 9, rel=1e-2)
    out = np.empty(14)
    smoothed_variances(noise, ratio, out)
    assert np.allclose(out, np.diag(np.linalg.inv(np.diag(1 / noise) + bends.T @ bends / ratio)), rtol=1e-4)


def _walk(tree: KinematicTree, frames: int, rate: float, rng: np.random.Generator, turn: np.ndarray) -> tuple[np.ndarray, Recording]:
    """Coordinates (T, Q) rad that swing within their ranges, and a recording of the markers, the body turned by `turn` (3, 3)."""
    low, high = np.radians(-20), np.radians(40)
    time = np.arange(frames)[:, None] / rate
    swing = np.sin(2 * np.pi * (rng.uniform(0.3, 1.2, len(tree.coordinates)) * time + rng.uniform(0, 1, len(tree.coordinates))))
    within = np.array([(max(c.low, low), min(c.high, high)) for c in tree.coordinates])
    q = within.mean(axis=1) + 0.45 * (within[:, 1] - within[:, 0]) * swing
    at = np.array([[1.2 * t, 0.3 * np.sin(t), 1.0] for t in time[:, 0]])
    positions = np.array([twins.markers_of(tree, q[t], turn, at[t]) for t in range(frames)])
    return q, Recording(positions, tree.labels, rate)


@pytest.mark.parametrize("turn", [(0, 0, 2.5), (0, 1.6, 0), (3.1, 0, 0.4)], ids=["walking", "lying", "upside down"])
def test_a_movement_without_noise_is_found_again(turn) -> None:
    tree = tree_of(load_body("plug-in-gait"))
    q, recording = _walk(tree, 60, 100.0, np.random.default_rng(1), Rotation.from_rotvec(turn).as_matrix())
    free = KinematicTree(tree.bones, tuple(Coordinate(c.name, c.usual) for c in tree.coordinates), tree.markers, starts=tree.starts)
    found = solve_kinematics(free, recording, rules=GAUSS)
    # Smoothing is as strong as the course is smooth; a straight arm's turn is told from the forearm's by the frames around.
    assert np.degrees(np.abs(found.coordinates - q)).max() < 0.1
    assert np.nanmax(found.misses) < 1e-3


def test_too_few_markers_are_refused() -> None:
    tree = tree_of(load_body("plug-in-gait"))
    with pytest.raises(AsterismError, match="no frame shows three of its markers"):
        solve_kinematics(tree, Recording(np.zeros((5, 2, 3)), ("LASI", "RASI"), 100.0))


_JOINT = """<CustomJoint name="{name}"><socket_parent_frame>{parent}_offset</socket_parent_frame>
<socket_child_frame>{child}_offset</socket_child_frame><coordinates>{coordinates}</coordinates><frames>
<PhysicalOffsetFrame name="{parent}_offset"><socket_parent>/bodyset/{parent}</socket_parent><translation>{at}</translation>
<orientation>{turned}</orientation></PhysicalOffsetFrame>
<PhysicalOffsetFrame name="{child}_offset"><socket_parent>/bodyset/{child}</socket_parent><translation>{own}</translation>
<orientation>0 0 0.2</orientation></PhysicalOffsetFrame></frames><SpatialTransform>{axes}</SpatialTransform></CustomJoint>"""
_AXIS = (
    '<TransformAxis name="{name}"><coordinates>{coordinate}</coordinates><axis>{axis}</axis><function>{function}</function></TransformAxis>'
)
_LINE = "<LinearFunction><coefficients>1 0</coefficients></LinearFunction>"
_NONE = "<Constant><value>0</value></Constant>"
_POINTS = "<SimmSpline><x>-2 -1 0 0.5 1</x><y>0.01 0.03 0 -0.02 -0.01</y></SimmSpline>"
_SPLINE = f"<MultiplierFunction><function>{_POINTS}</function><scale>2</scale></MultiplierFunction>"


def _coordinate(name: str, locked: str = "false") -> str:
    states = f"<clamped>false</clamped><locked>{locked}</locked>"
    return f'<Coordinate name="{name}"><default_value>0.1</default_value><range>-2 2</range>{states}</Coordinate>'


def _joint(name: str, parent: str, child: str, coordinates: str, moves: dict[str, tuple[str, str]], **places: str) -> str:
    axes = {
        "rotation1": "0 0 1",
        "rotation2": "1 0 0",
        "rotation3": "0 1 0",
        "translation1": "1 0 0",
        "translation2": "0 1 0",
        "translation3": "0 0 1",
    }
    written = [
        _AXIS.format(name=each, axis=axis, coordinate=moves.get(each, ("", _NONE))[0], function=moves.get(each, ("", _NONE))[1])
        for each, axis in axes.items()
    ]
    places = {"at": "0 0 0", "turned": "0 0 0", "own": "0 0 0"} | places
    return _JOINT.format(name=name, parent=parent, child=child, coordinates=coordinates, axes="".join(written), **places)


@pytest.fixture
def osim(tmp_path):
    """A thigh in the ground, a shank whose knee slides, a patella that follows it; the patella's joint is listed first."""
    bend = {"rotation1": ("knee", _LINE), "translation1": ("knee", _SPLINE)}
    joints = (
        _joint("patellar", "thigh", "patella", _coordinate("beta"), {"rotation1": ("beta", _LINE)}, at="0.05 -0.4 0")
        + _joint(
            "hip",
            "ground",
            "thigh",
            _coordinate("hip") + _coordinate("held", "true"),
            {"rotation1": ("hip", _LINE), "rotation3": ("held", _LINE)},
        )
        + _joint("knee", "thigh", "shank", _coordinate("knee"), bend, at="0 -0.4 0", turned="0.3 0.1 0", own="0 0.02 0")
    )
    coupler = """<CoordinateCouplerConstraint name="c"><isEnforced>true</isEnforced><coupled_coordinates_function><LinearFunction>
<coefficients>1 0</coefficients></LinearFunction></coupled_coordinates_function>
<independent_coordinate_names>knee</independent_coordinate_names><dependent_coordinate_name>beta</dependent_coordinate_name></CoordinateCouplerConstraint>"""
    markers = "".join(
        f'<Marker name="{body}{i}"><socket_parent_frame>/bodyset/{body}</socket_parent_frame><location>0.0{i} -0.1 0.05</location></Marker>'
        for body in ("thigh", "shank", "patella")
        for i in range(3)
    )
    path = tmp_path / "leg.osim"
    path.write_text(
        f'<OpenSimDocument Version="40000"><Model name="leg"><length_units>meters</length_units><JointSet><objects>{joints}</objects>'
        f"</JointSet><ConstraintSet><objects>{coupler}</objects></ConstraintSet><MarkerSet><objects>{markers}</objects></MarkerSet></Model></OpenSimDocument>"
    )
    return path


def test_an_opensim_model_is_posed_as_its_file_says(osim) -> None:
    tree = load_osim(osim)
    assert [c.name for c in tree.coordinates] == ["hip", "held", "knee"]
    assert [c.locked for c in tree.coordinates] == [False, True, False]
    hip, held, knee = q = np.array([0.4, 0.1, -0.7])
    about = {name: axis for name, axis in zip("xyz", np.eye(3), strict=True)}

    def turn(axis: str, angle: float) -> np.ndarray:
        return Rotation.from_rotvec(angle * about[axis]).as_matrix()

    inner = turn("z", 0.2)
    thigh = turn("z", hip) @ turn("y", held) @ inner.T
    frame = Rotation.from_euler("XYZ", [0.3, 0.1, 0.0]).as_matrix()
    slide = 2.0 * float(
        twins.value_of(
            Curve(np.array([-2.0, -1, 0, 0.5, 1]), simm_spline(np.array([-2.0, -1, 0, 0.5, 1]), np.array([0.01, 0.03, 0, -0.02, -0.01]))),
            knee,
        )
    )
    knee_at = thigh @ (np.array([0, -0.4, 0]) + frame @ np.array([slide, 0, 0]))
    shank = thigh @ frame @ turn("z", knee) @ inner.T
    at = np.array([0.01, -0.1, 0.05])
    places = twins.markers_of(tree, q, np.eye(3), np.zeros(3))
    assert np.allclose(places[1], thigh @ at)
    assert np.allclose(places[4], knee_at + shank @ (at - np.array([0, 0.02, 0])))
    assert np.allclose(places[7], thigh @ (np.array([0.05, -0.4, 0]) + turn("z", knee) @ inner.T @ at)), "the patella follows the knee"
    recording = Recording(
        np.array([twins.markers_of(tree, q + 0.2 * np.array([k, 0, -k]), np.eye(3), np.zeros(3)) for k in range(3)]), tree.labels, 50.0
    )
    found = solve_kinematics(tree, recording, rules=GAUSS)
    assert np.allclose(found.coordinates[:, 0], q[0] + 0.2 * np.arange(3), atol=1e-4)
    assert np.allclose(found.coordinates[:, 2], q[2] - 0.2 * np.arange(3), atol=1e-4)
    assert (found.sd[:, 7] == 0).all(), "what is locked is known"
    with pytest.raises(AsterismError, match="a joint of it slides"):
        found.motion()


def test_a_simm_spline_goes_through_its_points_smoothly_and_ends_like_their_cubics() -> None:
    x, y = np.array([-2.0, -1.2, 0.1, 0.5, 1.4, 2.0]), np.array([0.3, -0.1, 0.2, 0.6, 0.5, -0.4])
    a, b, c, d = simm_spline(x, y).T
    u = np.diff(x)
    assert np.allclose((a + b * np.append(u, 0) + c * np.append(u, 0) ** 2 + d * np.append(u, 0) ** 3)[:-1], y[1:])
    assert np.allclose((b[:-1] + 2 * c[:-1] * u + 3 * d[:-1] * u**2)[:-1], b[1:-1]), "first derivatives meet"
    assert np.allclose((2 * c[:-1] + 6 * d[:-1] * u)[:-1], 2 * c[1:-1]), "second derivatives meet"
    assert d[0] == pytest.approx(np.polyfit(x[:4], y[:4], 3)[0])
    assert d[-2] == pytest.approx(np.polyfit(x[-4:], y[-4:], 3)[0])


def test_an_opensim_model_that_cannot_be_read_says_why(osim) -> None:
    text = osim.read_text()
    for wrong, right, said in (
        ("<JointSet>", "<Joints>", "hangs on no joint"),
        ("meters", "inches", "save it in meters"),
        (
            "<MultiplierFunction><function><SimmSpline><x>-2 -1 0 0.5 1</x>",
            "<MultiplierFunction><function><SimmSpline><x>-2 -1 0 0 1</x>",
            "points in order",
        ),
        ("/bodyset/patella</socket_parent_frame>", "/bodyset/hat</socket_parent_frame>", "hangs on no joint"),
    ):
        osim.write_text(text.replace(wrong, right).replace("</JointSet>", "</Joints>" if "Joints" in right else "</JointSet>"))
        with pytest.raises(AsterismError, match=said):
            load_osim(osim)
