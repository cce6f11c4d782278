"""A photo checks itself; and prints under distortions that the renderer does not know; on the command line, too."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.cli import main
from asterism.garment import Pattern, design_pattern
from asterism.garment.check import check_photo, judge_reading, misread_blocks
from asterism.garment.read import ReadCircles, read_image
from asterism.garment.sheet import SheetRules, as_png, drawing_of

DPI = 34.0


@cache
def printed(rows: int = 14, cols: int = 18) -> tuple[Pattern, np.ndarray, np.ndarray]:
    """A print as a picture, circles of 13 px, and the true centres (rows, cols, 2) px."""
    pattern, rules = design_pattern((rows, cols), seed=4), SheetRules(dpi=4 * DPI, card=False)
    large = cv2.imdecode(np.frombuffer(as_png(drawing_of(pattern, rules), rules), np.uint8), cv2.IMREAD_COLOR)
    image = cv2.resize(large, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    return pattern, image, (pattern.positions()[..., :2] + rules.margin + 0.5 * pattern.diameter) * DPI / 0.0254 - 0.5


def judged(read: ReadCircles, pattern: Pattern, places: np.ndarray) -> tuple[int, int, float]:
    """Identities that are right, that are wrong, and the largest error (px) of right ones."""
    cells = pattern.cells(read.ids[read.ids >= 0])
    off = np.hypot(*(places[cells[:, 0], cells[:, 1]] - read.centres[read.ids >= 0]).T)
    return int((off < 3).sum()), int((off >= 3).sum()), float(off[off < 3].max(initial=0.0))


def warped(corners: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The print under a random turn and perspective: image and true places."""
    _, image, places = printed()
    rng = np.random.default_rng(seed)
    height, width = image.shape[:2]
    box = np.array([[0, 0], [width, 0], [width, height], [0, height]], float)
    turn = rng.uniform(0, 2 * np.pi)
    away = (box - box.mean(axis=0)) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    away += corners * width * rng.uniform(-1, 1, (4, 2))
    away -= away.min(axis=0) - 5
    size = tuple(int(v) for v in np.ceil(away.max(axis=0)) + 5)
    homography = cv2.getPerspectiveTransform(box.astype(np.float32), away.astype(np.float32))
    seen = cv2.warpPerspective(image, homography, size, flags=cv2.INTER_AREA, borderValue=(15, 15, 15))
    return seen, cv2.perspectiveTransform(places.reshape(-1, 1, 2), homography).reshape(places.shape)


@given(st.integers(0, 2**31), st.floats(0, 0.12))
@settings(max_examples=15, deadline=None)
def test_no_identity_is_wrong_under_any_turn_and_perspective(seed: int, corners: float) -> None:
    seen, true = warped(corners, seed)
    right, wrong, worst = judged(read_image(seen, printed()[0]), printed()[0], true)
    assert wrong == 0 and right > 0.9 * 12 * 16 and worst < 1.0


def gamma(image: np.ndarray) -> np.ndarray:
    return (255 * (image / 255.0) ** 1.5).astype(np.uint8)


def colour_cast(image: np.ndarray) -> np.ndarray:
    return (image * np.array([0.5, 0.85, 1.0])).astype(np.uint8)


def jpeg(image: np.ndarray) -> np.ndarray:
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 60])[1], cv2.IMREAD_COLOR)


def motion_blur(image: np.ndarray) -> np.ndarray:
    return cv2.filter2D(image, -1, np.full((1, 5), 0.2))


def shade(image: np.ndarray) -> np.ndarray:
    return (image * np.linspace(0.25, 1.0, image.shape[1])[None, :, None]).astype(np.uint8)


def noise(image: np.ndarray) -> np.ndarray:
    return np.clip(image + np.random.default_rng(0).normal(0, 25.5, image.shape), 0, 255).astype(np.uint8)


def creases(image: np.ndarray) -> np.ndarray:
    """Waves that shift the picture by up to 6 px."""
    y, x = np.mgrid[0 : image.shape[0], 0 : image.shape[1]].astype(np.float32)
    return cv2.remap(image, x + 6 * np.sin(y / 23), y + 5 * np.sin(x / 31), cv2.INTER_LINEAR, borderValue=(15, 15, 15))


