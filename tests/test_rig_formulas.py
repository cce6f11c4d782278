"""Points projected through each reader against the format's own formula, written here from its published model, not by our writers."""

from __future__ import annotations

import json
import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from counting import calls
from scipy.optimize import brentq, minimize

from asterism.cameras import Camera, Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.errors import AsterismError

RNG = np.random.default_rng(8)


def in_sight(camera: Camera, count: int = 60) -> np.ndarray:
    """Points 2 to 6 m before a camera, in the middle 80 % of its image."""
    size = np.array(camera.size or (2 * camera.centre[0], 2 * camera.centre[1]))
    return camera.position + RNG.uniform(2, 6, (count, 1)) * camera.rays(RNG.uniform(0.1, 0.9, (count, 2)) * size)


def by_opencv(points: np.ndarray, rotation: np.ndarray, translation: np.ndarray, matrix: np.ndarray, lens: np.ndarray) -> np.ndarray:
    vector = np.asarray(rotation, float) if np.size(rotation) == 3 else cv2.Rodrigues(np.asarray(rotation, float))[0]
    return cv2.projectPoints(points, vector, np.asarray(translation, float), np.asarray(matrix, float), np.asarray(lens, float))[0][:, 0]


@pytest.mark.parametrize(("name", "unit"), [("rigs/anipose-12cam.toml", 1e-3), ("charuco-4cam/camera_array.toml", 1.0)])
def test_toml_tables_project_as_opencv_does(data: Path, name: str, unit: float) -> None:
    document = tomllib.loads((data / "cameras" / name).read_text())
    tables = [table for table in document.get("cameras", document).values() if "matrix" in table]
    rig = read_rig(data / "cameras" / name)
    for camera, table in zip(rig, tables, strict=True):
        points = in_sight(camera)
        seen = by_opencv(points, table["rotation"], unit * np.array(table["translation"]), table["matrix"], table["distortions"])
        assert np.abs(camera.project(points) - seen).max() < 1e-6


def test_research_json_projects_as_its_papers_say(data: Path) -> None:
    human = json.loads((data / "cameras" / "rigs" / "human36m.json").read_text())
    subject = next(iter(human["extrinsics"]))
    for camera in read_rig(data / "cameras" / "rigs" / "human36m.json"):
        pose, lens = human["extrinsics"][subject][camera.name], human["intrinsics"][camera.name]
        points = in_sight(camera)
        seen = by_opencv(points, pose["R"], 1e-3 * np.array(pose["t"]).ravel(), lens["calibration_matrix"], lens["distortion"])
        assert np.abs(camera.project(points) - seen).max() < 0.01, "R has few decimals"
    shelf = json.loads((data / "cameras" / "rigs" / "shelf-5cam.json").read_text())
    for camera in read_rig(data / "cameras" / "rigs" / "shelf-5cam.json"):
        table, points = shelf[camera.name], in_sight(camera)
        ahead = (points - 1e-3 * np.array(table["T"]).ravel()) @ np.array(table["R"]).T
        seen = np.array([table["fx"], table["fy"]]) * ahead[:, :2] / ahead[:, 2:] + [table["cx"], table["cy"]]
        assert np.abs(camera.project(points) - seen).max() < 0.05


