"""A simulated wearer of a coded garment: the picture and its truth agree, whoever looks at them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import twins_garment as twins
from garment_scenes import ARM, arm_rig, coded, photos, sleeve

from asterism.errors import AsterismError
from asterism.simulation.garment import Folds, PhotoSettings, Wearer, garment_rig, photograph, sheet_of, suit_masks, wear
from asterism.simulation.garment import _raster_kernels as kernels
from asterism.simulation.garment.wearer import MOTIONS, wearer_joints

pytestmark = pytest.mark.kernels


def test_a_circle_in_the_picture_is_where_its_truth_says() -> None:
    """The centre of the bright spot around each true centre, by the image alone, within a twentieth of a pixel in the mean."""
    for photo in photos(noise=0.0):
        rows = np.flatnonzero(photo.truth.readable(7.0, np.radians(40.0), 0.99))
        assert len(rows) > 20
        bright = photo.image.max(axis=2).astype(np.float64)
        off = []
        for x, y in photo.truth.centres[rows]:
            at = np.rint([x, y]).astype(int)
            window = bright[at[1] - 6 : at[1] + 7, at[0] - 6 : at[0] + 7]
            if window.shape != (13, 13):
                continue
            weight = np.clip(window - 0.5 * window.max(), 0.0, None)
            below, right = np.mgrid[-6:7, -6:7]
            label = cv2.connectedComponents((weight > 0).astype(np.uint8))[1]
            weight = np.where(label == label[6, 6], weight, 0.0)
            off.append([at[0] + (weight * right).sum() / weight.sum() - x, at[1] + (weight * below).sum() / weight.sum() - y])
        assert np.abs(np.mean(off, axis=0)).max() < 0.05, np.mean(off, axis=0)
        assert np.sqrt(np.mean(np.square(off))) < 0.15, np.sqrt(np.mean(np.square(off)))


def test_a_visible_circle_shows_its_ink() -> None:
    """The hue at each true centre is that of the pattern's colour: also says that the print is not mirrored."""
    worn = sleeve()
    for photo in photos():
        truth = photo.truth
        rows = np.flatnonzero(truth.readable(5.0, np.radians(60.0), 0.95))
        at = np.rint(truth.centres[rows]).astype(int)
        hue = cv2.cvtColor(photo.image, cv2.COLOR_BGR2HSV)[at[:, 1], at[:, 0], 0] / 180.0
        expected = worn.pattern.hsv[worn.pattern.colours[truth.cells[rows, 0], truth.cells[rows, 1]], 0]
        apart = np.abs((hue - expected + 0.5) % 1.0 - 0.5)
        assert np.mean(apart < 0.06) > 0.99, np.mean(apart < 0.06)
        assert np.mean(np.abs((hue - expected[::-1] + 0.5) % 1.0 - 0.5) < 0.06) < 0.5


def test_the_print_is_seen_as_it_is_on_the_sheet() -> None:
    """From the next column to the next row it turns clockwise, as in an image of the flat sheet: the cloth is not worn inside out."""
    truth = photos()[0].truth
    centre = {tuple(cell): xy for cell, xy, seen in zip(truth.cells.tolist(), truth.centres, truth.visible, strict=True) if seen > 0.9}
    turns = [
        np.linalg.det([centre[i, j + 1] - centre[i, j], centre[i + 1, j] - centre[i, j]])
        for i, j in centre
        if (i, j + 1) in centre and (i + 1, j) in centre
    ]
    assert len(turns) > 50 and min(turns) > 0


def test_what_is_hidden_is_not_visible() -> None:
    """The far half of a sleeve faces away from every camera; a hand before the lens hides what it covers."""
    truth = photos()[1].truth
    assert (truth.visible[truth.tilt > 0.5 * np.pi] == 0).all()
    assert 0.25 < np.mean(truth.visible > 0.5) < 0.5
    bare, clothed = Wearer(motion="stand", parts=("left arm",)), Wearer(motion="stand", parts=("left arm", "torso"))
    masks = {"left arm": suit_masks(bare)["left arm"]}
    pattern = coded(*sheet_of(masks))
    camera = garment_rig(4, (320, 240), wearer=bare).cameras[3]  # from the right: the torso is between
    alone = photograph(wear(pattern, bare), camera, rng=np.random.default_rng(0)).truth
    hidden = photograph(wear(pattern, clothed), camera, rng=np.random.default_rng(0)).truth
    np.testing.assert_array_equal(alone.centres, hidden.centres)
    assert (hidden.visible <= alone.visible + 0.05).all() and hidden.visible.sum() < 0.6 * alone.visible.sum()