@pytest.mark.parametrize(
    ("harm", "least"),
    [(gamma, 0.9), (colour_cast, 0.9), (jpeg, 0.75), (motion_blur, 0.9), (shade, 0.9), (noise, 0.9)],  # JPEG halves the colours' resolution
    ids=lambda given: getattr(given, "__name__", ""),
)
def test_no_identity_is_wrong_under_what_the_renderer_does_not_know(harm, least) -> None:
    seen, true = warped(0.05, 3)
    right, wrong, _ = judged(read_image(harm(seen), printed()[0]), printed()[0], true)
    assert wrong == 0 and right > least * 12 * 16


def test_creased_prints_are_read() -> None:
    pattern, image, _ = printed()
    read = read_image(creases(image), pattern)
    order = pattern.cells(read.ids[read.ids >= 0])
    assert len(order) > 0.9 * 12 * 16
    links = [(read.centres[read.ids >= 0][(order == cell).all(axis=1)], cell) for cell in order]
    flat = np.array([at[0] for at, _ in links])
    assert np.abs(flat - printed()[2][order[:, 0], order[:, 1]]).max() < 9, "px: the waves, no jump to another place"


def test_a_lone_misread_colour_gives_no_wrong_identity_and_is_counted() -> None:
    pattern, image, places = printed()
    for row, col in ((5, 5), (8, 11)):
        for other in range(4):
            painted = image.copy()
            x, y = places[row, col].round().astype(int)
            donor = np.argwhere(pattern.colours[1:-1, 1:-1] == other)[0] + 1
            u, v = places[donor[0], donor[1]].round().astype(int)
            painted[y - 10 : y + 11, x - 10 : x + 11] = image[v - 10 : v + 11, u - 10 : u + 11]
            read = read_image(painted, pattern)
            right, wrong, _ = judged(read, pattern, places)
            assert wrong == 0 and right >= 12 * 16 - 1
            check = judge_reading(read, pattern)
            if other == pattern.colours[row, col]:
                assert check.existing == check.windows > 0.95 * 12 * 16 and check.misread == 0
            else:
                assert check.windows - check.existing in range(5, 10) and 0.002 < check.misread < 0.007 < check.misread_most < 0.03


def test_the_estimate_finds_the_misreads_that_were_put_in() -> None:
    """Colours changed at random in what was read: the estimate is their share, and the bound is above it in 95 of 100 trials."""
    pattern = design_pattern((40, 40), seed=2)
    rng = np.random.default_rng(0)
    from asterism.garment.identities import block_rings
    from asterism.garment.read.findings import chance_share

    estimates, above, share = [], 0, 0.01
    for _ in range(60):
        wrong = rng.random(pattern.shape) < share
        grid = np.where(wrong, (pattern.colours + rng.integers(1, 4, pattern.shape)) % 4, pattern.colours).astype(np.int8)
        rings = block_rings(grid)
        place = pattern.cells(pattern.identity(grid, rings))
        same = [
            (np.roll(block_rings(pattern.colours)[place[..., 0], place[..., 1]], 2 * k, axis=-1) == rings).all(axis=-1) for k in range(4)
        ]
        there = ((place[..., 0] >= 0) & np.any(same, axis=0))[1:-1, 1:-1]
        estimate, most = misread_blocks(there.size, int(there.sum()), chance_share(pattern))
        estimates.append(1 - (1 - estimate) ** (1 / 9))
        above += 1 - (1 - most) ** (1 / 9) > wrong.mean()
    assert np.mean(estimates) == pytest.approx(share, rel=0.1)
    assert above >= 57


def test_nothing_read_bounds_nothing() -> None:
    pattern, image, _ = printed()
    check = check_photo(np.zeros((200, 300, 3), np.uint8), pattern)
    assert (check.circles, check.windows) == (0, 0) and np.isnan([check.misread, check.misread_most, check.wrong_blocks_most]).all()
    assert [finding.code for finding in check.findings] == ["garment-no-circles"]
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert "garment-no-colours" in {finding.code for finding in check_photo(grey, pattern).findings}
    tiny = cv2.resize(image, None, fx=0.35, fy=0.35, interpolation=cv2.INTER_AREA)
    assert check_photo(tiny, pattern).findings, "circles of 4.7 px"


