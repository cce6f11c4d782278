"""Which way is up: told from names, floor and shape, and left open where it cannot be told."""

from __future__ import annotations

import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.formats import describe, read, read_clouds, write
from asterism.formats._columns import settle_vertical
from asterism.formats._vertical import vertical_from_positions
from asterism.recording import Recording

AXES = {"x": (1, 0, 0), "-x": (-1, 0, 0), "y": (0, 1, 0), "-y": (0, -1, 0), "z": (0, 0, 1), "-z": (0, 0, -1)}
GAIT = ("LFHD", "RFHD", "C7", "LSHO", "RSHO", "LASI", "RASI", "SACR", "LKNE", "RKNE", "LANK", "RANK", "LTOE", "RTOE")
HEIGHTS = np.array([1.7, 1.7, 1.5, 1.45, 1.45, 1.0, 1.0, 1.02, 0.5, 0.5, 0.1, 0.1, 0.04, 0.04])


def walk(seed: int = 0, frames: int = 200) -> np.ndarray:
    """Somebody of 1.7 m who walks along x at 1 m/s, 100 Hz, z up; feet stand still half of the time."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / 100.0
    positions = np.zeros((frames, len(GAIT), 3))
    side = np.array([1 if name[0] == "L" else -1 if name[0] == "R" else 0 for name in GAIT])
    positions[:, :, 1] = 0.15 * side + rng.normal(0, 0.02, len(GAIT))
    positions[:, :, 2] = HEIGHTS + 0.02 * np.sin(4 * np.pi * time)[:, None]
    positions[:, :, 0] = time[:, None]
    for feet, phase in (((10, 12), 0.0), ((11, 13), 0.5)):
        step = np.floor(time + phase) + np.clip(2 * ((time + phase) % 1) - 1, 0, 1) - phase
        lift = 0.1 * np.sin(np.pi * np.clip(2 * ((time + phase) % 1) - 1, 0, 1))
        for foot in feet:
            positions[:, foot, 0] = step
            positions[:, foot, 2] = HEIGHTS[foot] + lift
    return positions


def turned(positions: np.ndarray, up: tuple[int, int, int]) -> np.ndarray:
    """The same motion in axes in which `up` points up (a right-handed rotation)."""
    up = np.array(up, dtype=float)
    ahead = np.array([0.0, 1.0, 0.0]) if up[0] else np.array([1.0, 0.0, 0.0])
    return positions @ np.stack([ahead, np.cross(up, ahead), up])


@pytest.mark.parametrize("up", AXES.values(), ids=AXES.keys())
@pytest.mark.parametrize("away", [(0.0, 0.0, 0.0), (3.0, -2.0, 0.0), (-1.0, 4.0, 1.0)], ids=["origin", "far", "above the origin"])
def test_names_tell_all_six_axes(up, away):
    positions = turned(walk() + away, up)
    np.testing.assert_array_equal(vertical_from_positions(positions, GAIT), up)


@pytest.mark.parametrize("up", AXES.values(), ids=AXES.keys())
@pytest.mark.parametrize("seed", range(3))
def test_anonymous_points_tell_all_six_axes(up, seed):
    positions = turned(walk(seed) + np.array([-1.0, 0.5, 0.0]), up)
    np.testing.assert_array_equal(vertical_from_positions(positions, [f"*{i}" for i in range(len(GAIT))]), up)


@pytest.mark.parametrize("up", AXES.values(), ids=AXES.keys())
def test_a_floor_somewhat_below_zero_is_still_the_lower_end_of_a_body(up):
    """The origin was set on a box of 15 cm, and nobody's feet stand still: only the end near zero tells."""
    standing = np.tile(walk()[:1], (50, 1, 1)) + np.arange(50)[:, None, None] * [0.01, 0.0, 0.0] + [-1.0, 0.0, -0.15]
    np.testing.assert_array_equal(vertical_from_positions(turned(standing, up)), up)


@pytest.mark.parametrize("up", AXES.values(), ids=AXES.keys())
def test_gaps_and_infinities_do_not_matter(up):
    positions = turned(walk(), up)
    positions[np.random.default_rng(1).random(positions.shape[:2]) < 0.5] = np.nan
    positions[3, 2] = np.inf
    np.testing.assert_array_equal(vertical_from_positions(positions, GAIT), up)


