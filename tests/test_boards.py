"""Calibration from boards: a simulated room gives the rig back; drawn images, real images; footage as people have it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from computed import computed

from asterism.calibration.boards import Board, BoardCalibration, BoardViews, find_board, footage_of
from asterism.calibration.boards import calibrate_board as calibrate_anew
from asterism.calibration.boards.board import Finder
from asterism.cameras import Camera, Rig
from asterism.cameras.bundle import Sightings
from asterism.cameras.files import read_rig
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.geometry import rotation_from_vector, vector_from_rotation

BOARD = Board("chessboard", 9, 6, 0.05)


def calibrate_board(views: BoardViews, **settings: Any) -> BoardCalibration:
    """What `calibrate_anew` gives; most of a second for most rigs, so that it is worked out once for the same sources."""
    return computed(calibrate_anew, views, **settings)


def sentences(made: BoardCalibration) -> list[str]:
    return [str(finding) for finding in made.findings]


def ring(count: int = 5) -> Rig:
    """Cameras on an arc of 3 m that look at one place; each sees the board well only where its neighbours do."""
    cameras = []
    for i in range(count):
        angle = np.radians(55.0 * i)
        place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.5 + 0.2 * (i % 2)])
        ahead = np.array([0.0, 0.0, 1.0]) - place
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        turn = np.stack([right, np.cross(ahead, right), ahead])
        focal = 1200.0 + 20 * i
        cameras.append(
            Camera(f"cam_{i}", (1280, 1024), (focal, focal), (640.0 + 5 * i, 505.0), turn, -turn @ place, (-0.15, 0.06), (0.0004, -0.0003))
        )
    return Rig(tuple(cameras), vertical=np.array([0.0, 0.0, 1.0]))


def waved(
    rig: Rig,
    frames: int,
    noise: float = 0.1,
    seed: int = 1,
    towards: int | None = None,
    late: float = 0.0,
    *,
    board: Board = BOARD,
    misprint: tuple[float, float] = (0.0, 1.0),
) -> BoardViews:
    """A board that is held up in front of one camera after the other; a camera sees it from less than 60 degrees aside, in full.

    towards: only in front of this camera; late: the last camera sees the board where it will be so many frames later;
    misprint: how far the middle of the board stands out before its ends, m; how many times as wide as it should be it is.
    """
    random = np.random.default_rng(seed)
    bend, stretched = misprint
    points = board.points - board.points.mean(axis=0)
    points[:, 0] *= stretched
    points[:, 2] = -bend * (1 - (points[:, 0] / points[:, 0].max()) ** 2)
    paths = []
    for t in range(frames):
        facing = rig.cameras[(t * len(rig)) // frames if towards is None else towards]
        tilt = rotation_from_vector(random.normal(0, 0.35, 3))
        middle = np.array([0, 0, 1.0]) + 0.45 * (facing.position - [0, 0, 1]) * random.uniform(-0.3, 1) + random.normal(0, 0.25, 3)
        paths.append((facing.rotation.T @ tilt, middle))
    seen = np.full((frames, len(rig), len(points), 2), np.nan)
    for t, (turn, middle) in enumerate(paths):
        for c, camera in enumerate(rig):
            drift = late * random.normal(0, 0.02, 3) if c == len(rig) - 1 else 0.0
            pixels = camera.project(points @ turn.T + middle + drift)
            normal = turn[:, 2]
            ahead = middle - camera.position
            faces = normal @ ahead > 0.5 * np.linalg.norm(ahead)
            if faces and np.isfinite(pixels).all() and (pixels > 5).all() and (pixels < np.array(camera.size) - 5).all():
                seen[t, c] = pixels + random.normal(0, noise, pixels.shape)
    sightings, kept = Sightings.from_array(seen).compact()
    return BoardViews(board, rig.names, tuple(camera.size or (0, 0) for camera in rig), kept, sightings, (frames,) * len(rig))


def in_axes_of_first(rig: Rig) -> Rig:
    first = rig.cameras[0]
    return rig.moved(first.rotation, first.translation)


def test_a_chain_of_cameras_comes_back_though_no_pair_sees_all() -> None:
    truth = in_axes_of_first(ring())
    views = waved(ring(), 150)
    shared = (views.counts[:, :, None] > 0).astype(int) * (views.counts[:, None, :] > 0)
    assert shared.sum(axis=0)[0, -1] == 0, "the first and the last camera share nothing"
    made = calibrate_board(views)
    assert made.usable and not made.excluded and not made.findings
    assert made.rig.names == truth.names
    assert made.rms == pytest.approx(0.1 * np.sqrt(2), rel=0.08)
    for found, true in zip(made.rig, truth, strict=True):
        assert found.focal[0] == pytest.approx(true.focal[0], rel=0.004)
        away = np.linalg.norm(found.position - true.position)
        turned = np.degrees(np.linalg.norm(vector_from_rotation(found.rotation @ true.rotation.T)))
        assert away < 0.015 and turned < 0.25, f"{found.name}: {1000 * away:.1f} mm, {turned:.3f} degrees off"


def test_the_errors_are_as_large_as_they_are_said_to_be() -> None:
    made = calibrate_board(waved(ring(3), 60, seed=3))
    truth = ring(3)
    scores = [(found.focal[0] - true.focal[0]) / std for found, true, std in zip(made.rig, truth, made.focal_std, strict=True)]
    assert np.abs(scores).max() < 3.5
    assert made.adjustment.noise == pytest.approx(0.1, rel=0.05)


def test_one_camera_gives_its_lens() -> None:
    made = calibrate_board(waved(Rig((ring(1).cameras[0],)), 40))
    [camera] = made.rig
    assert not camera.posed and "the pose of every camera" in made.rig.lacks
    assert camera.focal[0] == pytest.approx(1200, rel=0.003)
    assert camera.radial[0] == pytest.approx(-0.15, abs=0.02)


def test_a_camera_that_saw_nothing_or_shares_no_view_is_named_and_the_rest_calibrated() -> None:
    rig = ring(4)
    views = waved(rig, 80, seed=5)
    alone = np.isin(views.seen.camera, [3]) & (np.isin(views.seen.frame, np.nonzero((views.counts[:, :3] > 0).any(axis=1))[0]))
    views = replace(views, seen=views.seen.select(~alone & (views.seen.camera != 1)))
    made = calibrate_board(replace(views, sizes=(*views.sizes[:1], (0, 0), *views.sizes[2:])))
    assert made.rig.names in (("cam_0",), ("cam_2",), ("cam_0", "cam_2"), ("cam_2", "cam_3"))
    assert any("cam_1 saw the board in 0 of" in sentence for sentence in sentences(made))
    assert any("cam_3" in sentence and "shares no view" in sentence for sentence in sentences(made)) or "cam_3" in made.rig.names


def test_known_lenses_are_kept_and_few_views_are_enough() -> None:
    rig = ring(3)
    views = waved(rig, 6, seed=4)
    made = calibrate_board(views, known=rig)
    truth = in_axes_of_first(rig)
    assert made.rig.names == truth.names and made.usable
    for found, true in zip(made.rig, truth, strict=True):
        assert np.array_equal(found.lens[:9], true.lens[:9])
        assert np.linalg.norm(found.position - true.position) < 0.01
    small = Rig((replace(rig.cameras[0], size=(640, 512)),))
    with pytest.raises(AsterismError, match="640 x 512"):
        calibrate_board(views, known=small)
    with pytest.raises(AsterismError, match="name them alike"):
        calibrate_board(views, known=Rig((replace(rig.cameras[0], name="other"),)))


@pytest.mark.parametrize(("factor", "said", "usable"), [(1.0, False, True), (1.04, True, True), (1.2, True, False)])
def test_a_known_lens_that_is_another_is_noticed(factor: float, said: bool, usable: bool) -> None:
    rig = ring(2)
    zoomed = replace(rig.cameras[1], focal=(factor * rig.cameras[1].focal[0], factor * rig.cameras[1].focal[1]))
    made = calibrate_board(waved(rig, 60, seed=3), known=Rig((rig.cameras[0], zoomed)))
    assert [doubt for doubt in sentences(made) if "known lens of camera cam_0" in doubt] == []
    assert any("known lens of camera cam_1" in doubt for doubt in sentences(made)) is said
    assert made.usable is usable


def test_a_mistaken_view_is_left_out_and_told() -> None:
    views = waved(ring(3), 60, seed=7)
    frame = int(views.seen.frame[np.argmax(views.seen.camera == 1)])
    wrong = (views.seen.frame == frame) & (views.seen.camera == 1)
    xy = views.seen.xy.copy()
    xy[wrong] = xy[wrong][::-1] + np.random.default_rng(0).normal(0, 6, (int(wrong.sum()), 2))
    made = calibrate_board(replace(views, seen=replace(views.seen, xy=xy)))
    assert (int(views.frames[frame]), "cam_1") in made.rejected_views
    assert made.rms < 0.16


def test_cameras_out_of_step_are_noticed_and_their_lenses_kept_apart() -> None:
    made = calibrate_board(waved(ring(2), 50, late=1.0, seed=2))
    assert any("in step" in doubt for doubt in sentences(made))
    for found, true in zip(made.rig, ring(2), strict=True):
        assert found.focal[0] == pytest.approx(true.focal[0], rel=0.02)
    assert not any("in step" in doubt for doubt in sentences(calibrate_board(waved(ring(2), 50, seed=2))))


def test_a_board_that_is_never_tilted_is_doubted() -> None:
    rig = ring(1)
    random = np.random.default_rng(4)
    points = BOARD.points - BOARD.points.mean(axis=0)
    camera = rig.cameras[0]
    flat = np.stack(
        [
            camera.project(points @ camera.rotation + camera.position + camera.rotation.T @ [*random.normal(0, 0.2, 2), 2.0])
            for _ in range(20)
        ]
    )
    seen = Sightings.from_array((flat + random.normal(0, 0.1, flat.shape))[:, None])
    views = BoardViews(BOARD, ("cam_0",), ((1280, 1024),), np.arange(20), seen, (20,))
    made = calibrate_board(views)
    assert any("tilted" in doubt for doubt in sentences(made))
    assert made.focal_std[0] > 0.02 * made.rig.cameras[0].focal[0]


def far_off(made: Rig, true: Rig) -> float:
    """How far the worst camera stands from where it should, m, in the first one's axes."""
    truth = in_axes_of_first(true.select(made.names))
    return max(float(np.linalg.norm(one.position - other.position)) for one, other in zip(made, truth, strict=True))