@pytest.mark.parametrize("name", ["vicon/testCalibration.xcp", "vicon-rig-walk/walking_1.xcp"])
def test_vicon_pixels_become_ideal_ones_by_its_polynomial(data: Path, name: str) -> None:
    """Nexus: the quaternion x, y, z, w is camera from world; ideal = distorted (1 + k1 r2 + k2 r4 + k3 r6), r2 of the distorted."""
    elements = {}
    for element in ET.parse(data / "cameras" / name).getroot().iter("Camera"):
        elements |= {element.get(key): element for key in ("DEVICEID", "USERID")}
    rig = read_rig(data / "cameras" / name)
    for camera in rig:
        frame = elements[camera.name].find("KeyFrames/KeyFrame").attrib
        x, y, z, w = np.array(frame["ORIENTATION"].split(), float)
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        lens = np.array(frame["VICON_RADIAL2"].split()[3:] if "VICON_RADIAL2" in frame else frame["VICON_RADIAL"].split(), float)
        middle, focal = np.array(frame["PRINCIPAL_POINT"].split(), float), float(frame["FOCAL_LENGTH"])
        reach = 0.35 * np.hypot(*camera.size)
        for point in in_sight(camera, 12):
            ahead = turn @ (1000 * point - np.array(frame["POSITION"].split(), float))
            ideal = focal * ahead[:2] / ahead[2]
            radius = np.hypot(*ideal)
            if radius > reach:
                continue

            def off(r: float, radius: float = radius, lens: np.ndarray = lens) -> float:
                return r * (1 + sum(k * r ** (2 * i + 2) for i, k in enumerate(lens))) - radius

            there = brentq(off, 0, 1.3 * reach)
            assert camera.project(point) == pytest.approx(middle + ideal * there / radius, abs=0.2)


def test_qualisys_pixels_are_sixty_fourths(data: Path) -> None:
    """QTM: rows of r are the camera's axes right, up, backwards; lengths in mm, lenses in 1/64 px, distortion of the normalized plane."""
    root = ET.parse(data / "cameras" / "qualisys" / "Calib.qca.txt").getroot()
    for camera, element in zip(read_rig(data / "cameras" / "qualisys" / "Calib.qca.txt"), root.iter("camera"), strict=True):
        pose = {key: float(value) for key, value in element.find("transform").attrib.items()}
        lens = {key: float(value) for key, value in element.find("intrinsic").attrib.items()}
        points = in_sight(camera)
        axes = np.array([[pose[f"r{i}{j}"] for j in (1, 2, 3)] for i in (1, 2, 3)])
        right, up, back = ((1000 * points - [pose["x"], pose["y"], pose["z"]]) @ axes.T).T
        x, y = right / -back, up / back
        s = x * x + y * y
        radial = 1 + s * (lens["radialDistortion1"] + s * (lens["radialDistortion2"] + s * lens["radialDistortion3"]))
        p1, p2 = lens["tangentalDistortion1"], lens["tangentalDistortion2"]
        u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
        v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
        seen = np.stack([lens["focalLengthU"] * u + lens["centerPointU"], lens["focalLengthV"] * v + lens["centerPointV"]], axis=1) / 64
        assert np.abs(camera.project(points) - seen).max() < 1e-3


def openptv_folder(folder: Path, *, lens: str, indices: str, window: str) -> Path:
    (folder / "parameters").mkdir()
    (folder / "parameters" / "ptv.par").write_text(f"1\nimg/a\ncal/a\n1\n0\n1\n1280\n1024\n0.012\n0.012\n0\n{indices}\n")
    (folder / "parameters" / "criteria.par").write_text("-40 -20 20\n40 -20 20\n0.02 0.02\n")
    turn = cv2.Rodrigues(np.array([0.05, -0.08, 0.02]))[0]
    rows = "\n".join(" ".join(f"{value:.12f}" for value in row) for row in turn)
    (folder / "a.ori").write_text(f"30.0 20.0 500.0\n 0 0 0\n\n{rows}\n\n0.11 -0.07\n60.0\n\n{window}\n")
    (folder / "a.addpar").write_text(lens)
    return folder / "a.ori"


