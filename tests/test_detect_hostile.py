"""Sequences and light as they should not be: what cannot be trusted is said, the rest is found."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.cli import main
from asterism.detection import BlobSettings, DetectionSettings, Flag, ImageBlobs, automatic_threshold, detect, find_blobs, sources
from asterism.detection.times import read_times
from asterism.errors import AsterismError
from asterism.formats import read_blobs

SIZE = (160, 120)


def filmed(frame: int, top: int = 255, dark: float = 12.0, noise: float = 2.0, size: tuple[int, int] = SIZE, many: int = 3) -> np.ndarray:
    """Some markers of 6 px that move by a pixel or so a frame; grey values in 255ths of top."""
    rng = np.random.default_rng(frame)
    ys, xs = np.mgrid[: size[1], : size[0]]
    image = dark + noise * rng.standard_normal((size[1], size[0]))
    for x, y in where(frame, many):
        image += 200 / (1 + np.exp(np.clip((np.hypot(xs - x, ys - y) - 3) / 0.4, -50, 50)))
    return np.clip(np.rint(image * top / 255), 0, top).astype(np.uint8 if top == 255 else np.uint16)


def where(frame: int, many: int = 3) -> np.ndarray:
    number = np.arange(many)
    return np.column_stack([30 + 45 * number + 10 * np.sin(frame / 7 + number), 60 + 40 * np.cos(frame / 25 + number)])


def video(path: Path, code: str = "MJPG", frames: int = 30, top: int = 255) -> Path:
    deep = [cv2.VIDEOWRITER_PROP_DEPTH, cv2.CV_8U if top == 255 else cv2.CV_16U, cv2.VIDEOWRITER_PROP_IS_COLOR, 0]
    out = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*code), 50.0, SIZE, deep)
    assert out.isOpened()
    for frame in range(frames):
        out.write(filmed(frame, top))
    out.release()
    return path


def folder(path: Path, frames: int = 12, name: str = "img_%d.png", **light: float) -> Path:
    path.mkdir(exist_ok=True)
    for frame in range(frames):
        cv2.imwrite(str(path / (name % frame)), filmed(frame, **light))
    return path


def test_videos_of_16_bits_keep_them(tmp_path: Path) -> None:
    """12 bits in 16: OpenCV by itself would hand over the upper 8, which are 0 to 15."""
    result = detect([video(tmp_path / "deep.mkv", "FFV1", 12, top=4095)])
    assert result.findings == ()
    assert 200 < result.cameras[0].threshold < 600
    for frame in range(12):
        away = np.linalg.norm(result.blobs.of(frame, 0)[:, None] - where(frame), axis=2).min(axis=0)
        assert away.max() < 0.1


def test_a_video_with_uneven_frames_is_named(tmp_path: Path) -> None:
    """One frame lasts as long as four, some half as long: the table of times in the file is changed by hand."""
    content = video(tmp_path / "even.mp4", "mp4v").read_bytes()
    assert detect([tmp_path / "even.mp4"]).findings == ()
    at = content.index(b"stts")
    (delta,) = struct.unpack_from(">I", content, at + 16)
    table = struct.pack(">9I", 4, 10, delta, 1, 4 * delta, 6, delta // 2, 13, delta)
    grown = bytearray(content[: at + 8] + table + content[at + 20 :])
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"):
        start = content.index(box) - 4
        struct.pack_into(">I", grown, start, struct.unpack_from(">I", content, start)[0] + 24)
    (tmp_path / "uneven.mp4").write_bytes(grown)
    assert "10 to 80 ms pass" in detect([tmp_path / "uneven.mp4"]).findings[0].sentence


def test_a_video_whose_header_counts_no_frames_is_looked_at_all_over(tmp_path: Path) -> None:
    """The mask of what stands still must not be learned from the first frame alone."""
    path = video(tmp_path / "endless.m2v", "mpg2")
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) < 1
    result = detect([path], DetectionSettings(mask_static=True))
    assert result.findings == ()
    assert result.cameras[0].expected == 30
    assert (result.blobs.counts >= 2).mean() > 0.9


@pytest.mark.parametrize("bits", [8, 16])
def test_pages_of_a_tiff_are_the_images(tmp_path: Path, bits: int) -> None:
    pages = [filmed(frame, 255 if bits == 8 else 4095) for frame in range(6)]
    cv2.imwritemulti(str(tmp_path / "cam.tif"), pages)
    found = detect([tmp_path / "cam.tif"])
    for frame, page in enumerate(pages):
        alone = find_blobs(page, BlobSettings(threshold=found.cameras[0].threshold, min_peak=found.cameras[0].min_peak))
        assert np.array_equal(found.blobs.of(frame, 0), alone.xy)


def test_a_tiff_that_breaks_off_is_named(tmp_path: Path) -> None:
    cv2.imwritemulti(str(tmp_path / "cam.tif"), [filmed(frame) for frame in range(6)])
    whole = (tmp_path / "cam.tif").read_bytes()
    (tmp_path / "cut.tif").write_bytes(whole[: int(0.7 * len(whole))])
    result = detect([tmp_path / "cut.tif"])
    assert 1 < result.cameras[0].frames < 6
    assert f"breaks off after image {result.cameras[0].frames}" in result.findings[0].sentence
    (tmp_path / "round.tif").write_bytes(whole)
    changed = bytearray(whole)
    (first,) = struct.unpack_from("<I", whole, 4)
    (entries,) = struct.unpack_from("<H", whole, first)
    struct.pack_into("<I", changed, first + 2 + 12 * entries, first)
    (tmp_path / "round.tif").write_bytes(changed)
    assert detect([tmp_path / "round.tif"]).cameras[0].frames == 1


def test_pages_of_a_tiff_that_hold_no_image_are_not_followed(tmp_path: Path) -> None:
    """Descriptions of six bytes each, a hundred thousand of which fit into a small file, end the file for us."""
    cv2.imwritemulti(str(tmp_path / "cam.tif"), [filmed(frame) for frame in range(2)])
    content = bytearray((tmp_path / "cam.tif").read_bytes())
    at = 4
    for _ in range(3):
        (page,) = struct.unpack_from("<I", content, at)
        if page:
            at = page + 2 + 12 * struct.unpack_from("<H", content, page)[0]
    struct.pack_into("<I", content, at, len(content))
    for _ in range(100_000):
        content += struct.pack("<HI", 0, len(content) + 6)
    (tmp_path / "chain.tif").write_bytes(content)
    pages, cut = sources._pages(tmp_path / "chain.tif")
    assert len(pages) == 2 and cut


def test_a_folder_of_two_cameras_is_refused(tmp_path: Path) -> None:
    both = folder(folder(tmp_path / "both", name="left_%d.png"), name="right_%d.png")
    with pytest.raises(AsterismError, match="one camera's"):
        detect([both])
    assert detect([both / "left_%d.png", both / "right_%d.png"]).findings == ()
    one = folder(tmp_path / "one")
    cv2.imwrite(str(one / "background.png"), filmed(0, many=0))
    with pytest.raises(AsterismError, match=r"holds background\.png beside img_0\.png"):
        detect([one])


def test_frame_numbers_of_several_cameras_are_counted_alike(tmp_path: Path) -> None:
    """One camera saved every second frame: its images 0, 2, 4 are not the other's 0, 1, 2."""
    every = folder(tmp_path / "every")
    second = tmp_path / "second"
    second.mkdir()
    for frame in range(0, 12, 2):
        cv2.imwrite(str(second / f"{frame}.png"), filmed(frame))
    blobs = detect([every, second]).blobs
    for frame in range(12):
        expected = blobs.of(frame, 0) if frame % 2 == 0 else np.zeros((0, 2))
        assert np.array_equal(blobs.of(frame, 1), expected)
    tens = folder(tmp_path / "tens", name="%d0.png")
    assert (detect([tens]).blobs.counts > 0).all()
    (every / "img_3.png").unlink()
    blobs = detect([every, video(tmp_path / "film.avi", frames=12)]).blobs
    assert blobs.counts[:, 0].tolist() == [0 if frame == 3 else 3 for frame in range(12)]


