"""A pattern in; what a print shop takes out: SVG, PDF in pages with cut marks, or PNG, with a card of the inks below the cloth."""

from __future__ import annotations

import colorsys
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

import cv2
import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.findings import Finding, Severity
from asterism.garment.pattern import Pattern
from asterism.recording import Floats

PAGES = {
    "a4": (0.210, 0.297),
    "a3": (0.297, 0.420),
    "a2": (0.420, 0.594),
    "a1": (0.594, 0.841),
    "a0": (0.841, 1.189),
    "letter": (0.2159, 0.2794),
}
"""Widths and heights (m) of pages by name."""
_MM = 1000.0
_POINTS = 72.0 / 0.0254
_MOST_PIXELS = 32_000
_KAPPA = 0.5522847498
"""Of the four Bezier curves that make a circle: the largest error is 0.03 % of the radius."""
_CLOSE = 0.14
"""In shares of light: nearer printed colours are confused under coloured lamps. The four spread hues are 0.60 apart, seven 0.20."""
_NEUGEBAUER = np.array(
    [
        [(255, 255, 255), (255, 237, 0)],
        [(226, 0, 122), (227, 6, 19)],
        [(0, 158, 224), (0, 150, 64)],
        [(49, 39, 131), (56, 38, 36)],
    ],
    dtype=np.float64,
).reshape(2, 2, 2, 3)
"""sRGB of cyan (first axis), magenta and yellow ink, each full or none, on coated paper."""


@dataclass(frozen=True)
class SheetRules:
    """How a pattern is printed; lengths in metres.

    margin      dark cloth around the circles
    background  hue, saturation and value of the cloth
    page        width and height of the pages of a PDF; None: one page of the sheet's size
    overlap     of neighbouring pages
    edge        unprinted edge of a page
    dpi         pixels per inch of a PNG
    card        whether the colour card is printed below the circles
    """

    margin: float = 0.02
    background: tuple[float, float, float] = (0.0, 0.0, 0.06)
    page: tuple[float, float] | None = PAGES["a4"]
    overlap: float = 0.01
    edge: float = 0.008
    dpi: float = 150.0
    card: bool = True


@dataclass(frozen=True)
class Drawing:
    """What is printed: lengths in metres, from the upper left, y down; colours 0 to 1, red, green, blue.

    size     width and height
    ground   colour of the cloth
    circles  (n, 3) x, y, radius; inks (n, 3) their colours
    patches  (m, 4) x, y, width, height of the card; patch_inks (m, 3)
    texts    (x, y, height, words)
    """

    size: tuple[float, float]
    ground: tuple[float, float, float]
    circles: Floats
    inks: Floats
    patches: Floats
    patch_inks: Floats
    texts: tuple[tuple[float, float, float, str], ...]


def drawing_of(pattern: Pattern, rules: SheetRules | None = None) -> Drawing:
    """Lay a pattern out: dark ground, circles, the names of the pieces above them, and a card of all inks, white and the cloth."""
    rules = rules or SheetRules()
    colours = np.array([colorsys.hsv_to_rgb(*colour) for colour in pattern.hsv])
    rows, cols = pattern.shape
    cells = np.argwhere(pattern.colours >= 0)
    radius = 0.5 * pattern.diameter
    offset = rules.margin + radius
    # Places are the circles' middles, a margin and a radius from the edge.
    circles = np.column_stack([offset + cells[:, 1] * pattern.pitch, offset + cells[:, 0] * pattern.pitch, np.full(len(cells), radius)])
    width = 2 * offset + (cols - 1) * pattern.pitch
    height = 2 * offset + (rows - 1) * pattern.pitch
    texts = []
    word = min(0.6 * rules.margin, 0.01)
    for piece in pattern.pieces:
        left, top = offset - radius + piece.column * pattern.pitch, offset - radius + piece.row * pattern.pitch
        texts.append((left, top - 0.5 * (rules.margin - word), word, piece.name))
    patches, inks = np.zeros((0, 4)), np.zeros((0, 3))
    if rules.card:
        # The card is as wide as the sheet at most.
        side = min(2.0 * pattern.pitch, (width - 2 * rules.margin) / (1.5 * (len(colours) + 1)))
        lefts = rules.margin + 1.5 * side * np.arange(len(colours) + 1)
        patches = np.column_stack([lefts, np.full(len(lefts), height), np.full((len(lefts), 2), side)])
        # White beside the inks, by which a photo's white balance can be judged.
        inks = np.concatenate([colours, np.ones((1, 3))])
        height += side + rules.margin
    ground = colorsys.hsv_to_rgb(*rules.background)
    return Drawing((width, height), ground, circles, colours[pattern.colours[pattern.colours >= 0]], patches, inks, tuple(texts))