EVEN = Board("chessboard", 8, 6, 0.05)


@pytest.mark.parametrize("turned", [lambda camera, random: camera == 1, lambda camera, random: random.random() < 0.5])
def test_a_board_that_looks_the_same_upside_down_is_numbered_alike_by_all(turned) -> None:  # type: ignore[no-untyped-def]
    views, random = waved(ring(3), 60, seed=2, board=EVEN), np.random.default_rng(0)
    for made, wrong in ((calibrate_board(views), False), (calibrate_board(renumbered(views, turned, random)), True)):
        assert made.usable and made.rms < 0.16, f"{made.rms:.3f} px, some turned: {wrong}"
        assert far_off(made.rig, ring(3)) < 0.05, f"{far_off(made.rig, ring(3)):.3f} m, some turned: {wrong}"


def renumbered(views: BoardViews, turned, random: np.random.Generator) -> BoardViews:  # type: ignore[no-untyped-def]
    seen = views.seen
    others = {(t, c): turned(c, random) for t, c in sorted(set(zip(seen.frame.tolist(), seen.camera.tolist(), strict=True)))}
    upside_down = np.array([others[t, c] for t, c in zip(seen.frame.tolist(), seen.camera.tolist(), strict=True)])
    point = np.where(upside_down, len(views.board.points) - 1 - seen.point, seen.point)
    return replace(views, seen=Sightings.of(seen.frame, seen.camera, point, seen.xy))


