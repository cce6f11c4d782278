"""Rig files: ours bit for bit; others' by what their numbers mean, checked against points, plates and published residuals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Camera, Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector


def a_rig() -> Rig:
    one = Camera(
        "front left",
        (1280, 1024),
        (1500.125, 1490.0),
        (640.1, 500.2),
        rotation_from_vector([0.2, -0.4, 0.1]),
        np.array([0.1, -0.2, 3.0]),
        (-0.28, 0.1, 0.02, 0.001),
        (0.0011, -0.0007),
        (0.1, 0.2, 0.3),
        error=0.21,
    )
    two = Camera("2", None, (800.0, 800.0), (320.0, 240.0), posed=False)
    return Rig((one, two), np.array([0.0, 0.6, 0.8]), {"file": "x.c3d", "residuals": {"wand, m": [1e-3, np.nan]}}, ("image sizes",))


def same_cameras(one: Rig, other: Rig) -> bool:
    return one.names == other.names and all(
        np.array_equal(a.lens, b.lens)
        and np.array_equal(a.rotation, b.rotation)
        and np.array_equal(a.translation, b.translation)
        and (a.size, a.posed, repr(a.error)) == (b.size, b.posed, repr(b.error))
        for a, b in zip(one, other, strict=True)
    )


def test_our_file_brings_everything_back_bit_for_bit(tmp_path: Path) -> None:
    rig = a_rig()
    assert write_rig(rig, tmp_path / "rig.toml") == []
    again = read_rig(tmp_path / "rig.toml")
    assert same_cameras(rig, again)
    assert np.array_equal(again.vertical, rig.vertical)  # type: ignore[arg-type]
    assert again.lacks == rig.lacks
    assert repr(again.metadata) == repr(rig.metadata)


@pytest.mark.parametrize(
    ("find", "put", "said"),
    [
        ("version = 1", "version = 7", "later Asterism"),
        ("version = 1", "version = 'x'", "format version"),
        ("focal = [1500.125, 1490.0]", "", "camera front left: no focal"),
        ("focal = [1500.125, 1490.0]", "focal = [1500.125]", "camera front left"),
        ("focal = [1500.125, 1490.0]", "focal = ['a', 'b']", "camera front left"),
        ("focal = [1500.125, 1490.0]", "focal = [-1.0, 2.0]", "focal length must be positive"),
        ("focal = [1500.125, 1490.0]", "focal = [1500.125, 14", "no TOML"),
        ('name = "2"', 'name = "front left"', "called front left"),
        ("translation = [0.1, -0.2, 3.0]", "", "no translation"),
        ("translation = [0.1, -0.2, 3.0]", "translation = [nan, 0.0, 0.0]", "finite"),
        ("[[camera]]", "[[kamera]]", "at least one camera"),
    ],
)
def test_a_damaged_file_of_ours_is_refused(tmp_path: Path, find: str, put: str, said: str) -> None:
    path = tmp_path / "rig.toml"
    write_rig(a_rig(), path)
    text = path.read_text(encoding="utf-8")
    assert find in text
    path.write_text(text.replace(find, put), encoding="utf-8")
    with pytest.raises(AsterismError) as caught:
        read_rig(path)
    assert said in str(caught.value) and str(path) in str(caught.value)


def test_a_file_that_breaks_off_is_refused_or_lacks_nothing_that_was_written(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    write_rig(replace(a_rig(), metadata={}), path)
    data = path.read_bytes()
    whole = len(data.rstrip())
    for end in range(0, whole - 1, 17):
        path.write_bytes(data[:end])
        try:
            rig = read_rig(path)
        except AsterismError:
            continue
        assert rig.names == ("front left",) or len(rig) == 2


# Other people's formats


SAMPLES = (
    "charuco-4cam/camera_array.toml",
    "charuco-4cam/config.toml",
    "chessboard-stereo/intrinsics.yml",
    "chessboard-stereo/left_intrinsics.yml",
    "particles-4cam",
    "particles-4cam/cam1.tif.ori",
    "particles-4cam/cam2.tif.ori",
    "particles-4cam/cam3.tif.ori",
    "particles-4cam/cam4.tif.ori",
    "qualisys/Calib.qca.txt",
    "rigs/anipose-12cam.toml",
    "rigs/anipose-7cam.toml",
    "rigs/human36m.json",
    "rigs/shelf-5cam.json",
    "vicon/testCalibration.xcp",
    "vicon-rig-walk/walking_1.xcp",
)
ROOMS = ("particles-4cam", "qualisys/Calib.qca.txt", "rigs/human36m.json", "rigs/shelf-5cam.json", "vicon-rig-walk/walking_1.xcp")


def seen_pixels(camera: Camera, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Pixels all over the middle 90 % of the image, and points 3 m away that are seen there."""
    size = np.array(camera.size or (2 * camera.centre[0], 2 * camera.centre[1]))
    pixels = np.random.default_rng(5).uniform(0.05, 0.95, (count, 2)) * size
    return pixels, camera.position + 3.0 * camera.rays(pixels)