def openptv_pixel(ahead: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """The pixel, counted from the centre of the first, of a direction in the camera's axes: right, up, backwards."""
    k1, k2, k3, p1, p2, scale, shear = lens
    x, y = -60.0 * ahead[:2] / ahead[2] + [0.11, -0.07]
    s = x * x + y * y
    factor = 1 + k1 * s + k2 * s**2 + k3 * s**3
    u, v = x * factor + p1 * (s + 2 * x * x) + 2 * p2 * x * y, y * factor + p2 * (s + 2 * y * y) + 2 * p1 * x * y
    metric = np.array([scale * u - np.sin(shear) * v, np.cos(shear) * v])
    return np.array([640.0, 512.0]) + metric * [1, -1] / 0.012 - 0.5


def test_openptv_in_air_with_a_lens(tmp_path: Path) -> None:
    lens = np.array([-1e-5, 1e-8, 0.0, 2e-5, -1e-5, 1.001, 0.00002])
    path = openptv_folder(tmp_path, lens=" ".join(map(str, lens)), indices="1 1 1 0", window="0 0 1")
    axes = np.array([line.split() for line in path.read_text().splitlines()[3:6]], float)
    [camera] = read_rig(path)
    points = RNG.uniform([-40, -30, -40], [60, 50, 40], (60, 3))
    seen = np.array([openptv_pixel(axes.T @ (point - [30.0, 20.0, 500.0]), lens) for point in points])
    inside = (seen > 0).all(axis=1) & (seen < camera.size).all(axis=1)
    assert inside.sum() > 10
    assert np.abs(camera.project(1e-3 * points) - seen)[inside].max() < 0.1, "half a pixel, where its pixels are ours"


def test_openptv_through_a_window_takes_the_quickest_way(tmp_path: Path) -> None:
    """Fermat: of all ways through glass and water light takes that of least optical length."""
    path = openptv_folder(tmp_path, lens="0 0 0 0 0 1 0", indices="1.0 1.46 1.33 6.0", window="0 0 120")
    axes = np.array([line.split() for line in path.read_text().splitlines()[3:6]], float)
    eye = np.array([30.0, 20.0, 500.0])
    rig = read_rig(path)
    seen = []
    points = RNG.uniform([-20, -30, -20], [40, 30, 20], (40, 3))
    for point in points:

        def length(q: np.ndarray, point: np.ndarray = point) -> float:
            outer, inner = np.array([q[0], q[1], 126.0]), np.array([q[2], q[3], 120.0])
            return float(np.linalg.norm(eye - outer) + 1.46 * np.linalg.norm(outer - inner) + 1.33 * np.linalg.norm(inner - point))

        start = point[:2] + (eye - point)[:2] * 0.3
        way = minimize(
            length, np.tile(start, 2), tol=1e-14, method="Nelder-Mead", options={"maxiter": 4000, "xatol": 1e-9, "fatol": 1e-12}
        ).x
        seen.append(openptv_pixel(axes.T @ (np.array([way[0], way[1], 126.0]) - eye), np.array([0, 0, 0, 0, 0, 1.0, 0])))
    inside = (np.array(seen) > 0).all(axis=1) & (np.array(seen) < rig.cameras[0].size).all(axis=1)
    off = np.linalg.norm(rig.cameras[0].project(1e-3 * points) - np.array(seen), axis=1)[inside]
    fit = rig.metadata["fit_px"]["a"]
    assert inside.sum() > 8
    assert np.sqrt((off**2).mean()) < 2 * fit["rms"] < 0.3, "as closely as the fit says"
    assert off.max() < fit["largest"]


def test_openptv_without_limits_is_fitted_around_where_its_rays_pass_the_origin(tmp_path: Path) -> None:
    """Without criteria.par: to 0.2 of the 120 mm of water to either side, as closely as with limits of 24 mm."""
    for name in ("told", "untold"):
        (tmp_path / name).mkdir()
    paths = [
        openptv_folder(tmp_path / name, lens="0 0 0 0 0 1 0", indices="1.0 1.46 1.33 6.0", window="0 0 120") for name in ("told", "untold")
    ]
    (paths[0].parent / "parameters" / "criteria.par").write_text("-40 -24 24\n40 -24 24\n0.02 0.02\n")
    (paths[1].parent / "parameters" / "criteria.par").unlink()
    told, untold = (read_rig(path) for path in paths)
    assert any("depth" in phrase for phrase in untold.lacks) and not any("criteria" in phrase for phrase in told.lacks)
    points = 1e-3 * RNG.uniform([-20, -30, -24], [40, 30, 24], (400, 3))
    seen, as_seen = (rig.cameras[0].project(points) for rig in (told, untold))
    inside = (seen > 0).all(axis=1) & (seen < (1280, 1024)).all(axis=1)
    assert inside.sum() > 50
    assert np.abs(seen - as_seen)[inside].max() < 0.08
    assert untold.metadata["fit_px"]["a"]["rms"] == pytest.approx(told.metadata["fit_px"]["a"]["rms"], rel=0.3)


@pytest.mark.parametrize(
    ("pixels", "indices"),
    [
        ("0.0\n0.012", "1 1 1 0"),
        ("0.012\n-0.012", "1 1 1 0"),
        ("0.012\n0.012", "0.0 1.46 1.33 6.0"),
        ("0.012\n0.012", "1.0 -1.46 1.33 6.0"),
        ("0.012\n0.012", "1.0 1.46 0 6.0"),
        ("0.012\n0.012", "1.0 1.46 1.33 -6.0"),
    ],
)
def test_pixels_indices_and_windows_of_openptv_that_are_not_positive_are_refused(tmp_path: Path, pixels: str, indices: str) -> None:
    path = openptv_folder(tmp_path, lens="0 0 0 0 0 1 0", indices=indices, window="0 0 120")
    setup = tmp_path / "parameters" / "ptv.par"
    setup.write_text(setup.read_text().replace("0.012\n0.012", pixels))
    with pytest.raises(AsterismError, match=r"ptv\.par is damaged: .* not positive"):
        read_rig(path)


def xcp(tmp_path: Path, lens: str) -> Path:
    """One Vicon camera of 1000 x 800 px that looks along z, with a lens in its VICON_RADIAL2."""
    write_rig(Rig((Camera("1", (1000, 800), (1000.0, 1000.0), (500.0, 400.0), error=0.2),)), tmp_path / "a.xcp")
    text = (tmp_path / "a.xcp").read_text()
    before, _, after = text.partition("Vicon3Parameter ")
    (tmp_path / "a.xcp").write_text(f"{before}Vicon3Parameter {lens}{after[after.index(chr(34)) :]}")
    return tmp_path / "a.xcp"


def test_a_vicon_lens_that_bends_over_in_the_image_is_taken_up_to_there(tmp_path: Path) -> None:
    """ideal = r (1 - 5e-7 r2) rises by less than 0.6 per pixel beyond r = 516, that is 81 % of the way to the corners."""
    [camera] = rig = read_rig(xcp(tmp_path, "500.0 400.0 -5e-7 0 0"))
    [said] = [phrase for phrase in rig.lacks if "bends over" in phrase]
    assert "1 (beyond 81 % of the way)" in said or "1 (beyond 80 % of the way)" in said
    radius = np.linspace(20.0, 500.0, 25)
    ideal = radius * (1 - 5e-7 * radius**2) / 1000.0
    seen = camera.project(np.column_stack([ideal, np.zeros(25), np.ones(25)]))
    assert np.abs(seen - np.column_stack([500.0 + radius, np.full(25, 400.0)])).max() < 0.2
    assert not any("bends over" in phrase for phrase in read_rig(xcp(tmp_path, "500.0 400.0 -1e-7 0 0")).lacks)


def test_a_vicon_lens_may_be_off_its_principal_point_by_what_moves_no_pixel_by_a_tenth(tmp_path: Path) -> None:
    """d(k r3)/dr = 3 k r2: 0.123 at the corners, so that 0.7 px of the centre move a pixel by 0.086 px, and 0.9 px by 0.11 px."""
    [camera] = read_rig(xcp(tmp_path, "500.7 400.0 1e-7 0 0"))
    assert camera.centre == (500.0, 400.0)
    with pytest.raises(AsterismError, match="centre of its lens"):
        read_rig(xcp(tmp_path, "500.9 400.0 1e-7 0 0"))


# What is not sure, or wrong, is said


MATRIX = "{0}: !!opencv-matrix\n   rows: {1}\n   cols: {2}\n   dt: d\n   data: [ {3} ]\n"
HEAD = "%YAML:1.0\n---\n"


def yml(**values: object) -> str:
    text = HEAD
    for key, value in values.items():
        shape = np.atleast_2d(np.asarray(value)).shape
        cells = ", ".join(repr(float(v)) for v in np.ravel(value)) if not isinstance(value, str) else ""
        text += f"{key}: {value}\n" if isinstance(value, str | int) else MATRIX.format(key, *shape, cells)
    return text


K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])