@pytest.mark.parametrize(
    "positions",
    [
        np.zeros((0, 5, 3)),
        np.zeros((4, 2, 3)),
        np.zeros((4, 5, 3)),
        np.full((4, 5, 3), np.nan),
        np.random.default_rng(0).normal(0, 1, (50, 20, 3)),
    ],
    ids=["no frames", "two points", "all equal", "all missing", "a ball of noise"],
)
def test_what_cannot_be_told_is_left_open(positions):
    assert vertical_from_positions(positions, ()) is None


def lying(height: float) -> np.ndarray:
    """Somebody who lies along x, 20 cm thick, on a bed of that height, and breathes."""
    breath = 0.005 * np.sin(np.arange(200) / 30.0)[:, None] * (HEIGHTS > 1.1)
    body = np.tile(walk()[:1, :, [2, 1, 0]] * (1, 1, 0) + (-0.8, 0, height), (200, 1, 1))
    body[:, :, 2] += breath
    return body + np.random.default_rng(0).uniform(0, 0.2, (1, len(GAIT), 3))


def test_somebody_lying_on_the_floor_is_not_stood_up_by_names(tmp_path):
    for usual in ({"declared": np.array([0.0, 0.0, 1.0])}, {"fallback": np.array([0.0, 0.0, 1.0])}):
        vector, _, said = settle_vertical(tmp_path, lying(0.01), GAIT, **usual)
        assert (tuple(vector), [finding.code[:15] for finding in said]) == ((0, 0, 1), ["format-vertical"])


def test_somebody_lying_on_a_bed_does_not_overrule_the_file(tmp_path):
    vector, how, said = settle_vertical(tmp_path, lying(0.6), GAIT, declared=np.array([0.0, 0.0, 1.0]))
    assert (tuple(vector), how) == ((0, 0, 1), "file")
    assert "may be a body with x up" in said[0].sentence


@pytest.mark.parametrize("labels, away", [(GAIT, 0.0), ((), 0.0), (GAIT, -5.0)], ids=["named", "nameless", "named, floor at -5 m"])
def test_a_declaration_that_walking_contradicts_is_not_believed_and_that_is_said(tmp_path, labels, away):
    standing = walk() + np.array([0, 0, away])
    for wrong in ("x", "-x", "y", "-y", "-z"):
        vector, how, said = settle_vertical(tmp_path, standing, labels, declared=np.array(AXES[wrong]))
        assert [finding.code for finding in said] == ["format-vertical-conflict"], wrong
        assert (tuple(vector), how) in (((0, 0, 1), "data against file"), (AXES[wrong], "file"))
    vector, how, said = settle_vertical(tmp_path, standing, labels, declared=np.array([0.0, 0.0, 1.0]))
    assert (tuple(vector), how, said) == ((0, 0, 1), "file", [])


@pytest.mark.parametrize("gap", [0.6, 1.2, 2.0])
@pytest.mark.parametrize("up", AXES.values(), ids=AXES.keys())
def test_two_walkers_side_by_side_keep_their_vertical(tmp_path, up, gap):
    both = np.concatenate([walk(0), walk(1)[::-1] + np.array([0.3, gap, 0.0])], axis=1)
    vector, _, _ = settle_vertical(tmp_path, turned(both, up), (), fallback=np.array([0.0, 0.0, 1.0]))
    assert tuple(vector) == up


def test_few_points_never_overrule_a_declaration(tmp_path):
    """Three points of a wand stand and move like the feet of a person: they are a thing as often as not."""
    wand = walk()[:, [0, 8, 12]]
    vector, how, _ = settle_vertical(tmp_path, wand, (), declared=np.array([0.0, 1.0, 0.0]))
    assert (tuple(vector), how) == ((0, 1, 0), "file")


def test_what_a_file_does_not_show_follows_custom_and_is_noted(tmp_path):
    standing = np.tile(np.random.default_rng(0).normal(0, 0.3, (1, 6, 3)), (20, 1, 1))
    vector, how, said = settle_vertical(tmp_path, standing, (), fallback=np.array([0.0, 1.0, 0.0]))
    assert (tuple(vector), how, [finding.code for finding in said]) == ((0, 1, 0), "convention", ["format-vertical-assumed"])


def test_clouds_of_a_file_have_the_vertical_of_its_recording(tmp_path):
    wrong = Recording(turned(walk(), (0, 1, 0)), tuple(f"*{i}" for i in range(len(GAIT))), 100.0)
    write(tmp_path / "clouds.npz", wrong.clouds())
    for vertical in (
        read(tmp_path / "clouds.npz").vertical,
        read_clouds(tmp_path / "clouds.npz").vertical,
        describe(tmp_path / "clouds.npz")["vertical"],
    ):
        np.testing.assert_array_equal(vertical, [0, 1, 0])
    np.testing.assert_array_equal(read_clouds(tmp_path / "clouds.npz", vertical="x").vertical, [1, 0, 0])