def test_one_camera_counted_from_0_and_one_from_1_is_named(tmp_path: Path) -> None:
    zero, one = folder(tmp_path / "zero"), tmp_path / "one"
    one.mkdir()
    for frame in range(12):
        cv2.imwrite(str(one / f"img_{frame + 1}.png"), filmed(frame))
    assert "camera zero has images 0 to 11, one 1 to 12: as many" in detect([zero, one]).findings[0].sentence
    (one / "img_12.png").unlink()
    assert detect([zero, one]).findings == (), "its first image was lost"


def test_images_of_two_depths_are_refused(tmp_path: Path) -> None:
    mixed = folder(tmp_path / "mixed", 40)
    cv2.imwrite(str(mixed / "img_21.png"), filmed(21, 4095))
    for mask in (False, True):
        with pytest.raises(AsterismError, match=r"img_21\.png: uint16 after images of uint8"):
            detect([mixed], DetectionSettings(mask_static=mask))


def test_a_camera_without_markers_is_named(tmp_path: Path) -> None:
    dark = folder(tmp_path / "dark", many=0)
    result = detect([folder(tmp_path / "well"), dark])
    assert [(finding.code, finding.where) for finding in result.findings] == [("detect-no-markers", "dark")]
    assert str(result.findings[0]) == "camera dark: no marker in 12 images at a threshold of 25. Is it covered, dark or masked?"
    with pytest.raises(AsterismError, match="3 images are too few"):
        detect([folder(tmp_path / "few", 3)], DetectionSettings(mask_static=True))