def print_pattern(pattern: Pattern, path: str | Path, rules: SheetRules | None = None) -> list[Path]:
    """Write the print as its suffix says (.svg, .pdf, .png), and the description and lookup beside it. Returns the files, the print first.

    Lengths are true to scale: tell the print shop to scale by 100 %. Raises AsterismError for another suffix, for a PNG of more than 32,000
    pixels a side, and where a file cannot be written.
    """
    rules, path = rules or SheetRules(), Path(path)
    drawing = drawing_of(pattern, rules)
    suffix = path.suffix.lower()
    if suffix == ".svg":
        data = utf8(as_svg(drawing))
    elif suffix == ".pdf":
        data = as_pdf(drawing, rules)
    elif suffix == ".png":
        data = as_png(drawing, rules)
    else:
        raise AsterismError(f"{path} is no print; end its name in .svg, .pdf or .png.")
    write_atomically(path, data)
    description = pattern.save(path)
    return [path, description, description.with_suffix(".npz")]


def as_svg(drawing: Drawing) -> str:
    """The drawing as SVG, millimetres."""
    width, height = (_MM * side for side in drawing.size)
    size = f'width="{width:.3f}mm" height="{height:.3f}mm" viewBox="0 0 {width:.3f} {height:.3f}"'
    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', f'<rect width="100%" height="100%" fill="{_hex(drawing.ground)}"/>']
    # One group per ink keeps the file a third as large.
    for ink in np.unique(drawing.inks, axis=0):
        lines.append(f'<g fill="{_hex(ink)}">')
        of_ink = drawing.circles[(drawing.inks == ink).all(axis=1)] * _MM
        lines += [f'<circle cx="{x:.3f}" cy="{y:.3f}" r="{r:.3f}"/>' for x, y, r in of_ink]
        lines.append("</g>")
    for (x, y, w, h), ink in zip(drawing.patches * _MM, drawing.patch_inks, strict=True):
        lines.append(f'<rect x="{x:.3f}" y="{y:.3f}" width="{w:.3f}" height="{h:.3f}" fill="{_hex(ink)}"/>')
    for x, y, height, words in drawing.texts:
        place = f'x="{x * _MM:.3f}" y="{y * _MM:.3f}" font-size="{height * _MM:.2f}"'
        lines.append(f'<text {place} font-family="sans-serif" fill="#666">{escape(words)}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def as_png(drawing: Drawing, rules: SheetRules) -> bytes:
    """The drawing as PNG with its resolution in the file, (h, w, 3), edges smoothed."""
    scale = rules.dpi / 0.0254
    # The size is checked before memory is asked for.
    width, height = (round(side * scale) for side in drawing.size)
    if max(width, height) > _MOST_PIXELS:
        raise AsterismError(f"a PNG of {width} x {height} pixels is too large; take fewer dpi, or SVG or PDF.")
    image = np.empty((height, width, 3), dtype=np.uint8)
    image[:] = _bgr(drawing.ground)
    for (x, y, r), ink in zip(drawing.circles * scale, drawing.inks, strict=True):
        # Shifted by four bits: places are whole sixteenths of a pixel, whose centres are at whole numbers.
        middle = (round(16 * (x - 0.5)), round(16 * (y - 0.5)))
        cv2.circle(image, middle, round(16 * r), _bgr(ink), cv2.FILLED, cv2.LINE_AA, 4)
    for (x, y, w, h), ink in zip(drawing.patches * scale, drawing.patch_inks, strict=True):
        image[round(y) : round(y + h), round(x) : round(x + w)] = _bgr(ink)
    for x, y, high, words in drawing.texts:
        size = high * scale / 22.0
        cv2.putText(image, words, (round(x * scale), round(y * scale)), cv2.FONT_HERSHEY_SIMPLEX, size, (102, 102, 102), 1, cv2.LINE_AA)
    data = bytes(cv2.imencode(".png", image)[1])
    # OpenCV writes no resolution, so the chunk is put behind the header by hand; a print shop scales by it.
    density = round(scale).to_bytes(4, "big")
    chunk = b"pHYs" + density + density + b"\x01"
    mark = len(chunk) - 4
    return data[:33] + mark.to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big") + data[33:]


def as_pdf(drawing: Drawing, rules: SheetRules) -> bytes:
    """The drawing as PDF: pages from the upper left, rows first, that overlap, with cut marks at their corners and their row and column."""
    page = rules.page or drawing.size
    edge, overlap = (rules.edge, rules.overlap) if rules.page else (0.0, 0.0)
    shown = (page[0] - 2 * edge, page[1] - 2 * edge)
    if min(shown) <= 2 * overlap:
        raise AsterismError(f"pages of {page[0]:g} x {page[1]:g} m leave no room beside their edge and overlap; take larger ones.")
    # The last page of a row may be narrower; a billionth keeps an exact fit from asking for one page more.
    counts = [max(1, int(np.ceil((side - overlap) / (part - overlap) - 1e-9))) for side, part in zip(drawing.size, shown, strict=True)]
    contents = []
    for row in range(counts[1]):
        for column in range(counts[0]):
            corner = (column * (shown[0] - overlap), row * (shown[1] - overlap))
            name = f"row {row + 1} of {counts[1]}, column {column + 1} of {counts[0]}" if rules.page else ""
            contents.append("\n".join(_page(drawing, corner, page, edge, name)))
    return _pdf_file(contents, page)


def _page(drawing: Drawing, corner: tuple[float, float], page: tuple[float, float], edge: float, name: str) -> Iterator[str]:
    """The operators that draw one page of a PDF."""
    width, height = page[0] - 2 * edge, page[1] - 2 * edge
    k = _POINTS
    yield f"q {k * edge:.3f} {k * edge:.3f} {k * width:.3f} {k * height:.3f} re W n"
    # From here on millimetres from the sheet's upper left, y down.
    yield f"{k / _MM:.6f} 0 0 {-k / _MM:.6f} {k * (edge - corner[0]):.3f} {k * (page[1] - edge + corner[1]):.3f} cm"
    yield f"{_rgb(drawing.ground)} rg 0 0 {drawing.size[0] * _MM:.3f} {drawing.size[1] * _MM:.3f} re f"
    low, high = np.array(corner), np.add(corner, (width, height))
    # A page draws only the circles that reach into it.
    near = ((drawing.circles[:, :2] + drawing.circles[:, 2:] > low) & (drawing.circles[:, :2] - drawing.circles[:, 2:] < high)).all(axis=1)
    for ink in np.unique(drawing.inks, axis=0):
        yield f"{_rgb(ink)} rg"
        for x, y, r in drawing.circles[near & (drawing.inks == ink).all(axis=1)] * _MM:
            yield _disc(x, y, r)
    for (x, y, w, h), ink in zip(drawing.patches * _MM, drawing.patch_inks, strict=True):
        yield f"{_rgb(ink)} rg {x:.3f} {y:.3f} {w:.3f} {h:.3f} re f"
    for x, y, size, words in drawing.texts:
        yield f"0.4 0.4 0.4 rg BT /F1 {size * _MM:.2f} Tf 1 0 0 -1 {x * _MM:.3f} {y * _MM:.3f} Tm ({_pdf_text(words)}) Tj ET"
    yield "Q"
    if name:
        yield f"0 G 0.3 w {_cut_marks(page, edge)} S"
        yield f"0 g BT /F1 7 Tf {k * edge * 2:.2f} {k * edge * 0.3:.2f} Td ({_pdf_text(name)}) Tj ET"


def _disc(x: float, y: float, r: float) -> str:
    """A filled circle of four Bezier curves."""
    c = r * _KAPPA
    return (
        f"{x + r:.3f} {y:.3f} m {x + r:.3f} {y + c:.3f} {x + c:.3f} {y + r:.3f} {x:.3f} {y + r:.3f} c "
        f"{x - c:.3f} {y + r:.3f} {x - r:.3f} {y + c:.3f} {x - r:.3f} {y:.3f} c "
        f"{x - r:.3f} {y - c:.3f} {x - c:.3f} {y - r:.3f} {x:.3f} {y - r:.3f} c "
        f"{x + c:.3f} {y - r:.3f} {x + r:.3f} {y - c:.3f} {x + r:.3f} {y:.3f} c f"
    )


def _cut_marks(page: tuple[float, float], edge: float) -> str:
    """Lines in the unprinted edge, at the four corners of what is printed."""
    lines = []
    for x in (edge, page[0] - edge):
        for y in (edge, page[1] - edge):
            # Marks lie outside of what is printed, so that they are gone once the page is cut.
            out_x, out_y = (0.1 * edge if x == edge else page[0] - 0.1 * edge), (0.1 * edge if y == edge else page[1] - 0.1 * edge)
            for one, other in (((x, out_y), (x, y + 0.25 * (out_y - y))), ((out_x, y), (x + 0.25 * (out_x - x), y))):
                lines.append(" ".join(f"{_POINTS * v:.3f}" for v in one) + " m " + " ".join(f"{_POINTS * v:.3f}" for v in other) + " l")
    return " ".join(lines)


def _pdf_file(contents: list[str], page: tuple[float, float]) -> bytes:
    """The bytes of a PDF (1.4) of these pages."""
    count = len(contents)
    kids = " ".join(f"{4 + 2 * i} 0 R" for i in range(count))
    box = f"[0 0 {_POINTS * page[0]:.3f} {_POINTS * page[1]:.3f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {count} /MediaBox {box} /Resources << /Font << /F1 3 0 R >> >> >>".encode(),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for i, content in enumerate(contents):
        packed = zlib.compress(content.encode("latin-1", "replace"), 9)
        objects.append(f"<< /Type /Page /Parent 2 0 R /Contents {5 + 2 * i} 0 R >>".encode())
        objects.append(f"<< /Length {len(packed)} /Filter /FlateDecode >>\nstream\n".encode() + packed + b"\nendstream")
    # The cross-reference table needs the place of each object in the file.
    out, places = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"), []
    for number, body in enumerate(objects, 1):
        places.append(len(out))
        out += f"{number} 0 obj\n".encode() + body + b"\nendobj\n"
    table = len(out)
    out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode() + b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
    return bytes(out + f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{table}\n%%EOF\n".encode())


def printed_colours(hsv: Floats) -> Floats:
    """How colours (q, 3) HSV come out in cyan, magenta and yellow on coated paper, (q, 3) linear red, green, blue.

    Each ink covers a share of the paper, one minus the channel that it absorbs. The light is the mean of the eight overprints, each
    weighted by the share of the paper that shows it (Neugebauer's equations with Demichel's weights). A saturated green or blue of a
    screen comes out darker and less pure, which brings colours nearer to each other.
    """
    primaries = np.where(_NEUGEBAUER <= 10.3, _NEUGEBAUER / 3294.6, ((_NEUGEBAUER / 255 + 0.055) / 1.055) ** 2.4)
    light = []
    # The eight overprints of three inks, each weighted by the share of paper that shows it.
    for colour in np.atleast_2d(hsv):
        cover = 1.0 - np.array(colorsys.hsv_to_rgb(*colour))
        weights = np.ones((2, 2, 2))
        for axis, share in enumerate(cover):
            weights *= np.expand_dims(np.array([1 - share, share]), tuple({0, 1, 2} - {axis}))
        light.append(np.tensordot(weights, primaries, axes=3))
    return np.array(light)


def ink_findings(hsv: Floats) -> list[Finding]:
    """What speaks against the colours of a pattern: two that are close once printed, and colours that are pale or dark on a dark cloth."""
    hsv = np.atleast_2d(np.asarray(hsv, dtype=np.float64))
    light = printed_colours(hsv)
    shares = light / light.sum(axis=1, keepdims=True)
    found = []
    for one in range(len(hsv)):
        for two in range(one + 1, len(hsv)):
            apart = float(np.linalg.norm(shares[one] - shares[two]))
            if apart < _CLOSE:
                sentence = f"Colours {one} and {two} are {apart:.2f} apart once printed, less than {_CLOSE}."
                mend = "Take fewer colours, or hues that are farther apart."
                found.append(Finding("garment-colours-close", Severity.WARNING, f"colours {one} and {two}", sentence, mend))
    for number, (_, saturation, value) in enumerate(hsv):
        if saturation < 0.6 or value < 0.6:
            sentence = f"Colour {number} has saturation {saturation:.2f} and value {value:.2f}."
            mend = "Take 0.6 or more of both: pale colours look like white, dark ones like the cloth."
            found.append(Finding("garment-colour-weak", Severity.WARNING, f"colour {number}", sentence, mend))
    return found


def _bgr(ink: Floats | tuple[float, float, float]) -> tuple[int, int, int]:
    red, green, blue = (round(255 * float(part)) for part in ink)
    return blue, green, red


def _hex(ink: Floats | tuple[float, float, float]) -> str:
    return "#" + "".join(f"{round(255 * float(part)):02x}" for part in ink)


def _rgb(ink: Floats | tuple[float, float, float]) -> str:
    return " ".join(f"{float(part):.4f}" for part in ink)


def _pdf_text(words: str) -> str:
    return words.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
