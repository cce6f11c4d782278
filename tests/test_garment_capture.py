"""From images to trajectories: with a reader of known error, what comes out, in which order, and what is said about bad input."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from garment_scenes import arm_rig, photos, sleeve, true_positions

import asterism
from asterism.cameras import Rig
from asterism.errors import AsterismError
from asterism.files.journal import Journal
from asterism.garment.capture import Capture, capture
from asterism.garment.dense import DenseTrajectories
from asterism.garment.first_images import check_first_images
from asterism.garment.footage import colour_footage
from asterism.simulation.garment import SimulatedCircles, simulated_reading

FRAMES = 7


@cache
def readings() -> dict[tuple[int, int], SimulatedCircles]:
    return {
        (t, c): simulated_reading(photo.truth, 0.1, rng=np.random.default_rng([t, c]))
        for t in range(FRAMES)
        for c, photo in enumerate(photos())
    }


def tagged(t: int, c: int) -> np.ndarray:
    """An image whose first pixel says which it is."""
    image = np.zeros((2, 2, 3), dtype=np.uint8)
    image[0, 0, :2] = t, c
    return image


def moments(missing: tuple[tuple[int, int], ...] = ()):
    return [(100 + t, [None if (t, c) in missing else tagged(t, c) for c in range(3)]) for t in range(FRAMES)]


def read(image: np.ndarray) -> SimulatedCircles:
    return readings()[int(image[0, 0, 0]), int(image[0, 0, 1])]


def captured(change=lambda t, c, circles: circles, **options) -> Capture:
    def changed(image: np.ndarray) -> SimulatedCircles:
        return change(int(image[0, 0, 0]), int(image[0, 0, 1]), read(image))

    return capture(arm_rig(), sleeve().pattern, options.pop("moments", moments()), changed, **options)


def rig_of_images(width: int, height: int) -> Rig:
    """The rig, as if its images had this size."""
    return replace(arm_rig(), cameras=tuple(replace(camera, size=(width, height)) for camera in arm_rig()))


def codes(made: Capture) -> set[str]:
    return {finding.code for finding in made.findings}


def test_trajectories_are_where_the_circles_were() -> None:
    made = captured()
    true = true_positions(sleeve())
    expected = np.array([true[i] for i in made.trajectories.ids.tolist()])
    off = np.linalg.norm(made.trajectories.positions - expected, axis=2)
    assert np.sqrt(np.nanmean(off**2)) < 0.0006
    assert np.isfinite(off).sum() == made.points.sum() > 0.98 * made.seen.sum()
    assert made.frames.tolist() == list(range(100, 100 + FRAMES)) and not made.findings
    assert ((made.trajectories.cameras >= 2) == np.isfinite(off)).all()
    assert made.summary()["points_per_frame"] > 100 and 0 < made.summary()["sigma_m"] < 0.001


def test_workers_change_nothing() -> None:
    alone, together = captured(), captured(workers=3)
    np.testing.assert_array_equal(alone.trajectories.positions, together.trajectories.positions)
    np.testing.assert_array_equal(alone.trajectories.covariance, together.trajectories.covariance)


def test_a_missing_image_costs_its_rays_only() -> None:
    made, whole = captured(moments=moments(missing=((2, 0), (3, 0), (3, 1), (4, 0), (4, 1), (4, 2)))), captured()
    assert made.points[3] == made.points[4] == 0 and 0 < made.points[2] < whole.points[2]
    np.testing.assert_array_equal(np.delete(made.points, [2, 3, 4]), np.delete(whole.points, [2, 3, 4]))


def test_a_file_gives_back_the_trajectories(tmp_path) -> None:
    made = captured(rate=12.5).trajectories
    again = DenseTrajectories.load(made.save(tmp_path / "dense.npz"))
    for name in ("ids", "positions", "covariance", "cameras", "vertical"):
        np.testing.assert_array_equal(getattr(again, name), getattr(made, name))
    assert again.rate == 12.5
    recording = asterism.read(tmp_path / "dense.npz")
    np.testing.assert_array_equal(recording.positions, made.positions)
    assert recording.labels[0] == f"g{made.ids[0]}" and recording.rate == 12.5
    covariance = again.covariances(0)
    np.testing.assert_allclose(covariance, covariance.transpose(0, 2, 1))


def test_a_damaged_file_is_said(tmp_path) -> None:
    path = captured().trajectories.save(tmp_path / "dense.npz")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(AsterismError, match=r"dense\.npz"):
        DenseTrajectories.load(path)
    with pytest.raises(AsterismError, match=r"none\.npz"):
        DenseTrajectories.load(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(AsterismError, match="no trajectories of a garment"):
        DenseTrajectories.load(tmp_path / "other.npz")
    with pytest.raises(AsterismError, match="do not fit together"):
        made = captured().trajectories
        replace(made, ids=made.ids[1:])
    with pytest.raises(AsterismError, match="rate"):
        captured(rate=0.0)


def test_no_image_and_no_circle() -> None:
    with pytest.raises(AsterismError, match="no image to read"):
        captured(moments=[])
    with pytest.raises(AsterismError, match="no circle of this garment"):
        captured(lambda t, c, circles: replace(circles, ids=np.full_like(circles.ids, -1)))


def test_cameras_that_share_no_circles_are_named() -> None:
    """Each camera sees a part of the cloth that no other one sees."""
    parts = np.array_split(sleeve().pattern.known, 3)

    def own(t: int, c: int, circles: SimulatedCircles) -> SimulatedCircles:
        kept = np.isin(circles.ids, parts[c] if c == 2 else np.concatenate(parts[:2]))
        return SimulatedCircles(circles.centres[kept], circles.covariance[kept], circles.ids[kept])

    made = captured(own)
    assert [(f.code, f.where) for f in made.findings] == [("garment-no-shared-circles", "c3")]
    none = captured(
        lambda t, c, circles: (
            own(t, c, circles)
            if c == 2
            else own(t, 2, circles)
            if c == 0 and t < 0
            else replace(circles, ids=np.where(np.isin(circles.ids, parts[c]), circles.ids, -1))
        )
    )
    assert "garment-no-points" in codes(none) and none.points.sum() == 0


def test_a_blind_camera_is_named() -> None:
    made = captured(lambda t, c, circles: replace(circles, ids=np.full_like(circles.ids, -1)) if c == 1 else circles)
    assert [(f.code, f.where) for f in made.findings] == [("garment-camera-blind", "c2")]


def test_a_second_garment_in_view_is_said() -> None:
    def doubled(t: int, c: int, circles: SimulatedCircles) -> SimulatedCircles:
        some = slice(0, len(circles.ids) // 5)
        return SimulatedCircles(
            np.concatenate([circles.centres, circles.centres[some] + 50]),
            np.concatenate([circles.covariance, circles.covariance[some]]),
            np.concatenate([circles.ids, circles.ids[some]]),
        )

    assert codes(captured(doubled)) == {"garment-seen-twice"}


def test_a_camera_that_was_moved_is_said() -> None:
    """Centres of one camera are 25 px off, as after a knock: rays do not meet."""
    made = captured(lambda t, c, circles: replace(circles, centres=circles.centres + np.array([0, 25])) if c == 1 else circles)
    assert "garment-rig-misfit" in codes(made)


def test_images_of_cameras_are_put_in_the_rigs_order(tmp_path) -> None:
    for c, name in enumerate(("c2", "c3", "c1")):
        (tmp_path / name).mkdir()
        for t in (3, 4, 6):
            if (name, t) != ("c3", 4):
                cv2.imwrite(str(tmp_path / name / f"im{t:03d}.png"), tagged(t, c))
    footage = colour_footage([tmp_path], rig_of_images(2, 2))
    assert footage.names == ("c1", "c2", "c3") and len(footage) == 3 and footage.sizes() == [(2, 2)] * 3
    got = [(number, [None if image is None else image[0, 0, :2].tolist() for image in images]) for number, images in footage]
    assert got == [(3, [[3, 2], [3, 0], [3, 1]]), (4, [[4, 2], [4, 0], None]), (6, [[6, 2], [6, 0], [6, 1]])]
    with pytest.raises(AsterismError, match="the rig has a camera c4"):
        colour_footage([tmp_path], replace(arm_rig(), cameras=(*arm_rig().cameras, replace(arm_rig().cameras[0], name="c4"))))
    with pytest.raises(AsterismError, match="images of c3, which the rig does not have"):
        colour_footage([tmp_path], arm_rig().select(["c1", "c2"]))


def test_single_images_are_one_moment(tmp_path) -> None:
    for c, name in enumerate(("c1", "c2", "c3")):
        (tmp_path / name).mkdir()
        cv2.imwrite(str(tmp_path / name / f"shot{c + 7}.png"), tagged(0, c))
    footage = colour_footage([tmp_path / "c1", tmp_path / "c2", tmp_path / "c3"], rig_of_images(2, 2))
    assert len(footage) == 1
    (_, images) = next(iter(footage))
    assert [image[0, 0, 1] for image in images] == [0, 1, 2]


def test_videos_that_come_apart_are_told(tmp_path) -> None:
    for c, rate in enumerate((25.0, 25.0, 30.0)):
        film = cv2.VideoWriter(str(tmp_path / f"c{c + 1}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), rate, (32, 16))
        for _ in range(6):
            film.write(np.zeros((16, 32, 3), dtype=np.uint8))
        film.release()
    paths = [tmp_path / f"c{c}.avi" for c in (1, 2, 3)]
    (finding,) = colour_footage(paths, arm_rig()).findings
    assert finding.code == "board-rates-differ"
    assert "camera c1 has 25 frames/s, c3 30: at the end of 6 frames they are 1.2 frames apart" in finding.sentence
    assert not colour_footage(paths[:2], arm_rig().select(["c1", "c2"])).findings
    # Numbers that say which frames were taken together count more than rates.
    numbers = "".join(f"{t},{c},0\n" for t in range(6) for c in ("c1", "c2", "c3"))
    (tmp_path / "timestamps.csv").write_text("sync_index,cam_id,frame_time\n" + numbers)
    assert not colour_footage(paths, arm_rig()).findings


def test_a_video_is_read_in_step(tmp_path) -> None:
    """Frames are told apart by their brightness; the second camera's film is shorter."""
    for c, count in enumerate((5, 3, 5)):
        film = cv2.VideoWriter(str(tmp_path / f"c{c + 1}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 10, (32, 16))
        for t in range(count):
            film.write(np.full((16, 32, 3), 40 * t + 10, dtype=np.uint8))
        film.release()
    for number, images in colour_footage([tmp_path / f"c{c}.avi" for c in (1, 2, 3)], rig_of_images(32, 16)):
        assert [image is None for image in images] == [False, number >= 3, False]
        assert all(abs(float(image.mean()) - (40 * number + 10)) < 6 for image in images if image is not None)


def kept_in(path, work: str = "walk") -> Journal:
    return Journal(path, work)


def broken_off(path, after: int) -> None:
    """A capture that is interrupted while moment `after` is read."""
    journal = kept_in(path)

    def interrupted(image: np.ndarray) -> SimulatedCircles:
        if image[0, 0, 0] == after:
            raise KeyboardInterrupt
        return read(image)

    with pytest.raises(KeyboardInterrupt):
        capture(arm_rig(), sleeve().pattern, moments(), interrupted, journal=journal)
    journal.close()


def test_a_capture_that_was_broken_off_goes_on_and_comes_out_the_same(tmp_path) -> None:
    broken_off(tmp_path / "a", after=4)
    read_again: list[tuple[int, int]] = []

    def watched(t: int, c: int, circles: SimulatedCircles) -> SimulatedCircles:
        read_again.append((t, c))
        return circles

    journal = kept_in(tmp_path / "a")
    again, whole = captured(watched, journal=journal), captured()
    assert journal.kept == 4 and {t for t, _ in read_again} == {4, 5, 6}
    np.testing.assert_array_equal(again.trajectories.positions, whole.trajectories.positions)
    np.testing.assert_array_equal(again.trajectories.covariance, whole.trajectories.covariance)
    np.testing.assert_array_equal(again.read, whole.read)
    journal.remove()
    assert not (tmp_path / "a").exists()


def test_steps_of_other_work_are_not_used_and_half_a_step_is_done_again(tmp_path) -> None:
    broken_off(tmp_path / "a", after=3)
    whole = (tmp_path / "a").read_bytes()
    for end in range(len(whole) - 1, 0, -1009):
        (tmp_path / "a").write_bytes(whole[:end])
        journal = kept_in(tmp_path / "a")
        assert journal.kept <= 2
        journal.close()
    damaged = bytearray(whole)
    damaged[-100] ^= 1
    (tmp_path / "a").write_bytes(damaged)
    journal = kept_in(tmp_path / "a")
    assert journal.kept == 2
    with pytest.raises(AsterismError, match="another run"):
        kept_in(tmp_path / "a")
    journal.close()
    journal = kept_in(tmp_path / "a", "run")
    assert journal.kept == 0 and journal.other
    journal.close()
    (tmp_path / "b").write_text("a diary that has this name by chance, and is long enough for a beginning of steps")
    with pytest.raises(AsterismError, match="move it elsewhere"):
        kept_in(tmp_path / "b")
    assert (tmp_path / "b").read_text().startswith("a diary")


def test_a_journal_that_cannot_be_written_costs_no_work(tmp_path) -> None:
    journal = kept_in(tmp_path / "none" / "a")
    assert len(captured(journal=journal).frames) == FRAMES and journal.lost


@pytest.mark.parametrize("workers", [1, 2])
def test_an_image_that_fails_costs_itself(workers: int) -> None:
    def failing(t: int, c: int, circles: SimulatedCircles) -> SimulatedCircles:
        if (t, c) == (2, 1):
            raise ValueError("no such shape")
        return circles

    made, whole = captured(failing, workers=workers), captured()
    assert [(f.code, f.where) for f in made.findings] == [("garment-image-failed", "c2")]
    assert "camera c2, frame 102" in made.findings[0].sentence and "no such shape" in made.findings[0].sentence
    np.testing.assert_array_equal(np.delete(made.points, 2), np.delete(whole.points, 2))
    assert 0 < made.points[2] < whole.points[2]

    def broken(t: int, c: int, circles: SimulatedCircles) -> SimulatedCircles:
        raise ValueError("no such shape")

    with pytest.raises(AsterismError, match="no such shape"):
        captured(broken)


def test_an_image_of_another_size_or_with_a_false_header_costs_itself(tmp_path) -> None:
    rig = rig_of_images(64, 48)
    for name in rig.names:
        (tmp_path / name).mkdir()
        for t in range(3):
            cv2.imwrite(str(tmp_path / name / f"{t}.png"), np.zeros((48, 64, 3), dtype=np.uint8))
    cv2.imwrite(str(tmp_path / "c1" / "0.png"), np.zeros((24, 32, 3), dtype=np.uint8))
    content = bytearray((tmp_path / "c2" / "1.png").read_bytes())
    content[16:24] = (200_000).to_bytes(4, "big") * 2
    (tmp_path / "c2" / "1.png").write_bytes(content)
    footage = colour_footage([tmp_path], rig)
    check_first_images(footage, sleeve().pattern, rig)
    assert [[image is None for image in images] for _, images in footage] == [
        [True, False, False],
        [False, True, False],
        [False, False, False],
    ]
    assert {(f.code, f.where) for f in footage.findings} == {
        ("garment-image-size", str(tmp_path / "c1" / "0.png")),
        ("garment-image-unreadable", str(tmp_path / "c2" / "1.png")),
    }
    # a second one is no slip
    cv2.imwrite(str(tmp_path / "c1" / "1.png"), np.zeros((24, 32, 3), dtype=np.uint8))
    with pytest.raises(AsterismError, match="c1 are 32 x 24, the rig was calibrated for 64 x 48"):
        check_first_images(colour_footage([tmp_path], rig), sleeve().pattern, rig)