@pytest.mark.parametrize("said", [{"fisheye_model": 1}, {"distortion_model": "equidistant"}])
def test_a_fisheye_of_opencv_is_not_read_as_a_pinhole(tmp_path: Path, said: dict[str, object]) -> None:
    lens = np.array([0.02, 0.01, 0.001, 0.002])
    (tmp_path / "a.yml").write_text(yml(image_width=640, image_height=480, camera_matrix=K, distortion_coefficients=lens, **said))
    [camera] = read_rig(tmp_path / "a.yml")
    flat = RNG.uniform([-0.6, -0.45], [0.6, 0.45], (50, 2))
    assert (
        np.abs(camera.project(np.column_stack([flat, np.ones(50)])) - cv2.fisheye.distortPoints(flat[:, None], K, lens)[:, 0]).max() < 0.1
    )


def test_one_lens_model_may_be_said_for_all_cameras_of_a_file(tmp_path: Path) -> None:
    lens = np.array([0.02, 0.01, 0.001, 0.002])
    (tmp_path / "a.yml").write_text(yml(fisheye_model=1, K1=K, D1=lens, K2=K, D2=lens, R=np.eye(3), T=np.array([-0.1, 0, 0])))
    (tmp_path / "b.yml").write_text(yml(fisheye_model=0, K1=K, D1=lens, K2=K, D2=lens, R=np.eye(3), T=np.array([-0.1, 0, 0])))
    fish, pinhole = (read_rig(tmp_path / name) for name in ("a.yml", "b.yml"))
    assert [camera.radial[0] < 0 for camera in fish] == [True, True], "a fisheye bends inwards"
    assert [camera.radial[0] for camera in pinhole] == [0.02, 0.02]