def worst_pixel(one: Rig, other: Rig) -> float:
    worst = 0.0
    for a, b in zip(one, other, strict=True):
        pixels, points = seen_pixels(a)
        there = np.isfinite(points[:, 0])
        worst = max(worst, float(np.abs(b.project(points[there]) - pixels[there]).max()))
    return worst


def posed_rig(distorted: bool = True, tangential: bool = False) -> Rig:
    """Four cameras on a ring of 4 m that look at its middle, 1 m above the floor; z is up."""
    cameras = []
    for i in range(4):
        angle = 0.3 + 1.5 * i
        place = np.array([4 * np.cos(angle), 4 * np.sin(angle), 2.5])
        ahead = np.array([0.0, 0.0, 1.0]) - place
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(ahead, right), ahead])
        radial = (-0.12 - 0.01 * i, 0.05) if distorted else ()
        bend = (0.0004, -0.0003) if tangential else (0.0, 0.0)
        focal = 1400.0 + 5 * i
        cameras.append(Camera(str(i + 1), (1280, 1024), (focal, focal), (630.0 + i, 515.0), turn, -turn @ place, radial, bend, error=0.2))
    return Rig(tuple(cameras))


@pytest.mark.parametrize("name", SAMPLES)
def test_every_sample_file_is_read_and_says_what_it_lacks(data: Path, name: str) -> None:
    rig = read_rig(data / "cameras" / name)
    assert rig.lacks
    assert not any("middle of the image" in phrase for phrase in rig.lacks)
    assert rig.metadata["format"]
    for camera in rig:
        if camera.size is not None:
            width = camera.size[0]
            assert 0.3 * width < camera.focal[0] < 10 * width
            assert camera.focal[1] == pytest.approx(camera.focal[0], rel=0.03)
        pixels, points = seen_pixels(replace(camera, posed=True))
        there = np.isfinite(points[:, 0])
        assert there.mean() > 0.9, f"{camera.name}: {there.mean():.0%} of the image has a ray"
        assert np.abs(camera.project(points[there]) - pixels[there]).max() < 1e-6


@pytest.mark.parametrize("name", ROOMS)
def test_the_cameras_of_a_room_look_at_one_place(data: Path, name: str) -> None:
    rig = read_rig(data / "cameras" / name)
    places, ahead = (
        np.stack([camera.position for camera in rig]),
        np.stack([camera.rays(np.array(camera.size or (1000, 700)) / 2) for camera in rig]),
    )
    across = [np.eye(3) - np.outer(direction, direction) for direction in ahead]
    middle = np.linalg.solve(sum(across), sum(a @ place for a, place in zip(across, places, strict=True)))
    towards = middle - places
    cosines = (towards * ahead).sum(axis=1) / np.linalg.norm(towards, axis=1)
    assert cosines.min() > 0.85, dict(zip(rig.names, cosines.round(2), strict=True))
    if name.startswith(("qualisys", "vicon", "rigs")):
        assert (places[:, 2] > 0.8).all() and (middle[2] < places[:, 2].mean()), "metres above the floor"


def _masked(path: Path) -> dict[str, np.ndarray]:
    """The middles (n, 2) px of the blotches that each camera of an .xcp was told to ignore: mostly other cameras' lamps."""
    import xml.etree.ElementTree as ET

    from scipy import ndimage

    found = {}
    for element in ET.parse(path).getroot().iter("Camera"):
        grid = element.find("ThresholdGrid")
        if grid is None:
            continue
        width, height = map(int, grid.attrib["GRID_SIZE"].split())
        tile = np.array(list(map(int, grid.attrib["TILE_SIZE"].split())))
        cells: list[int] = []
        words, runs, i = grid.attrib["DATA"].split(), True, 0
        while i < len(words):
            if words[i] in "rv":
                runs = words[i] == "r"
            elif runs:
                cells += [int(words[i + 1])] * int(words[i])
                i += 1
            else:
                cells.append(int(words[i]))
            i += 1
        blotches, count = ndimage.label(np.array(cells).reshape(height, width) > 0, np.ones((3, 3)))
        if count:
            middles = np.array(ndimage.center_of_mass(blotches > 0, blotches, range(1, count + 1)))
            for key in ("USERID", "DEVICEID"):
                found[element.attrib[key]] = (middles[:, ::-1] + 0.5) * tile
    return found