def test_one_shared_view_of_such_a_board_links_no_cameras() -> None:
    for board, usable in ((EVEN, False), (BOARD, True)):
        views = waved(ring(2), 60, seed=1, board=board)
        shared = np.nonzero((views.counts > 0).all(axis=1))[0]
        apart = np.isin(views.seen.frame, shared[1:]) & (views.seen.frame % 2 == views.seen.camera)
        made = calibrate_board(replace(views, seen=views.seen.select(~apart)))
        assert made.usable is usable, sentences(made)
        assert any("share 1 view" in doubt or "hang together by 1" in doubt for doubt in sentences(made))


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "alike"),
    [
        ("chessboard", 8, 6, True), ("chessboard", 9, 7, True), ("chessboard", 9, 6, False), ("circles", 7, 5, True),
        ("asymmetric circles", 4, 11, False), ("charuco", 6, 4, False),
    ],
)  # fmt: skip
def test_which_boards_look_the_same_upside_down(kind: str, columns: int, rows: int, alike: bool) -> None:
    board = Board(kind, columns, rows, 0.05, "DICT_4X4_50" if kind == "charuco" else "", 0.03 if kind == "charuco" else 0.0)  # type: ignore[arg-type]
    points = board.points
    same_places = np.allclose(points[0] + points[-1] - points[::-1], points)
    assert board.turns_alike is alike
    assert same_places or not alike