def test_four_coefficients_of_an_unknown_lens_are_said_and_other_models_refused(tmp_path: Path) -> None:
    (tmp_path / "a.yml").write_text(yml(K=K, D=np.array([0.1, 0.01, 0.001, 0.002])))
    assert any("fisheye" in phrase for phrase in read_rig(tmp_path / "a.yml").lacks)
    (tmp_path / "a.yml").write_text(yml(fisheye_model=0, K=K, D=np.array([0.1, 0.01, 0.001, 0.002])))
    assert not any("fisheye" in phrase for phrase in read_rig(tmp_path / "a.yml").lacks)
    (tmp_path / "a.yml").write_text(yml(K=K))
    assert any("distortion" in phrase for phrase in read_rig(tmp_path / "a.yml").lacks)
    (tmp_path / "a.yml").write_text(yml(distortion_model="double_sphere", K=K, D=np.zeros(4)))
    with pytest.raises(AsterismError, match="double_sphere"):
        read_rig(tmp_path / "a.yml")


def test_two_files_with_a_pose_each_are_no_stereo_pair(tmp_path: Path) -> None:
    for name, shift in (("a", [0.0, 0, 3]), ("b", [1.0, 0, 3])):
        (tmp_path / f"{name}.yml").write_text(yml(K=K, D=np.zeros(5), R=np.eye(3), T=np.array(shift)))
    rig = read_rig(tmp_path / "a.yml", tmp_path / "b.yml")
    assert np.allclose([camera.position for camera in rig], [[0, 0, -3], [-1, 0, -3]])