@pytest.mark.parametrize("height", [0.01, 0.3, 0.6])
def test_legs_that_kick_do_not_stand_somebody_up_who_lies(tmp_path, height):
    """Names and length say that x is up, and nothing else does: in one recording of fifty somebody lies."""
    body = lying(height) + (walk() - walk()[:1])[:, :, [2, 1, 0]] * (1, 1, 0)
    vector, how, said = settle_vertical(tmp_path, body, GAIT, declared=np.array([0.0, 0.0, 1.0]))
    assert (tuple(vector), how, [finding.code for finding in said]) == ((0, 0, 1), "file", ["format-vertical-conflict"])


def test_the_vertical_that_is_given_is_taken(tmp_path):
    vector, how, said = settle_vertical(tmp_path, walk(), GAIT, given="-y", declared=np.array([0.0, 0.0, 1.0]))
    assert (tuple(vector), how, said) == ((0, -1, 0), "given", [])


def test_a_file_that_does_not_tell_asks_for_the_vertical(tmp_path):
    noise = np.random.default_rng(0).normal(0, 0.5, (50, 20, 3))
    write(tmp_path / "noise.csv", Recording(noise, tuple(f"M{i}a" for i in range(20)), 100.0))
    text = "\n".join(line for line in (tmp_path / "noise.csv").read_text().splitlines() if "vertical" not in line)
    (tmp_path / "noise.csv").write_text(text + "\n")
    with pytest.raises(AsterismError, match=r"noise\.csv does not say which way is up.*vertical="):
        read(tmp_path / "noise.csv")
    np.testing.assert_array_equal(read(tmp_path / "noise.csv", vertical="-y").vertical, [0, -1, 0])


Z_UP = [
    "gait/HC002/straight.c3d",
    "gait/HC030/turn.c3d",
    "gait/HC040/static.c3d",
    "movement/cmu41/01_01_climb.c3d",
    "movement/cmu41/85_12.c3d",
    "movement/cmu41/06_xx_dribble_shoot.c3d",
    "movement/clouthier62/labelled/PronetoRun01.c3d",
    "movement/clouthier62/labelled/KneeltoProne01.c3d",
    "movement/clouthier62/raw/S01_Pronetokneel01_mksrem.c3d",
    "movement/qtm-fullbody/running_0002.c3d",
    "movement/qtm-fullbody/lem_static.c3d",
    "movement/clinical-lower/auc_dynamic.c3d",
    "movement/optitrack-lower/skeleton20/jog_001.c3d",
    "movement/optitrack-lower/skeleton20/walk_slow_001.c3d",
    "movement/athlete-barbell70/athlete_barbell.c3d",
    "movement/pig39/test_movement.c3d",
    "conformance/c3d/sample_02/pc_real.c3d",
    "conformance/c3d/sample_30/admarche2.c3d",
    "conformance/trc/init100.trc",
    "movement/qtm-fullbody/lem_static.trc",
    "cameras/vicon-rig-walk/walking_1.c3d",
]
Y_UP = [
    "movement/vicon53/nick_freeform_001.c3d",
    "movement/lab51-multiactivity/squats1.trc",
    "movement/running42/run300.trc",
    "movement/fullbody61/markers_StairUp3.trc",
    "movement/sprint53/run0700cms.trc",
    "conformance/trc/markers_walk.trc",
    "conformance/motive-csv/motive_v1.22_rigidbodies.csv",
    "movement/optitrack-wheelchair/racing_full.c3d",
]


@pytest.mark.parametrize("file, up", [*((file, "z") for file in Z_UP), *((file, "y") for file in Y_UP)])
def test_real_files_stand_upright(data, file, up):
    np.testing.assert_array_equal(read(data / file).vertical, AXES[up])


def test_markers_alone_agree_with_every_declared_vertical_of_the_gait_files(data):
    for path in sorted((data / "gait").glob("*/straight.c3d")):
        recording = read(path)
        np.testing.assert_array_equal(vertical_from_positions(recording.positions, recording.labels), [0, 0, 1], err_msg=str(path))
        np.testing.assert_array_equal(vertical_from_positions(recording.positions), [0, 0, 1], err_msg=f"{path}, nameless")