def test_the_same_generator_gives_the_same_picture() -> None:
    settings = PhotoSettings(noise=0.02, shutter=0.02, moments=2, jpeg=80)
    camera = arm_rig((160, 120)).cameras[0]
    one, same, other = (photograph(sleeve(), camera, 0.1, settings, rng=np.random.default_rng(seed)).image for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()


@pytest.mark.parametrize(
    ("change", "is_so"),
    [
        ({"exposure": 4.0}, lambda plain, changed: changed.max() == 255 and changed.mean() > 1.5 * plain.mean()),
        ({"white_balance": (1.0, 1.0, 0.4)}, lambda plain, changed: changed[..., 0].mean() < 0.8 * plain[..., 0].mean()),
        ({"blur": 2.0}, lambda plain, changed: np.abs(np.diff(changed.astype(float))).mean() < np.abs(np.diff(plain.astype(float))).mean()),
        ({"gain": 0.001}, lambda plain, changed: (np.ptp(changed, axis=2) > 50).sum() > 1.1 * (np.ptp(plain, axis=2) > 50).sum()),
    ],
    ids=["exposure", "white balance", "blur", "ink gain"],
)
def test_settings_do_what_they_say(change, is_so) -> None:
    camera, plain = arm_rig((320, 240)).cameras[0], PhotoSettings(noise=0.0, clutter=0)
    images = [photograph(sleeve(), camera, 0.0, s, rng=np.random.default_rng(0)).image for s in (plain, replace(plain, **change))]
    assert is_so(*images)


def test_circles_lie_on_the_mesh_one_pitch_apart() -> None:
    """Along the sheet's rows and columns the cloth is as long as it is flat, to 6 %; every circle is on a facet of the mesh."""
    worn = sleeve()
    points = worn.circles(0.0)
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(points, axis=axis), axis=2) / worn.pattern.pitch
        assert abs(np.nanmedian(step) - 1.0) < 0.06
    mesh = worn.mesh(0.0)
    circles = points[np.isfinite(points[..., 0])]
    corners = mesh.vertices[mesh.triangles]
    nearest = np.abs(
        np.einsum("ntx,tx->nt", circles[:, None] - corners[:, 0], _unit(np.cross(*(corners[:, 1:] - corners[:, :1]).swapaxes(0, 1))))
    )
    middle = corners.mean(axis=1)
    close = np.linalg.norm(circles[:, None] - middle, axis=2) < 0.008
    assert np.where(close, nearest, np.inf).min(axis=1).max() < 1e-6


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-15)


@pytest.mark.parametrize("motion", MOTIONS)
def test_limbs_keep_their_lengths(motion) -> None:
    for time in (0.0, 0.37, 1.9):
        joints = wearer_joints(motion, time, 1.7)
        for bone in (
            ("left hip", "left knee"),
            ("right knee", "right ankle"),
            ("left shoulder", "left elbow"),
            ("right elbow", "right wrist"),
        ):
            still = wearer_joints("stand", 0.0, 1.7)
            lengths = [np.linalg.norm(place[bone[1]] - place[bone[0]]) for place in (joints, still)]
            assert abs(lengths[0] - lengths[1]) < 1e-9
    moved = np.linalg.norm(wearer_joints(motion, 1.0)["left wrist"] - wearer_joints(motion, 1.4)["left wrist"])
    assert (moved > 0.05) == (motion != "stand")


def test_kernels_equal_their_twins() -> None:
    rng = np.random.default_rng(3)
    v, t, samples, corner, shape = 12, 8, 2, np.array([4, 6]), (18, 22)
    xy, nearness = rng.uniform(0, 14, (v, 2)), rng.uniform(0.2, 1.0, v)
    triangles = np.array([rng.choice(v, 3, replace=False) for _ in range(t)], dtype=np.int32)
    front, owner = np.zeros(shape, dtype=np.float32), np.full(shape, -1, dtype=np.int32)
    kernels.rasterise(xy, nearness, triangles, samples, corner, front, owner)
    expected = twins.rasterise(xy, nearness, triangles, samples, corner, shape)
    np.testing.assert_allclose(front, expected[0], rtol=1e-6)
    np.testing.assert_array_equal(owner, expected[1])
    sheet, light = rng.uniform(-1, 5, (v, 2)), rng.uniform(0, 1, (v, 3))
    piece, facing = rng.integers(-1, 2, t).astype(np.int32), rng.random(t) < 0.8
    cells, colours = np.array([[0, 4, 0, 1], [0, 3, 3, 4]]), rng.integers(-1, 4, (5, 5)).astype(np.int8)
    inks, rules = rng.uniform(0, 1, (6, 3)), np.array([0.28, 0.05, 0.25])
    image, seen = np.zeros((20, 20, 4)), np.zeros((5, 5), dtype=np.int64)
    given = (xy, nearness, triangles, sheet, light, piece, facing, cells, colours, inks, rules, samples, corner, owner)
    kernels.shade(*given, image, seen)
    expected_image, expected_seen = twins.shade(*given, (20, 20))
    np.testing.assert_allclose(image, expected_image, atol=1e-12)
    np.testing.assert_array_equal(seen, expected_seen)
    assert image[..., 3].max() <= 1.0 + 1e-12 and (owner >= 0).any()


def test_what_cannot_be_worn_is_said() -> None:
    pattern = sleeve().pattern
    with pytest.raises(AsterismError, match="does not fit this wearer"):
        wear(pattern, replace(ARM, stature=1.5))
    with pytest.raises(AsterismError, match="no part called left arm"):
        wear(pattern, replace(ARM, parts=("torso",)))
    with pytest.raises(AsterismError, match="a wearer has no tail"):
        suit_masks(Wearer(parts=("tail",)))
    with pytest.raises(AsterismError, match="stature"):
        suit_masks(Wearer(stature=18.0))
    with pytest.raises(AsterismError, match="does not know the motion"):
        wearer_joints("fly", 0.0)
    with pytest.raises(AsterismError, match="samples"):
        photograph(sleeve(), arm_rig().cameras[0], 0.0, PhotoSettings(samples=0), rng=np.random.default_rng(0))
    camera = replace(arm_rig().cameras[0], size=None)
    with pytest.raises(AsterismError, match="image size"):
        photograph(sleeve(), camera, rng=np.random.default_rng(0))
    assert Folds(height=0.0).heights("x", np.zeros((1, 1)), np.zeros((1, 4)), np.ones((1, 1))).max() == 0
