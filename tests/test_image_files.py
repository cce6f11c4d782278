"""Images as cameras and phones write them: 12 bits in files of 16, animated GIF, HEIC and AV1 are read, or named for what they are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.calibration.boards.footage import footage_of
from asterism.cli import main
from asterism.detection import detect
from asterism.detection.image_files import eight_bits, read_eight_bits
from asterism.errors import AsterismError
from asterism.garment import design_pattern
from asterism.garment.check import check_photo
from asterism.garment.footage import colour_footage


def box(kind: bytes, content: bytes) -> bytes:
    return (8 + len(content)).to_bytes(4, "big") + kind + content


HEIC = box(b"ftyp", b"mif1\0\0\0\0mif1heic") + box(b"meta", bytes(200))
AV1 = box(b"ftyp", b"isom\0\0\2\0isomav01iso2mp41") + box(b"moov", bytes(40) + b"av01" + bytes(400))


def moving(count: int = 6) -> list[np.ndarray]:
    images = [np.zeros((90, 120), np.uint8) for _ in range(count)]
    for number, image in enumerate(images):
        cv2.circle(image, (30 + 8 * number, 45), 5, 255, -1, cv2.LINE_AA)
    return images


@pytest.mark.parametrize(("bits", "left"), [(10, 0), (12, 0), (14, 0), (16, 0), (12, 4)])
def test_a_sensor_of_any_depth_fills_eight_bits(bits: int, left: int) -> None:
    """12 bits may stand in the lower or in the upper ones of 16."""
    ramp = np.linspace(0, 255, 2000).astype(np.uint8)
    assert np.array_equal(eight_bits(ramp.astype(np.uint16) << np.uint16(bits - 8 + left)), ramp)
    assert eight_bits(np.zeros(3, np.float32)) is None


def test_twelve_bits_in_a_file_of_sixteen_are_a_board_and_a_garment(tmp_path: Path) -> None:
    pattern = design_pattern((9, 11), seed=2)
    inks = np.array([(60, 60, 165), (60, 150, 160), (95, 125, 70), (125, 65, 75)], np.uint8)
    image = np.full((230, 260, 3), 38, np.uint8)
    for (row, col), colour in np.ndenumerate(pattern.colours):
        cv2.circle(image, ((col + 1) * 320, (row + 1) * 320), 90, inks[colour].tolist(), -1, cv2.LINE_AA, 4)
    deep, plain = tmp_path / "dëep" / "cam_1.png", tmp_path / "plain.png"
    deep.parent.mkdir()
    for path, pixels in ((deep, image.astype(np.uint16) * 16), (plain, image)):
        path.write_bytes(cv2.imencode(".png", pixels)[1].tobytes())
    read = read_eight_bits(deep, colour=True)
    assert read is not None and np.array_equal(read, image)
    assert check_photo(read, pattern).identified == len(pattern.known)
    [[(_, grey)]] = [list(camera) for camera in footage_of([deep.parent])]
    assert np.abs(grey.astype(int) - cv2.imread(str(plain), cv2.IMREAD_GRAYSCALE)).max() <= 1
    [(_, [colour])] = list(colour_footage([deep.parent]))
    assert np.array_equal(colour, image)


@pytest.mark.skipif(not hasattr(cv2, "Animation"), reason="this OpenCV writes no animated GIF")
def test_an_animated_gif_is_all_of_its_images(tmp_path: Path) -> None:
    images, animation = moving(), cv2.Animation()
    animation.frames = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in images]
    animation.durations = np.full(len(images), 40, np.int32)
    path = tmp_path / "cam.gif"
    assert cv2.imwriteanimation(str(path), animation)
    found = detect([path])
    assert found.cameras[0].frames == 6 and (found.blobs.counts == 1).all()
    assert [round(float(found.blobs.of(frame, 0)[0, 0])) for frame in range(6)] == [30 + 8 * number for number in range(6)]
    assert len(footage_of([path])[0]) == 6


@pytest.mark.parametrize(("name", "content", "said"), [("photo.heic", HEIC, "is an HEIC photo"), ("photo.jpg", HEIC, "is an HEIC photo"),
                                                      ("film.mp4", AV1, "is an AV1 video")])  # fmt: skip
def test_what_is_not_read_is_named(name: str, content: bytes, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "cam").mkdir()
    path = tmp_path / "cam" / name
    path.write_bytes(content)
    with pytest.raises(AsterismError, match=said):
        detect([path])
    if name != "film.mp4":
        with pytest.raises(AsterismError, match=said):
            detect([path.parent])
    garment, rig = tmp_path / "suit.toml", tmp_path / "rig.toml"
    design_pattern((9, 11), seed=2).save(garment)
    words = ["calibrate", "board", str(path.parent), "--chessboard", "9x6", "--square", "0.02", "-o", str(rig)]
    assert main(words) == 2 and said in capsys.readouterr().err
    assert main(["garment", "check", str(path), "-g", str(garment)]) == 2 and said in capsys.readouterr().err