def test_uneven_light_is_taken_off_unasked(tmp_path: Path) -> None:
    """Half of the image is brighter than the markers of the other half."""
    (tmp_path / "ramp").mkdir()
    for frame in range(10):
        image = filmed(frame, size=(320, 240)) * 0.4 + np.linspace(0, 160, 320)
        cv2.imwrite(str(tmp_path / "ramp" / f"{frame}.png"), np.rint(image).astype(np.uint8))
    result = detect([tmp_path / "ramp"])
    assert result.findings == ()
    assert (result.blobs.counts == 3).all()
    for frame in range(10):
        assert np.linalg.norm(result.blobs.of(frame, 0)[:, None] - where(frame), axis=2).min(axis=0).max() < 0.3
    alone = find_blobs(cv2.imread(str(tmp_path / "ramp" / "4.png"), cv2.IMREAD_UNCHANGED))
    assert len(alone) == 3


def test_particles_before_a_lit_ground_are_found_and_doubted(data: Path) -> None:
    """Nothing is given: the ground is taken off by the mean around each pixel, and somebody should say what is a particle."""
    folder = data / "cameras" / "particles-4cam" / "images"
    peer = np.loadtxt(folder / "cam1.10001_targets", skiprows=1)[:, 1:3] - 0.5
    result = detect([folder / "cam1.10001"])
    found = result.blobs.of(0, 0)
    assert (np.linalg.norm(peer[:, None] - found, axis=2).min(axis=1) < 1).mean() > 0.6
    assert "more than markers" in result.findings[0].sentence
    assert detect([folder / "cam1.10001"], DetectionSettings(BlobSettings(background=25))).findings == ()