def test_cameras_that_saw_two_boards_are_not_believed() -> None:
    """A third of one camera's views are of another board of the same kind."""
    one, other = waved(ring(2), 50, seed=5), waved(ring(2), 50, seed=6)
    swapped = np.random.default_rng(0).random(80) < 0.5

    def mine(views: BoardViews, which: np.ndarray) -> tuple[np.ndarray, ...]:
        seen, frame = views.seen, views.frames[views.seen.frame]
        rows = (which[frame] & (seen.camera == 1)) | ((seen.camera == 0) & (views is one))
        return frame[rows], seen.camera[rows], seen.point[rows], seen.xy[rows]

    mixed = Sightings.of(*(np.concatenate(parts) for parts in zip(mine(one, ~swapped), mine(other, swapped), strict=True)))
    seen, frames = mixed.compact()
    made = calibrate_board(replace(one, seen=seen, frames=frames))
    assert not made.usable
    assert any("of them fit both" in doubt for doubt in sentences(made))


def test_views_of_a_board_that_rests_are_not_many() -> None:
    views = waved(ring(1), 4, noise=0.15, seed=2)
    again = 40
    frame = np.concatenate([views.seen.frame + 4 * i for i in range(again)])
    still = Sightings.of(frame, np.tile(views.seen.camera, again), np.tile(views.seen.point, again), np.tile(views.seen.xy, (again, 1)))
    many, few = calibrate_board(replace(views, seen=still, frames=np.arange(4 * again))), calibrate_board(views)
    assert any("only 4 different views" in doubt for doubt in sentences(many))
    assert many.focal_std[0] == pytest.approx(few.focal_std[0], rel=0.3), "160 images of 4 views tell what 4 tell"
    two = still.select(still.frame % 4 < 2)
    flickering = two.select(np.random.default_rng(0).random(len(two)) < 0.8)
    for some in (two, flickering):
        with pytest.raises(AsterismError, match="too few different"):
            calibrate_board(replace(views, seen=some, frames=np.arange(4 * again)))


@pytest.mark.parametrize(("bend", "doubted", "usable"), [(0.0, False, True), (0.002, True, True), (0.008, True, False)])
@pytest.mark.parametrize("cameras", [1, 3])
def test_a_board_that_bends_is_doubted(cameras: int, bend: float, doubted: bool, usable: bool) -> None:
    made = calibrate_board(waved(ring(cameras), 60, seed=4, misprint=(bend, 1.0)))
    assert any("not flat" in doubt for doubt in sentences(made)) is doubted, made.bend
    assert made.usable is usable, f"{made.bend:.5f}, focal lengths {[camera.focal[0] for camera in made.rig]}"


@pytest.mark.parametrize(("stretched", "doubted"), [(1.0, False), (1.015, True)])
def test_a_board_printed_longer_than_it_should_be_is_doubted(stretched: float, doubted: bool) -> None:
    made = calibrate_board(waved(ring(1), 60, seed=4, misprint=(0.0, stretched)))
    assert any("from square" in doubt for doubt in sentences(made)) is doubted


def test_the_same_views_give_the_same_bits() -> None:
    """OpenCV adds up in another order each time where it may use several threads."""
    views = waved(ring(2), 50, seed=8)
    threads, made = cv2.getNumThreads(), []
    try:
        for count in (1, 2, 2, 4):
            cv2.setNumThreads(count)
            made.append(calibrate_anew(views))
            assert cv2.getNumThreads() == count, "as it was"
    finally:
        cv2.setNumThreads(threads)
    for one in made[1:]:
        assert one.rms == made[0].rms
        assert all(
            np.array_equal(a.lens, b.lens) and np.array_equal(a.translation, b.translation)
            for a, b in zip(one.rig, made[0].rig, strict=True)
        )