def test_the_wrong_garment_file_is_said_after_one_photo() -> None:
    _, image, _ = printed()
    check = check_photo(image, design_pattern((14, 18), seed=5))
    assert check.identified == 0 and check.windows > 150
    assert [finding.code for finding in check.findings] == ["garment-other-pattern"]


def test_a_few_blocks_are_too_few_for_a_bound() -> None:
    pattern, image, _ = printed()
    check = check_photo(image[:150, :150].copy(), pattern)
    assert check.misread == 0 and check.misread_most > 0.01
    assert [finding.code for finding in check.findings] == ["garment-few-blocks"]


def test_print_and_check_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["garment", "print", "--rows", "20", "--cols", "16", "-o", "suit.png", "--dpi", "50"]) == 0
    assert "252 identities" in capsys.readouterr().out
    assert main(["garment", "check", "suit.png", "--garment", "suit.toml", "--json", "-"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["photos"][0]["identified"] == 252 and told["photos"][0]["existing"] == told["photos"][0]["windows"]
    assert main(["garment", "print", "--target", "--rows", "6", "--cols", "8", "-o", "target.pdf", "--page", "420x297mm"]) == 0
    assert Pattern.load("target.toml").pitch == 0.068 and Pattern.load("target.toml").diameter == 0.038
    assert main(["garment", "print", "--garment", "suit.toml", "-o", "suit.svg"]) == 0
    capsys.readouterr()
    Path("photo.txt").write_text("no photo")
    assert main(["garment", "check", "suit.png", "photo.txt", "none.jpg", "--garment", "target.toml"]) == 1
    told = capsys.readouterr()
    assert "photo.txt is not an image" in told.err and "none.jpg does not exist" in told.err and "[garment-other-pattern]" in told.err
    assert main(["garment", "check", "none.jpg", "--garment", "suit.toml"]) == 2


def test_pieces_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shape = np.full((12, 9), 255, np.uint8)
    shape[:, 2:] = 0
    cv2.imwrite(str(tmp_path / "back.png"), shape)
    pieces = ["--piece", "arm=20x14:8", "--piece", f"back={tmp_path / 'back.png'}", "--piece", "front=8x9"]
    assert main(["garment", "print", *pieces, "-o", str(tmp_path / "suit.svg"), "--unequal-neighbours", "--diameter", "1cm"]) == 0
    pattern = Pattern.load(tmp_path / "suit.toml")
    assert [piece.name for piece in pattern.pieces] == ["arm", "back", "front"]
    assert (pattern.colours[pattern.pieces[1].cells] >= 0).sum() == 12 * 7
    side = pattern.colours[:, 1:] == pattern.colours[:, :-1]
    assert not (side & (pattern.colours[:, 1:] >= 0)).any()


@pytest.mark.parametrize(
    "words, said",
    [
        (["--rows", "9", "-o", "x.svg"], "give either"),
        (["--rows", "9", "--cols", "9", "--garment", "x.toml", "-o", "y.svg"], "give either"),
        (["--rows", "9", "--cols", "9", "-o", "x.gif"], "end its name"),
        (["--piece", "9x9", "-o", "x.svg"], "has no shape"),
        (["--piece", "a=9x9", "--piece", "a=8x8", "-o", "x.svg"], "two pieces are called a"),
        (["--piece", "a=none.png", "-o", "x.svg"], "there is no file none.png"),
        (["--rows", "9", "--cols", "9", "--pitch", "wide", "-o", "x.svg"], "--pitch wide is not a length"),
        (["--rows", "9", "--cols", "9", "--pitch", "18", "-o", "x.svg"], "give metres"),
        (["--rows", "9", "--cols", "9", "--page", "a9", "-o", "x.pdf"], "--page a9 is no page"),
        (["--rows", "300", "--cols", "300", "-o", "x.svg"], "at most 32640"),
    ],
)
def test_careless_words_are_answered(words: list[str], said: str, tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["garment", "print", *words]) == 2
    assert said in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
