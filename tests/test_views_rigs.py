"""Labels in images where the rig, the cameras or the person are not as usual: right, or not given, or said."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from computed import computed
from scipy.spatial.transform import Rotation

from asterism.cameras import Rig
from asterism.recording import Blobs, Floats, Ints
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, simulate_blobs
from asterism.simulation.views_laboratory import ViewsSession, simulate_views
from asterism.skeleton import ArticulatedBody, load_body
from asterism.views import ViewsLabelling, label, label_views
from asterism.views.detection import detection_shares
from asterism.views.lateness import in_step
from asterism.views.personal import PERSONAL
from asterism.views.rules import RULES

BODY = load_body("gait15")


@pytest.fixture(autouse=True)
def _half_as_many_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """The person is learned, and cameras compared, by half as many frames, each searched from nothing: fewer make nothing easier."""
    monkeypatch.setattr(label, "PERSONAL", replace(PERSONAL, frames=PERSONAL.frames // 2))


@cache
def walk(cameras: int = 4) -> ViewsSession:
    trial = simulate_walks(1, 90, seed=3)[0]
    return simulate_views(trial, BODY.labels, rng=np.random.default_rng(0), cameras=cameras)


def labels_of(blobs: Blobs, rig: Rig, body: ArticulatedBody) -> ViewsLabelling:
    """What `label_views` gives; up to ten seconds, so that it is worked out once for the same sources."""
    return computed(label_views, blobs, rig, body, beside=label.PERSONAL)


def turned(rig: Rig, degrees: float, cameras: tuple[int, ...], seed: int) -> Rig:
    """The rig with some cameras turned about axes at random."""
    rng, made = np.random.default_rng(seed), []
    for c, camera in enumerate(rig):
        axis = rng.normal(size=3)
        rotation = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix() @ camera.rotation
        made.append(replace(camera, rotation=rotation, translation=-rotation @ camera.position) if c in cameras else camera)
    return Rig(tuple(made), vertical=rig.vertical)


def right_and_sure(result: ViewsLabelling, identity: Ints) -> tuple[float, int, int]:
    """The share of the markers' blobs with the right label; labels at 0.99 or more, and how many of them are wrong."""
    marker = identity >= 0
    sure = (result.labels >= 0) & (identity != -2) & (result.confidence >= 0.99)
    return float((result.labels == identity)[marker].mean()), int(sure.sum()), int((sure & (result.labels != identity)).sum())


def codes(result: ViewsLabelling) -> set[str]:
    return {finding.code for finding in result.findings}


@pytest.mark.parametrize("seeing", [(0, 1), pytest.param((0, 1, 2), marks=pytest.mark.slow)])
def test_cameras_without_blobs_count_as_absent(seeing: tuple[int, ...]) -> None:
    given = walk()
    kept = np.isin(given.blobs.camera_of, seeing)
    blobs, identity = given.blobs.select(kept), given.identity[kept]
    right, sure, wrong = right_and_sure(labels_of(blobs, given.rig, BODY), identity)
    names = [given.rig.names[c] for c in seeing]
    alone = labels_of(blobs.select_cameras(names), given.rig.select(names), BODY)
    assert right == pytest.approx(right_and_sure(alone, identity)[0], abs=0.03) and right > 0.95
    assert wrong <= 0.005 * sure


@pytest.mark.parametrize(("degrees", "moved"), [(1.0, (1,)), pytest.param(0.3, (0, 1, 2), marks=pytest.mark.slow)])
def test_a_rig_that_is_a_little_off_is_said_and_costs_no_labels(degrees: float, moved: tuple[int, ...]) -> None:
    given = walk(3)
    result = labels_of(given.blobs.frames(slice(0, 45)), turned(given.rig, degrees, moved, 7), BODY)
    right, sure, wrong = right_and_sure(result, given.identity[: len(result.labels)])
    assert right >= 0.97 and wrong <= 0.002 * sure, f"{right:.3f} right, {wrong} of {sure} sure labels are wrong"
    assert "views-rig-inexact" in codes(result) and "views-camera-misfit" not in codes(result), f"{codes(result)}"