@pytest.mark.parametrize(("name", "share"), [("vicon/testCalibration.xcp", 0.35), ("vicon-rig-walk/walking_1.xcp", 0.6)])
def test_vicon_cameras_see_each_other_where_they_are_masked(data: Path, name: str, share: float) -> None:
    """Quaternion, position, handedness and lens at once: other cameras' lamps were masked in the image where they must be seen.

    With either axis of the image turned round, next to none is; and far from the middle only our direction of the lens model hits.
    """
    path = data / "cameras" / name
    rig, masks = read_rig(path), _masked(path)

    def hits(mirror: tuple[float, float]) -> float:
        near = []
        for camera in rig:
            others = np.stack([other.position for other in rig if other.name != camera.name])
            if camera.name not in masks or camera.size is None:
                continue
            seen = camera.project(others)
            seen = np.array(camera.centre) + (seen - camera.centre) * mirror
            inside = np.isfinite(seen[:, 0]) & (seen > 0).all(axis=1) & (seen < camera.size).all(axis=1)
            near += [np.linalg.norm(masks[camera.name] - pixel, axis=1).min() < 20 for pixel in seen[inside]]
        return float(np.mean(near))

    assert hits((1, 1)) > share
    assert max(hits((-1, 1)), hits((1, -1)), hits((-1, -1))) < 0.1


def test_vicon_residuals_and_lens_fits_are_told(data: Path) -> None:
    rig = read_rig(data / "cameras" / "vicon" / "testCalibration.xcp")
    assert len(rig) == 25
    infrared = [camera.error for camera in rig if camera.size != (1920, 1080)]
    assert min(infrared) > 0.12 and max(infrared) < 0.24, "0.13 to 0.23 px, says Nexus"
    assert max(rig.metadata["lens_fit_px"].values()) < 0.2
    walk = read_rig(data / "cameras" / "vicon-rig-walk" / "walking_1.xcp")
    assert max(walk.metadata["lens_fit_px"].values()) < 0.03