def test_dim_markers_reach_down_to_the_noise() -> None:
    """A wide marker of eight times the noise is one blob without holes, and nearer to the truth than at the threshold it must pass."""
    rng = np.random.default_rng(0)
    places = np.stack(np.meshgrid(np.arange(30, 600, 45), np.arange(30, 450, 45)), axis=-1).reshape(-1, 2) + rng.uniform(
        -0.5, 0.5, (130, 2)
    )
    ys, xs = np.mgrid[:480, :640]
    image = 20 + 4.0 * rng.standard_normal((480, 640))
    for x, y in places:
        image += 32 / (1 + np.exp(np.clip((np.hypot(xs - x, ys - y) - 7) / 0.4, -50, 50)))
    grey = np.rint(image).astype(np.uint8)
    off = {}
    for name, found in (("auto", find_blobs(grey)), ("plain", find_blobs(grey, BlobSettings(threshold=automatic_threshold(grey))))):
        away = np.linalg.norm(places[:, None] - found.xy, axis=2)
        off[name] = np.sqrt((away.min(axis=1) ** 2).mean() / 2)
        assert name == "plain" or len(found) == len(places)
    assert off["auto"] < 0.7 * off["plain"]


@pytest.mark.parametrize("dark", [-3.0, 0.0, 1.0, 3.0])
def test_noise_that_is_cut_off_at_black_is_told(dark: float) -> None:
    """The lower half of the pixels is 0 and says nothing of the noise."""
    image = filmed(0, dark=dark, noise=5.0, size=(640, 480))
    assert automatic_threshold(image) > dark + 20 - 5
    assert len(find_blobs(image)) == 3