@pytest.mark.parametrize("degrees", [1.0, pytest.param(3.0, marks=pytest.mark.slow)])
def test_two_cameras_of_which_one_was_moved_are_said_to_contradict_each_other(degrees: float) -> None:
    """That a right rig of two cameras has no finding is asked where the walk of two cameras is labelled."""
    given = walk(2)
    result = labels_of(given.blobs.frames(slice(0, 45)), turned(given.rig, degrees, (1,), 3), BODY)
    _, sure, wrong = right_and_sure(result, given.identity[: len(result.labels)])
    assert codes(result) & {"views-rig-inexact", "views-camera-misfit"}, f"{codes(result)}"
    # Lines of sight that miss each other by where a marker is, and not by how it moves, are not those of a late camera.
    assert "views-camera-late" not in codes(result)
    assert wrong <= 0.01 * sure, f"{wrong} of {sure} sure labels are wrong"


@pytest.mark.parametrize("kept", [1.0, 0.75, 0.6])
def test_how_many_blobs_a_camera_loses_is_told_without_labels(kept: float) -> None:
    rng, (frames, markers) = np.random.default_rng(4), (160, 12)
    start, speed = rng.uniform(100, 500, (2, markers, 2)), rng.uniform(-2, 2, (2, markers, 2))
    xy = start[None] + np.arange(frames)[:, None, None, None] * speed
    there = rng.random((frames, 2, markers)) < np.array([1.0, kept])[:, None]
    # Hidden for a second, as behind the other leg, is not lost; a light that stays where it is tells nothing.
    there[40:100, :, :4] = False
    xy[:, :, -1], there[:, :, -1] = (600.0, 20.0), True
    frame, camera, _ = np.nonzero(there)
    blobs = Blobs.from_rows(frame, camera, (xy + rng.normal(0, 0.5, xy.shape))[there], ("a", "b"), rate=60.0, frames=frames)
    shares = detection_shares(blobs, [(656.0, 491.0)] * 2, RULES.shown)
    assert shares == pytest.approx([1.0, kept], abs=0.04), f"{shares}"
    assert detection_shares(blobs.frames(slice(0, 2)), [(656.0, 491.0)] * 2, RULES.shown) == pytest.approx([RULES.shown] * 2)


def test_blobs_that_are_lost_at_random_cost_few_labels_and_are_said() -> None:
    given = walk(2)
    kept = np.random.default_rng(8).random(len(given.identity)) < 0.75
    result = labels_of(given.blobs.select(kept), given.rig, BODY)
    right, sure, wrong = right_and_sure(result, given.identity[kept])
    assert right > 0.85 and wrong <= 0.01 * sure, f"{right:.3f} right, {wrong} of {sure} sure labels are wrong"
    assert "views-blobs-missing" in codes(result) and result.detected == pytest.approx([0.77, 0.77], abs=0.1)


def lying(positions: Floats, turn: Floats) -> Floats:
    """A walk turned about its middle, 10 cm above the floor at its lowest."""
    middle = positions.mean(axis=1, keepdims=True)
    out = (positions - middle) @ turn.T
    out[..., 2] += 0.1 - out[..., 2].min()
    return out


