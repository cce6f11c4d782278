"""The print: true to scale in each form, all of it on the pages, readable again, with inks that a printer keeps apart."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
import zlib
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from asterism.errors import AsterismError
from asterism.garment import Pattern, design_pattern, tapered
from asterism.garment.pattern import spread_hues
from asterism.garment.read import read_image
from asterism.garment.sheet import PAGES, SheetRules, drawing_of, ink_findings, print_pattern, printed_colours


@cache
def pattern() -> Pattern:
    return design_pattern({"front <1>": (14, 16), "sleeve (left)": tapered(14, 12, 8)}, seed=1)


def hex_of(colour: np.ndarray) -> str:
    return "#" + "".join(f"{round(255 * v):02x}" for v in colour)


def test_svg_has_each_circle_in_its_place_and_ink(tmp_path: Path) -> None:
    rules = SheetRules()
    files = print_pattern(pattern(), tmp_path / "suit.svg", rules)
    assert [path.name for path in files] == ["suit.svg", "suit.toml", "suit.npz"]
    assert (Pattern.load(files[1]).colours == pattern().colours).all()
    root = ElementTree.parse(files[0]).getroot()
    name = "{http://www.w3.org/2000/svg}"
    seen = {}
    for group in root.iter(f"{name}g"):
        for circle in group.iter(f"{name}circle"):
            seen[circle.get("cx"), circle.get("cy")] = group.get("fill")
            assert circle.get("r") == "5.000"
    places = 1000 * np.add(pattern().positions(), (rules.margin + 0.005, rules.margin + 0.005, 0))
    inks = [hex_of(ink) for ink in drawing_of(pattern()).patch_inks]
    assert len(seen) == (pattern().colours >= 0).sum()
    for (row, col), colour in np.ndenumerate(pattern().colours):
        if colour >= 0:
            x, y, _ = places[row, col]
            assert seen[f"{x:.3f}", f"{y:.3f}"] == inks[colour]
    assert [text.text for text in root.iter(f"{name}text")] == ["front <1>", "sleeve (left)"]
    assert inks[-1] == "#ffffff" and len({*inks}) == 5
    assert root.get("width") == f"{1000 * drawing_of(pattern()).size[0]:.3f}mm"


def pages_of(data: bytes) -> list[str]:
    return [zlib.decompress(part).decode("latin-1") for part in re.findall(rb"stream\n(.*?)\nendstream", data, re.S)]


@pytest.mark.parametrize("page", ["a4", "a3", "sheet"])
def test_pdf_pages_show_every_circle_whole_somewhere_and_at_one_scale(page: str, tmp_path: Path) -> None:
    rules = SheetRules(page=PAGES.get(page))
    [path, *_] = print_pattern(pattern(), tmp_path / "suit.pdf", rules)
    data = path.read_bytes()
    width, height = (float(v) * 0.0254 / 72 for v in re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data).groups())
    drawing = drawing_of(pattern(), rules)
    assert (width, height) == pytest.approx(PAGES.get(page, drawing.size), abs=1e-5)
    whole, edge = set(), rules.edge if rules.page else 0.0
    for text in pages_of(data):
        scale, down, left, top = (float(v) for v in re.search(r"([\d.]+) 0 0 (-[\d.]+) (-?[\d.]+) (-?[\d.]+) cm", text).groups())
        assert scale == pytest.approx(72 / 25.4, rel=1e-5) and down == pytest.approx(-scale)
        for start, middle in re.findall(r"([-\d.]+) ([-\d.]+) m", text.split("Q\n")[0]):
            x, y = float(start) - 5.0, float(middle)
            on_x, on_y = (scale * x + left) * 0.0254 / 72, (down * y + top) * 0.0254 / 72
            if edge + 0.005 <= on_x <= width - edge - 0.005 and edge + 0.005 <= on_y <= height - edge - 0.005:
                whole.add((round(x, 2), round(y, 2)))
    assert whole == {(round(1000 * x, 2), round(1000 * y, 2)) for x, y, _ in drawing.circles}


def test_pdf_offsets_lead_to_its_objects_and_names_are_escaped(tmp_path: Path) -> None:
    data = print_pattern(pattern(), tmp_path / "suit.pdf")[0].read_bytes()
    table = int(re.search(rb"startxref\n(\d+)", data)[1])
    assert data[table : table + 4] == b"xref"
    for number, place in enumerate(re.findall(rb"(\d{10}) 00000 n", data), 1):
        assert data[int(place) :].startswith(f"{number} 0 obj".encode())
    texts = pages_of(data)
    assert any(r"(sleeve \(left\))" in text for text in texts)
    assert "row 1 of" in texts[0] and " l" in texts[0].split("Q\n")[1], "its place and its cut marks"


def test_a_pdf_is_the_same_bytes_again(tmp_path: Path) -> None:
    one, two = (print_pattern(pattern(), tmp_path / name)[0].read_bytes() for name in ("a.pdf", "b.pdf"))
    assert one == two


def test_a_png_is_to_scale_and_can_be_read_with_every_identity(tmp_path: Path) -> None:
    rules = SheetRules(dpi=60)
    [path, *_] = print_pattern(pattern(), tmp_path / "suit.png", rules)
    image = cv2.imread(str(path))
    place = path.read_bytes().index(b"pHYs") + 4
    assert int.from_bytes(path.read_bytes()[place : place + 4], "big") == round(60 / 0.0254)
    read = read_image(image, pattern())
    assert set(pattern().known) == set(read.ids[read.ids >= 0])
    cells = pattern().cells(read.ids[read.ids >= 0])
    true = (pattern().positions()[cells[:, 0], cells[:, 1], :2] + rules.margin + 0.005) * 60 / 0.0254 - 0.5
    assert np.abs(read.centres[read.ids >= 0] - true).max() < 0.1, "px, whose centres are whole numbers"


def test_the_card_is_beside_the_circles_and_has_all_inks() -> None:
    drawing = drawing_of(pattern())
    assert drawing.patches[:, 1].min() > (drawing.circles[:, 1] + drawing.circles[:, 2]).max()
    assert (drawing.patches[:, :2] + drawing.patches[:, 2:] < drawing.size).all()
    assert len(drawing_of(pattern(), SheetRules(card=False)).patches) == 0


def test_seven_colours_stay_apart_in_print_and_eight_do_not() -> None:
    for colours in range(2, 8):
        assert ink_findings(spread_hues(colours)) == []
    assert {finding.code for finding in ink_findings(spread_hues(8))} == {"garment-colours-close"}
    weak = ink_findings(np.array([[0, 1, 1], [0.5, 0.3, 1.0], [0.25, 1, 0.2]]))
    assert [finding.code for finding in weak if finding.code == "garment-colour-weak"] == ["garment-colour-weak"] * 2


def test_unprinted_paper_is_white_and_a_screens_green_is_darker_in_print() -> None:
    white, green = printed_colours(np.array([[0, 0, 1], [1 / 3, 1, 1]]))
    assert white == pytest.approx([1, 1, 1], abs=1e-6)
    assert 0.2 < green[1] < 0.4 and green[1] > 2 * max(green[0], green[2])


@pytest.mark.parametrize(
    "name, rules, words",
    [
        ("suit.jpg", SheetRules(), "end its name in"),
        ("suit.png", SheetRules(dpi=5000), "too large"),
        ("suit.pdf", SheetRules(page=(0.02, 0.02)), "take larger ones"),
        ("no/folder/suit.svg", SheetRules(), "cannot be written"),
    ],
)
def test_what_cannot_be_printed_is_said(name: str, rules: SheetRules, words: str, tmp_path: Path) -> None:
    with pytest.raises(AsterismError, match=words):
        print_pattern(pattern(), tmp_path / name, rules)
    assert not list(tmp_path.iterdir())