def test_the_origin_is_where_the_board_lay() -> None:
    views = waved(ring(3), 60, seed=9)
    moment = int(views.frames[np.argmax((views.counts > 0).sum(axis=1))])
    made = calibrate_board(views, origin=moment)
    at = int(np.nonzero(views.frames[made.used] == moment)[0][0])
    assert np.array_equal(made.rig.vertical, [0, 0, 1])  # type: ignore[arg-type]
    assert all(camera.position[2] > 0 for camera in made.rig), "cameras see the print, which is the upper side"
    own = made.sightings.frame == at
    points = BOARD.points[made.sightings.point[own]] * [1, -1, -1]
    for c, camera in enumerate(made.rig):
        seen = made.sightings.camera[own] == c
        if seen.any():
            assert np.abs(camera.project(points[seen]) - made.sightings.xy[own][seen]).max() < 0.8
    with pytest.raises(AsterismError, match="frame 9999"):
        calibrate_board(views, origin=9999)


# Finding boards in images


def drawn(board: Board, camera: Camera, turn: np.ndarray, middle: np.ndarray, legacy: bool = False) -> np.ndarray:
    """An image of a board: its print warped through the camera (no lens distortion), white around; legacy: as OpenCV before 4.6."""
    cell = 60
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        made = cv2.aruco.CharucoBoard((board.columns, board.rows), board.spacing, board.marker, dictionary)
        made.setLegacyPattern(legacy)
        sheet, zero = made.generateImage((board.columns * cell, board.rows * cell)), np.zeros(2)
    elif board.kind == "chessboard":
        sheet = np.full(((board.rows + 1) * cell, (board.columns + 1) * cell), 255, np.uint8)
        for i in range(board.rows + 1):
            for j in range(board.columns + 1):
                sheet[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell] = 255 * ((i + j) % 2)
        zero = np.array([cell, cell])
    else:
        places = board.points[:, :2] / board.spacing * cell + cell
        sheet = np.full((int(places[:, 1].max()) + cell, int(places[:, 0].max()) + cell), 255, np.uint8)
        for x, y in places:
            cv2.circle(sheet, (round(x * 16), round(y * 16)), round(0.3 * cell * 16), 0, -1, cv2.LINE_AA, 4)
        zero = np.array([cell + 0.5, cell + 0.5])
    sheet = np.pad(sheet, cell, constant_values=255)
    zero = zero + cell - 0.5
    corners = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]])
    space = np.column_stack([corners, np.zeros(4)]) - board.points.mean(axis=0)
    target = camera.project(space @ turn.T + middle)
    warp = cv2.getPerspectiveTransform((corners / board.spacing * cell + zero).astype(np.float32), target.astype(np.float32))
    assert camera.size is not None
    image = cv2.warpPerspective(sheet, warp, camera.size, flags=cv2.INTER_AREA, borderValue=255)
    return cv2.GaussianBlur(image, (0, 0), 0.8)


PLAIN = Camera("plain", (960, 720), (900.0, 900.0), (479.5, 359.5))
BOARDS = {
    "chessboard": BOARD,
    "charuco": Board("charuco", 7, 5, 0.06, "DICT_5X5_100", 0.045),
    "circles": Board("circles", 7, 5, 0.05),
    "asymmetric circles": Board("asymmetric circles", 4, 9, 0.04),
}


@pytest.mark.parametrize("kind", BOARDS)
@pytest.mark.parametrize("inverted", [False, True])
def test_points_are_found_where_they_are_drawn(tmp_path: Path, kind: str, inverted: bool) -> None:
    board = replace(BOARDS[kind], inverted=inverted)
    random = np.random.default_rng(6)
    truth = []
    for i in range(6):
        turn, middle = rotation_from_vector(random.normal(0, 0.25, 3)), np.array([*random.normal(0, 0.05, 2), 0.9])
        image = drawn(board, PLAIN, turn, middle)
        cv2.imwrite(str(tmp_path / f"{i}.png"), 255 - image if inverted else image)
        truth.append(PLAIN.project((board.points - board.points.mean(axis=0)) @ turn.T + middle))
    views = find_board(footage_of([tmp_path]), board)
    assert len(views.frames) >= 5
    wrong = views.seen.xy - np.array(truth)[views.frames[views.seen.frame], views.seen.point]
    assert np.median(np.linalg.norm(wrong, axis=1)) < 0.2, f"{np.median(np.linalg.norm(wrong, axis=1)):.3f} px"