@pytest.mark.parametrize("values", [{"R": np.eye(3)}, {"T": np.array([0.3, 0, 0])}], ids=["a turn", "a shift"])
def test_half_a_pose_between_two_cameras_is_none(tmp_path: Path, values: dict[str, object]) -> None:
    (tmp_path / "a.yml").write_text(yml(M1=K, D1=np.zeros(5), M2=K, D2=np.zeros(5), **values))
    assert [camera.posed for camera in read_rig(tmp_path / "a.yml")] == [False, False]


def test_a_lone_camera_beside_a_rig_leaves_the_rigs_names_alone(tmp_path: Path) -> None:
    """The rig's cameras are called by numbers that are not their places; the other file's camera has no suffix."""
    cameras = [Camera(name, (640, 480), (500.0 + i, 500.0), (320.0, 240.0)) for i, name in enumerate(("1", "0"))]
    write_rig(Rig(tuple(cameras)), tmp_path / "rig.yml")
    (tmp_path / "lone.yml").write_text(yml(K=K, D=np.zeros(5), R=np.eye(3), T=np.array([1.0, 0, 3])))
    rig = read_rig(tmp_path / "lone.yml", tmp_path / "rig.yml")
    assert {camera.name: camera.focal[0] for camera in rig} == {"lone": 500.0, "1": 500.0, "0": 501.0}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"K": K.T, "D": np.zeros(5)}, "transposed"),
        ({"K": 2 * K, "D": np.zeros(5)}, "scaled"),
        ({"M1": K, "M2": K, "R": np.diag([-1.0, 1, 1]), "T": np.ones(3)}, "mirrors"),
        ({"M1": K, "M2": K, "R": 1.01 * np.eye(3), "T": np.ones(3)}, "right angles"),
    ],
)
def test_a_matrix_that_is_another_is_refused(tmp_path: Path, values: dict[str, object], said: str) -> None:
    (tmp_path / "a.yml").write_text(yml(**values))
    with pytest.raises(AsterismError, match=said) as caught:
        read_rig(tmp_path / "a.yml")
    assert "a.yml" in str(caught.value)


def test_a_rotation_with_four_decimals_is_one(tmp_path: Path) -> None:
    turn = cv2.Rodrigues(np.array([0.3, -0.5, 0.8]))[0]
    (tmp_path / "a.yml").write_text(yml(M1=K, D1=np.zeros(5), M2=K, D2=np.zeros(5), R=np.round(turn, 4), T=np.array([0.3, 0, 0])))
    assert np.abs(read_rig(tmp_path / "a.yml")["2"].rotation - turn).max() < 1e-4


def changed(data: Path, tmp_path: Path, name: str, find: str, put: str) -> Path:
    text = (data / "cameras" / name).read_text()
    assert find in text
    path = tmp_path / Path(name).name
    path.write_text(text.replace(find, put, 1))
    return path