def test_a_lit_room_is_named(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    room = np.full((240, 320), 70, np.uint8)
    for x, y, w, h in rng.integers(10, 120, (12, 4)):
        cv2.rectangle(room, (int(2 * x), int(y)), (int(2 * x + w), int(y + h)), int(rng.integers(90, 160)), -1)
    (tmp_path / "room").mkdir()
    for frame in range(10):
        image = room + np.maximum(filmed(frame, dark=0, noise=0, size=(320, 240)) // 2, rng.integers(0, 3, room.shape))
        cv2.imwrite(str(tmp_path / "room" / f"{frame}.png"), image.astype(np.uint8))
    assert "more than markers" in detect([tmp_path / "room"]).findings[0].sentence
    assert detect([tmp_path / "room"], DetectionSettings(BlobSettings(threshold=175))).findings == ()


def test_interlaced_video_is_named(tmp_path: Path) -> None:
    """Each second row shows the markers 10 px farther: combs, not markers."""
    (tmp_path / "comb").mkdir()
    for frame in range(4):
        image = filmed(frame)
        image[1::2] = np.roll(filmed(frame), 10, axis=1)[1::2]
        cv2.imwrite(str(tmp_path / "comb" / f"{frame}.png"), image)
    result = detect([tmp_path / "comb"])
    assert (result.blobs.counts > 6).all()
    assert "one row of pixels" in result.findings[0].sentence


def test_a_camera_that_changes_its_gain_keeps_its_markers(tmp_path: Path) -> None:
    (tmp_path / "gain").mkdir()
    for frame in range(30):
        cv2.imwrite(str(tmp_path / "gain" / f"{frame}.png"), filmed(frame, dark=10 + 3 * frame) if frame else filmed(0, dark=10))
    result = detect([tmp_path / "gain"])
    assert (result.blobs.counts == 3).all()


def test_saturation_is_told_by_the_bits_that_are_used() -> None:
    image = np.minimum(filmed(0, 4095).astype(int) * 2, 4095).astype(np.uint16)
    assert (find_blobs(image).flags & Flag.SATURATED).all()
    assert not (find_blobs(filmed(0, 4095)).flags & Flag.SATURATED).any()


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_does_not_wait_for_the_other_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int) -> None:
    cameras = [folder(tmp_path / f"c{c}", 100) for c in range(2)]
    looked_at = []

    def slow(image: np.ndarray, settings: BlobSettings) -> ImageBlobs:
        looked_at.append(1)
        time.sleep(0.002)
        return find_blobs(image, settings)

    def interrupt(share: float, doing: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("asterism.detection.camera_images.find_blobs", slow)
    with pytest.raises(KeyboardInterrupt):
        detect(cameras, workers=workers, progress=interrupt)
    assert len(looked_at) < 60


def test_outputs_are_no_inputs_and_not_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = video(tmp_path / "film.avi", frames=12)
    content = film.read_bytes()
    for arguments, message in [
        (["-o", str(film), "--overwrite"], "is an input"),
        (["-o", str(tmp_path / "a.csv"), "--json", str(tmp_path / "a.csv")], "named twice"),
        (["-o", "/proc/a.csv"], "cannot be written to"),
    ]:
        assert main(["detect", str(film), *arguments]) == 2
        assert message in capsys.readouterr().err
    assert film.read_bytes() == content
    assert main(["detect", str(film), "-o", str(tmp_path / "a.csv")]) == 0
    assert len(read_blobs(tmp_path / "a.csv")) == 12
    with pytest.raises(AsterismError, match="given twice"):
        detect([film, film])


def test_times_as_people_write_them(tmp_path: Path) -> None:
    """Semicolons and decimal commas, frames as 3.0, UTF-16: the same times; half of a step of 20 ms between the cameras."""
    cameras = [folder(tmp_path / f"cam{c}") for c in range(2)]
    rows = [f"cam{c},{t}.0,{t / 50 + c / 100:.3f}" for c in range(2) for t in range(12)]
    plain = "\n".join(["camera,frame,time (s)", *rows])
    (tmp_path / "plain.csv").write_text(plain)
    (tmp_path / "german.csv").write_text(plain.replace(",", ";").replace(".", ","))
    (tmp_path / "excel.csv").write_bytes(plain.encode("utf-16"))
    found = [detect(cameras, DetectionSettings(times=tmp_path / f"{name}.csv")).blobs for name in ("plain", "german", "excel")]
    assert found[0].times is not None
    assert found[0].times[5].tolist() == pytest.approx([0.105, 0.105])
    for blobs in found[1:]:
        assert np.array_equal(blobs.xy, found[0].xy)


def test_what_cannot_be_followed_to_a_common_clock_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cameras = [folder(tmp_path / f"cam{c}") for c in range(2)]
    for name, late in (("together", 0.0), ("apart", 0.01)):
        rows = ["camera,frame,time", *(f"cam{c},{t},{t / 50 + c * late}" for c in range(2) for t in range(12))]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
        arguments = ["detect", *map(str, cameras), "-o", str(tmp_path / f"2d-{name}.csv"), "--times", str(tmp_path / f"{name}.csv")]
        assert main(arguments) == 0
    together, apart = [line for line in capsys.readouterr().out.splitlines() if "blobs ->" in line or "followed" in line]
    assert "72 blobs -> " in together
    assert "66 blobs at common instants, without the 8.3 % that cannot be followed" in apart


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["cam,0,0", "cam,1,20", "cam,2,40"], "times in seconds"),
        (["cam,0,0", "cam,1,0.1", "cam,1,0.2"], "two rows of image 1"),
        (["cam,0,0", "cam,1.5,0.1"], "line 3"),
        (["cam,0,0", "cam,1,nan"], "line 3"),
        (["cam,0,0", "cam,1"], "line 3"),
        ([], "no rows"),
    ],
)
def test_times_that_cannot_be_are_refused(tmp_path: Path, rows: list[str], message: str) -> None:
    (tmp_path / "times.csv").write_text("\n".join(["camera,frame,time", *rows]))
    with pytest.raises(AsterismError, match=message):
        read_times(tmp_path / "times.csv")


def test_two_images_of_one_common_frame_are_refused(tmp_path: Path) -> None:
    (tmp_path / "times.csv").write_text("cam_id,frame_index,frame_time,sync_index\n0,0,0.0,7\n0,1,0.1,7\n")
    with pytest.raises(AsterismError, match="camera 0 has two rows of common frame 7"):
        read_times(tmp_path / "times.csv")