@pytest.mark.parametrize("rows", [4, 5])
@pytest.mark.parametrize("legacy", [False, True])
def test_charuco_boards_printed_before_and_after_opencv_4_6_are_found(rows: int, legacy: bool) -> None:
    board = Board("charuco", 7, rows, 0.06, "DICT_5X5_100", 0.045)
    turn, middle = rotation_from_vector([0.2, -0.1, 0.1]), np.array([0.02, 0.01, 0.9])
    point, xy = Finder(board).find(drawn(board, PLAIN, turn, middle, legacy))
    assert len(point) > 0.8 * len(board.points)
    truth = PLAIN.project((board.points - board.points.mean(axis=0)) @ turn.T + middle)
    assert np.median(np.linalg.norm(xy - truth[point], axis=1)) < 0.3


def test_an_upside_down_camera_counts_the_same_corners() -> None:
    turn, middle = rotation_from_vector([0.2, -0.1, 0.1]), np.array([0.02, 0.01, 0.9])
    image = drawn(BOARD, PLAIN, turn, middle)
    point, xy = Finder(BOARD).find(image)
    turned, upside_down = Finder(BOARD).find(np.ascontiguousarray(image[::-1, ::-1]))
    assert np.array_equal(point, turned)
    assert np.abs((np.array([959, 719]) - upside_down) - xy).max() < 0.05
    assert Board("chessboard", 8, 6, 0.05).turns_alike and not BOARD.turns_alike