@pytest.mark.parametrize(
    "turn",
    [
        pytest.param((0, -90, 0), marks=pytest.mark.slow, id="back"),
        pytest.param((0, 90, 0), id="front"),
        pytest.param((90, 0, 0), marks=pytest.mark.slow, id="side"),
        pytest.param((0, 180, 0), id="upside down"),
    ],
)
def test_a_person_who_lies_is_labelled_right(turn: tuple[int, int, int]) -> None:
    given = walk()
    places = lying(given.recording.positions[::6], Rotation.from_rotvec(np.radians(turn)).as_matrix())
    settings = ImagingSettings(noise=0.5, strays=2.0)
    blobs, identity = simulate_blobs(given.rig, places, settings, rng=np.random.default_rng(3), rate=60.0)
    right, sure, wrong = right_and_sure(labels_of(blobs, given.rig, BODY), identity)
    assert right > 0.8 and wrong <= 0.02 * sure, f"{right:.3f} right, {wrong} of {sure} sure labels are wrong"


def test_mirrored_images_are_named_and_give_no_label() -> None:
    given = walk(2)
    blobs = given.blobs.frames(slice(0, 8))
    xy, own = blobs.xy.copy(), blobs.camera_of == 1
    xy[own, 0] = given.rig.cameras[1].size[0] - 1 - xy[own, 0]
    result = labels_of(replace(blobs, xy=xy), given.rig, BODY)
    named = [finding.where for finding in result.findings if finding.code == "views-images-mirrored"]
    assert named == [given.rig.names[1]], f"{[str(finding) for finding in result.findings]}"
    assert (result.labels == -1).all() and result.confidence.max() < 0.9


def later(blobs: Blobs, identity: Ints, camera: int, frames: int) -> tuple[Blobs, Ints]:
    """The blobs of one camera, so many frames late; frames that not all cameras have are left out."""
    frame = blobs.frame_of + frames * (blobs.camera_of == camera)
    kept = (frame >= frames) & (frame < len(blobs))
    order = np.lexsort((np.arange(kept.sum()), blobs.camera_of[kept], frame[kept]))
    pick = np.nonzero(kept)[0][order]
    made = Blobs.from_rows(
        frame[pick] - frames, blobs.camera_of[pick], blobs.xy[pick], blobs.cameras, rate=60.0, frames=len(blobs) - frames
    )
    return made, identity[pick]


def test_blobs_of_a_late_camera_go_to_the_frames_that_they_show() -> None:
    given = walk(2)
    blobs, _ = later(given.blobs, given.identity, 1, 3)
    moved, rows = in_step(blobs, np.array([0, 3]))
    # Frame t of the moved blobs is frame t + 3 of the session; the late camera's last frames are not there.
    truth = given.blobs.frames(slice(3, None))
    for t in range(len(moved) - 3):
        assert np.array_equal(
            moved.xy[moved.offsets[2 * t] : moved.offsets[2 * t + 2]], truth.xy[truth.offsets[2 * t] : truth.offsets[2 * t + 2]]
        )
    assert np.array_equal(blobs.xy[rows], moved.xy) and (moved.counts[-3:, 1] == 0).all()


@pytest.mark.parametrize(("cameras", "frames"), [(2, -1), pytest.param(4, 3, marks=pytest.mark.slow)])
def test_a_camera_that_is_late_is_named_and_labelled_in_the_frames_that_it_shows(
    cameras: int, frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A delay is found by the person's own body, for which half as many frames are too few.
    monkeypatch.setattr(label, "PERSONAL", PERSONAL)
    given = walk(cameras)
    blobs, identity = later(given.blobs, given.identity, int(frames > 0), abs(frames))
    result = labels_of(blobs, given.rig, BODY)
    late = [finding for finding in result.findings if finding.code == "views-camera-late"]
    assert [finding.where for finding in late] == [given.rig.names[1]], f"{[str(finding) for finding in result.findings]}"
    assert f"{abs(frames):.1f} frames {'late' if frames > 0 else 'early'}" in late[0].sentence, late[0].sentence
    assert result.late.tolist() == [0, frames, 0, 0][:cameras]
    right, sure, wrong = right_and_sure(result, identity)
    assert right > 0.93 and wrong <= 0.005 * sure, f"{right:.3f} right, {wrong} of {sure} sure labels are wrong"
    assert (result.shown.sum(axis=1) == result.views).all()