def test_the_walk_of_the_vicon_rig_is_in_view(data: Path) -> None:
    from asterism import formats

    walk = formats.read(data / "cameras" / "vicon-rig-walk" / "walking_1.c3d")
    rig = read_rig(data / "cameras" / "vicon-rig-walk" / "walking_1.xcp")
    points = walk.positions[:: max(1, len(walk) // 50)].reshape(-1, 3)
    points = points[np.isfinite(points[:, 0])]
    pixels = rig.project(points)
    inside = (pixels > 0).all(axis=2) & (pixels < np.array(rig.cameras[0].size)).all(axis=2)
    assert inside.sum(axis=0).min() >= 3, f"each marker in view of {inside.sum(axis=0).mean():.1f} cameras on average"


def test_openptv_cameras_see_the_plate_through_window_and_water(data: Path) -> None:
    """The peer's own target points and its 2D detections of them; without the window the same cameras miss by some 17 px."""
    from asterism.cameras.files import openptv

    folder = data / "cameras" / "particles-4cam"
    plate = np.loadtxt(folder / "target_on_a_side.txt")[:, 1:] / 1000
    rig = read_rig(folder)
    assert all(fit["rms"] < 0.25 and fit["largest"] < 1.2 for fit in rig.metadata["fit_px"].values())
    for camera in rig:
        spots = np.loadtxt(folder / f"{camera.name}.tif_targets", skiprows=1)[:, 1:3] - 0.5  # the peer counts from the corner

        def miss(camera: Camera, spots: np.ndarray = spots) -> float:
            return float(np.median(np.linalg.norm(camera.project(plate)[:, None] - spots, axis=2).min(axis=1)))

        file = folder / f"{camera.name}.tif.ori"
        setup = replace(openptv._setup(file), indices=(1.0, 1.0, 1.0))
        in_air, _ = openptv._as_camera(file, camera.name, openptv._orientation(file), setup)
        assert miss(camera) < 2.0 < 10.0 < miss(in_air), f"{camera.name}: {miss(camera):.2f} px, in air {miss(in_air):.1f} px"


def test_qualisys_principal_points_are_near_the_middle_and_residuals_stay_millimetres(data: Path) -> None:
    rig = read_rig(data / "cameras" / "qualisys" / "Calib.qca.txt")
    for camera in rig:
        assert camera.size == (1088, 1920)
        assert np.abs(np.array(camera.centre) - np.array(camera.size) / 2).max() < 40
        assert -0.06 < camera.radial[0] < -0.03, "of the normalized plane, not sub-pixels"
    assert rig.metadata["residuals_mm"]["cam04"] == 0.504772


@pytest.mark.parametrize("name", ["a.toml", "b.anipose.toml", "camera_array.toml", "d.yml", "e.xml", "f.xcp", "g.qca.txt"])
def test_a_rig_survives_every_format(tmp_path: Path, name: str) -> None:
    rig = posed_rig()
    write_rig(rig, tmp_path / name)
    again = read_rig(tmp_path / name)
    assert worst_pixel(rig, again) < (0.05 if name == "f.xcp" else 1e-7)
    assert [camera.size for camera in again] == [camera.size for camera in rig]
    if name != "camera_array.toml":
        assert again.names == rig.names
    assert np.allclose([camera.position for camera in again], [camera.position for camera in rig], atol=1e-9)


@pytest.mark.parametrize("tangential", [False, True])
def test_a_rig_survives_openptv(tmp_path: Path, tangential: bool) -> None:
    rig = posed_rig(distorted=False, tangential=tangential)
    write_rig(rig, tmp_path / "rig.ori")
    again = read_rig(tmp_path)
    assert worst_pixel(rig, again) < 0.1
    assert again.names == tuple(f"rig_{name}" for name in rig.names)
    assert not any("window" in phrase for phrase in again.lacks), "in air"
    assert bool(again.metadata["fit_px"]) == tangential, "without a lens nothing is fitted"


def test_the_same_rig_through_two_files_of_opencv(tmp_path: Path) -> None:
    """Intrinsics and extrinsics apart, as many write them: R and T of the second camera relative to the first."""
    (tmp_path / "intrinsics.yml").write_text(
        "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]\n"
        "D1: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: [ -0.1, 0.01, 0.001, 0.002, 0. ]\n"
        "M2: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 505., 0., 330., 0., 515., 250., 0., 0., 1. ]\n"
    )
    (tmp_path / "extrinsics.yml").write_text(
        "%YAML:1.0\n---\nR: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]\n"
        "T: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ -0.2, 0., 0. ]\n"
    )
    rig = read_rig(tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml")
    assert rig.names == ("1", "2")
    assert rig["1"].tangential == (0.001, 0.002)
    assert np.allclose(rig["2"].position, [0.2, 0.0, 0.0])
    assert not any(camera.posed for camera in read_rig(tmp_path / "intrinsics.yml"))


def test_a_lens_that_a_format_cannot_say_is_fitted_or_refused(tmp_path: Path) -> None:
    one = posed_rig().cameras[0]
    mild = Rig((replace(one, radial=(-0.1, 0.02, 0.001, 0.0002)),))
    [lost] = write_rig(mild, tmp_path / "mild.yml") or ["nothing"]
    assert "lens" in lost or lost == "nothing"
    assert worst_pixel(mild, read_rig(tmp_path / "mild.yml")) < 0.01
    with pytest.raises(AsterismError, match="miss by"):
        write_rig(Rig((replace(one, tangential=(0.02, 0.0)),)), tmp_path / "bent.xcp")
    assert not (tmp_path / "bent.xcp").exists()
    with pytest.raises(AsterismError, match="OpenPTV's misses by"):
        write_rig(Rig((replace(one, radial=(-0.3, 0.1), centre=(400.0, 700.0)),)), tmp_path / "aside.ori")
    assert not (tmp_path / "aside.ori").exists()
    with pytest.raises(AsterismError, match="no pose"):
        write_rig(Rig((replace(one, posed=False),)), tmp_path / "x.anipose.toml")
    with pytest.raises(AsterismError, match=r"\.toml"):
        write_rig(mild, tmp_path / "rig.dat")


def test_a_fisheye_lens_is_fitted(tmp_path: Path) -> None:
    import cv2

    matrix, k = np.array([[700.0, 0, 640], [0, 700, 360], [0, 0, 1]]), np.array([0.02, -0.01, 0.003, 0.0])
    (tmp_path / "fish.toml").write_text(
        f"[cam_0]\nname='wide'\nsize=[1280,720]\nmatrix={matrix.tolist()}\ndistortions={k.tolist()}\nfisheye=true\n"
        "rotation=[0.0,0.0,0.0]\ntranslation=[0.0,0.0,1000.0]\n"
    )
    [camera] = read_rig(tmp_path / "fish.toml")
    flat = np.random.default_rng(1).uniform([-1.0, -0.5], [1.0, 0.5], (200, 2))
    expected = cv2.fisheye.distortPoints(flat[:, None], matrix, k)[:, 0]
    seen = replace(camera, translation=np.zeros(3)).project(np.column_stack([flat, np.ones(200)]))
    assert np.abs(seen - expected).max() < 0.02


def test_a_fisheye_upright_and_of_unknown_size_is_fitted_to_its_corners(tmp_path: Path) -> None:
    """Its principal point is taken for the middle: 600 x 1200 px, of which the corners are seen 64 degrees aside."""
    import cv2

    matrix = np.array([[600.0, 0, 300], [0, 600, 600], [0, 0, 1]])
    (tmp_path / "fish.toml").write_text(f"[cam_0]\nname='tall'\nmatrix={matrix.tolist()}\ndistortions=[0.0,0.0,0.0,0.0]\nfisheye=true\n")
    [camera] = read_rig(tmp_path / "fish.toml")
    pixels = np.array([[x, y] for x in (0.0, 150.0, 300.0, 600.0) for y in (0.0, 400.0, 1200.0)])
    flat = cv2.fisheye.undistortPoints(pixels[:, None], matrix, np.zeros(4))[:, 0]
    seen = replace(camera, posed=True).project(np.column_stack([flat, np.ones(len(flat))]))
    assert np.abs(seen - pixels).max() < 0.1


def _damage(text: str) -> list[str]:
    """Cut short at many places, and one number at a time made no number."""
    cut = [text[:end] for end in range(0, len(text) - 2, max(1, len(text) // 12))]
    words = [word for word in text.replace('"', " ").replace("[", " ").replace(",", " ").split() if word[-1].isdigit() and "." in word]
    return cut + [text.replace(word, "what?") for word in words[:12]]


@pytest.mark.parametrize("name", ["b.anipose.toml", "camera_array.toml", "d.yml", "e.xml", "f.xcp", "g.qca.txt", "h.ori", "human.json"])
def test_damage_ends_in_one_sentence_that_names_the_file(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name.endswith(".json"):
        path.write_text(
            '{"0": {"R": [[1.0,0,0],[0,1.0,0],[0,0,1.0]], "T": [1.0, 2.5, 3.5], "fx": 900.5, "fy": 900.5, "cx": 3.5, "cy": 4.5}}'
        )
    else:
        write_rig(replace(posed_rig(), cameras=posed_rig().cameras[:1]), path)
    text = path.read_text(encoding="utf-8")
    read_rig(path)
    refused = 0
    for damaged in _damage(text):
        path.write_text(damaged, encoding="utf-8")
        try:
            read_rig(path)
        except AsterismError as problem:
            refused += 1
            assert str(path) in str(problem) and "\n" not in str(problem)
    assert refused >= 12


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("fish.toml", "[cam_0]\nmatrix=[[300.0,0,640],[0,300.0,360],[0,0,1.0]]\ndistortions=[0.01,0,0,0]\nfisheye=true\n", "fisheye"),
        ("board.toml", "columns = 4\n", "no rig file"),
        ("list.yml", "%YAML:1.0\n---\nimages:\n   - a.jpg\n", "calibrate board"),
        ("x.xcp", "<Cameras></Cameras>", "no calibrated camera"),
        ("x.qca.txt", "<html></html>", "<html>"),
        ("x.json", "[1, 2]", "no rig"),
        ("x.ori", "1 2 3", "ptv.par"),
        ("x.addpar", "0 0 0 0 0 1 0", ".ori"),
    ],
)
def test_files_that_hold_no_rig_are_told_apart(tmp_path: Path, name: str, text: str, said: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(AsterismError) as caught:
        read_rig(tmp_path / name)
    assert said in str(caught.value) and name in str(caught.value)


def test_info_and_convert_know_rigs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import json

    from asterism.cli import main

    write_rig(posed_rig(), tmp_path / "rig.toml")
    assert main(["convert", str(tmp_path / "rig.toml"), str(tmp_path / "rig.qca.txt"), "--vertical", "z"]) == 0
    assert "leaves out the vertical" in capsys.readouterr().err
    assert main(["info", str(tmp_path / "rig.qca.txt"), "--json", "-"]) == 0
    [told] = json.loads(capsys.readouterr().out)["files"]
    assert [camera["name"] for camera in told["cameras"]] == ["1", "2", "3", "4"]
    assert told["cameras"][0]["position"] == pytest.approx(posed_rig().cameras[0].position.tolist())
    assert any("which way is up" in phrase for phrase in told["lacks"])
    assert main(["info", str(tmp_path / "rig.toml")]) == 0
    assert "1280 x 1024" in capsys.readouterr().out