def test_what_vicon_and_qualisys_do_otherwise_is_said_or_refused(data: Path, tmp_path: Path) -> None:
    name = "vicon/testCalibration.xcp"
    path = changed(data, tmp_path, name, "Vicon3Parameter 2076.158482997856", "Vicon3Parameter 2096.158482997856")
    with pytest.raises(AsterismError, match="centre of its lens"):
        read_rig(path)
    name = "qualisys/Calib.qca.txt"
    cropped = changed(data, tmp_path, name, '<fov_video bottom="1919" left="0"', '<fov_video bottom="1919" left="100"')
    assert any("videos of the whole sensor of cam01" in phrase for phrase in read_rig(cropped).lacks)
    assert not any("videos" in phrase for phrase in read_rig(data / "cameras" / name).lacks)
    half = changed(data, tmp_path, name, 'centerPointU="34110.316406"', 'centerPointU="17055.1"')
    assert any("middle of the image" in phrase and "cam01" in phrase for phrase in read_rig(half).lacks)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.json", "[" * 100_000),
        ("a.toml", "a = " + "[" * 100_000),
        ("a.json", '{"intrinsics": {"1": 3}, "extrinsics": {"S1": [1, 2]}}'),
        ("a.json", '{"intrinsics": {"1": 3}, "extrinsics": {"S1": {"1": [1]}}}'),
        ("a.xcp", '<?xml version="1.0" encoding="UTF-9"?><Cameras/>'),
        (
            "a.toml",
            'format = "asterism-rig"\nversion = 1\n[[camera]]\nname = "1"\nsize = [inf, 3.0]\nfocal = [1.0, 1.0]\ncentre = [0.0, 0.0]\n',
        ),
        ("a.toml", "[cam_0]\nsize = [1e300, 1000]\nmatrix = [[1000.0, 0, 500], [0, 1000.0, 500], [0, 0, 1]]\ndistortions = []\n"),
    ],
)
def test_strange_files_end_in_one_sentence(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(AsterismError, match=name):
        read_rig(tmp_path / name)


def test_long_lists_in_yaml_take_time_with_their_length(tmp_path: Path) -> None:
    """OpenCV itself finds the n-th item in n steps: 60,000 items would take seconds."""
    done = []
    for items in (5_000, 20_000):
        (tmp_path / "a.yml").write_text(yml(K=K, D=np.zeros(5)) + "points: [ " + "1.5, " * items + "1.5 ]\n")
        assert len(read_rig(tmp_path / "a.yml")) == 1
        done.append(sum(calls(lambda: read_rig(tmp_path / "a.yml")).values()))
    assert done[1] < 4.5 * done[0]


def test_a_lens_of_openptv_that_cannot_be_followed_is_refused(tmp_path: Path) -> None:
    path = openptv_folder(tmp_path, lens="0.01 0.01 0 0 0 1 0", indices="1.0 1.46 1.33 6.0", window="0 0 120")
    with pytest.raises(AsterismError, match="addpar"):
        read_rig(path)


NAMES = [("9", "6", "1", "0"), ("3", "1", "2", "0"), ("front left", "b", "c", "0"), ("1", "01", "_1", "K"), ("Rot", "R", "T", "1")]


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
@pytest.mark.parametrize("suffix", ["yml", "xml"])
@pytest.mark.parametrize("count", [1, 4])
def test_cameras_keep_their_names_in_opencvs_files(tmp_path: Path, names: tuple[str, ...], suffix: str, count: int) -> None:
    cameras = [Camera(name, (640, 480), (500.0 + i, 500.0), (320.0, 240.0), translation=[i, 0, 1.0]) for i, name in enumerate(names)]
    write_rig(Rig(tuple(cameras[:count])), tmp_path / f"a.{suffix}")
    again = read_rig(tmp_path / f"a.{suffix}")
    assert [(c.name, c.focal[0], c.translation[0]) for c in again] == [(name, 500.0 + i, i) for i, name in enumerate(names[:count])]


def test_a_unit_that_would_be_guessed_wrong_is_said_when_written(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from asterism.cli import main

    rig = read_rig(data / "cameras" / "qualisys" / "Calib.qca.txt")
    tiny = Rig(rig.moved(np.eye(3), np.zeros(3), 0.005).cameras)
    assert any("unit of length" in what for what in write_rig(tiny, tmp_path / "tiny.anipose.toml"))
    assert not any("unit of length" in what for what in write_rig(rig, tmp_path / "room.anipose.toml"))
    assert main(["convert", str(tmp_path / "room.anipose.toml"), str(tmp_path / "rig.toml")]) == 0
    assert "does not say the unit of length (millimetres taken" in capsys.readouterr().err


def test_a_camera_with_a_slash_in_its_name_is_no_openptv_file(tmp_path: Path) -> None:
    from dataclasses import replace

    camera = Camera("a/b", (640, 480), (500.0, 500.0), (320.0, 240.0))
    with pytest.raises(AsterismError, match="rename"):
        write_rig(Rig((camera, replace(camera, name="c"))), tmp_path / "x.ori")