def _filmed(folder: Path, cameras: int = 2, frames: int = 12) -> None:
    """Videos of a chessboard in front of cameras side by side."""
    random = np.random.default_rng(8)
    films = [
        cv2.VideoWriter(str(folder / f"cam_{c}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, PLAIN.size or (0, 0)) for c in range(cameras)
    ]
    for _ in range(frames):
        turn, middle = rotation_from_vector(random.normal(0, 0.3, 3)), np.array([*random.normal(0, 0.05, 2), 0.95])
        for c, film in enumerate(films):
            camera = replace(PLAIN, translation=np.array([-0.08 * c, 0.0, 0.0]))
            film.write(cv2.cvtColor(drawn(BOARD, camera, turn, middle), cv2.COLOR_GRAY2BGR))
    for film in films:
        film.release()


def test_videos_to_a_rig_by_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _filmed(tmp_path)
    target, told, page = tmp_path / "rig.toml", tmp_path / "told.json", tmp_path / "page.html"
    words = ["calibrate", "board", str(tmp_path), "--chessboard", "9x6", "--square", "0.05", "-o", str(target)]
    assert main([*words, "--json", str(told), "--report", str(page)]) in (0, 1)
    rig = read_rig(target)
    assert rig.names == ("cam_0", "cam_1")
    assert np.linalg.norm(rig["cam_1"].position) == pytest.approx(0.08, abs=0.002)
    assert rig["cam_0"].focal[0] == pytest.approx(900, rel=0.02)
    content = json.loads(told.read_text())
    assert {"frames", "frames_used", "reprojection_rms_px", "cameras", "findings", "usable"} <= set(content)
    assert "cam_1" in page.read_text(encoding="utf-8")
    assert "cam_1" in capsys.readouterr().out
    assert main(words) == 2, "it exists"
    assert "exists" in capsys.readouterr().err


def test_a_video_that_breaks_off_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _filmed(tmp_path, cameras=1)
    path = tmp_path / "cam_0.avi"
    data = path.read_bytes()
    path.write_bytes(data[: int(0.7 * len(data))])
    status = main(["calibrate", "board", str(path), "--chessboard", "9x6", "--square", "0.05", "--json", str(tmp_path / "t.json")])
    said = capsys.readouterr().err
    assert (status == 1 and "breaks off" in said) or (status == 2 and "cut off" in said)
    assert "cam_0.avi" in said


def test_timestamps_say_which_frames_belong_together(tmp_path: Path) -> None:
    _filmed(tmp_path, cameras=2, frames=5)
    rows = ["sync_index,cam_id,frame_index,frame_time"]
    rows += [f"{t + 40},0,{t},{t / 10}" for t in range(5)] + [f"{t + 42},1,{t},{t / 10}" for t in range(5)]
    (tmp_path / "timestamps.csv").write_text("\n".join(rows))
    one, other = footage_of([tmp_path])
    assert one.frames.tolist() == [40, 41, 42, 43, 44]
    assert other.frames.tolist() == [42, 43, 44, 45, 46]
    (tmp_path / "timestamps.csv").write_text("\n".join(rows[:-1]))
    assert "4 frames" in footage_of([tmp_path])[1].findings[0].sentence
    (tmp_path / "timestamps.csv").write_text(rows[0] + "\n" + "1" * 200_000 + ",0,0,0\n")
    with pytest.raises(AsterismError, match=r"timestamps\.csv"):
        footage_of([tmp_path])


def test_footage_as_people_have_it(tmp_path: Path) -> None:
    for name in ("left01.png", "left02.png", "right02.png", "right.png"):
        cv2.imwrite(str(tmp_path / name), np.zeros((8, 8), np.uint8))
    left, right = footage_of([tmp_path])
    assert (left.name, left.frames.tolist(), right.name) == ("left", [1, 2], "right")
    assert right.frames.tolist() == [-1, 2]
    (tmp_path / "list.yml").write_text("%YAML:1.0\nimages:\n  - left01.png\n  - left02.png\n")
    [listed] = footage_of([tmp_path / "list.yml"])
    assert listed.name == "left" and len(listed) == 2
    for folder in ("a", "b"):
        (tmp_path / "rig" / folder).mkdir(parents=True)
        cv2.imwrite(str(tmp_path / "rig" / folder / "0007.png"), np.zeros((8, 8), np.uint8))
    assert [one.name for one in footage_of([tmp_path / "rig"])] == ["a", "b"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere"], "nowhere"),
        (["."], "no image or video"),
        ([".", "--charuco", "5x4"], "one of --board"),
        ([".", "--square", "25"], "25 m"),
        (["text.txt"], "text.txt"),
        (["empty.avi"], "empty.avi"),
        (["black.png"], "saw the board"),
        (["black1.png", "sized/black1.png"], "two images"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, list) else "",
)
def test_bad_footage_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    (tmp_path / "inside" / "sized").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "inside")
    if words != ["."]:
        Path("text.txt").write_text("x")
        Path("empty.avi").write_bytes(b"RIFF")
        for name in ("black.png", "black1.png", "sized/black1.png"):
            cv2.imwrite(name, np.zeros((64, 64), np.uint8))
    given = ["--chessboard", "9x6", *([] if "--square" in words else ["--square", "0.025"])]
    assert main(["calibrate", "board", *words, *given]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("kind = 'chessboard'\ncolumns = 9\nrows = 6\n", "square"),
        ("kind = 'chessboard'\ncolumns = 6\nrows = 6\nsquare = 0.02\n", "same from four sides"),
        ("kind = 'charuco'\ncolumns = 6\nrows = 5\nsquare = 0.02\nmarker = 0.03\ndictionary = 'DICT_4X4_50'\n", "must fit"),
        ("kind = 'circles'\ncolumns = 6\nrows = 6\nsquare = 0.02\n", "same from four sides"),
        ("kind = 'asymmetric circles'\ncolumns = 4\nrows = 10\nsquare = 0.02\n", "even number of rows"),
        ("kind = 'chessboard'\ncolumns = 9\nrows = 6\nsquare = 2.5\n", "give metres"),
        ("columns = 4\nrows = 5\n", "no board"),
    ],
)
def test_boards_that_cannot_be(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "board.toml").write_text(text)
    with pytest.raises(AsterismError, match=said):
        Board.from_toml(tmp_path / "board.toml")


# Real images


def test_the_stereo_pair_is_calibrated_as_well_as_opencv_does(data: Path) -> None:
    views = find_board(footage_of([data / "cameras" / "chessboard-stereo"]), Board("chessboard", 9, 6, 0.025))
    made = calibrate_board(views)
    assert made.rig.names == ("left", "right") and made.findings == views.findings and made.usable
    assert [one.camera.error for one in made.intrinsics] < [0.1955, 0.2075]
    assert made.rms < 0.2175
    assert np.linalg.norm(made.rig["right"].position) == pytest.approx(0.0832, abs=0.0005)
    [note] = views.findings
    assert "right.jpg is 612 x 459" in note.sentence
