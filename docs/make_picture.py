"""Draws docs/picture.svg from a simulated walker: left the anonymous cloud, right the same points with their names.

Run `python docs/make_picture.py`.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from asterism.labelling.simulated_occlusions import simulate_occlusions
from asterism.recording import Floats
from asterism.simulation import simulate_walks

WIDTH, HEIGHT = 960, 560
BODY = 430.0
BONES = (
    "LFHD RFHD RBHD LBHD LFHD, RBHD C7 T10, C7 CLAV STRN, LSHO C7 RSHO, LSHO CLAV RSHO, RASI RPSI LPSI LASI RASI, T10 LPSI, T10 RPSI, "
    "LSHO LUPA LELB LFRM LWRA LFIN, LFRM LWRB LFIN, RSHO RUPA RELB RFRM RWRA RFIN, RFRM RWRB RFIN, "
    "LASI LTHI LKNE LTIB LANK LHEE LTOE LANK, RASI RTHI RKNE RTIB RANK RHEE RTOE RANK"
)
LETTER = 6.0
"""The mean width of a letter of the legend, in picture units."""
LEFT, RIGHT, MIDDLE, STAR, GHOST = "#7fe0e6", "#ffb27a", "#f3f6fb", "#dbe6f4", "#8191a8"


def seen_from_ahead(points: Floats, heading: float) -> Floats:
    """(N, 2) picture coordinates of (N, 3) points in metres around (0, 0): an orthographic view, half from the front."""
    azimuth, elevation = heading + np.radians(44), np.radians(6)
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    toward = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    up = np.cross(toward, right)
    flat = np.stack([points @ right, -(points @ up)], axis=1)
    return (flat - (flat.min(axis=0) + flat.max(axis=0)) / 2) * BODY / np.ptp(flat[:, 1])


def place_names(at: Floats, names: list[str], taken: Floats) -> list[tuple[float, float, str]]:
    """For each name the first free place around its point: (x, y, anchor)."""
    boxes = [(x - 4, y - 4, x + 4, y + 4) for x, y in taken]
    places = []
    for (x, y), name in zip(at, names, strict=True):
        width = 6.3 * len(name)
        tries = []
        for distance in (9, 16, 25, 36):
            for dx, dy in ((1, 0), (-1, 0), (0.8, -0.7), (-0.8, -0.7), (0.8, 0.7), (-0.8, 0.7), (0, -1.1), (0, 1.1)):
                anchor = "start" if dx > 0 else "end" if dx < 0 else "middle"
                left = x + dx * distance - {"start": 0.0, "end": width, "middle": width / 2}[anchor]
                top = y + dy * distance - 5
                box = (left, top, left + width, top + 10)
                clashes = sum(box[0] < b[2] and b[0] < box[2] and box[1] < b[3] and b[1] < box[3] for b in boxes)
                tries.append((clashes, distance, x + dx * distance, y + dy * distance + 3.5, anchor, box))
        best = min(tries, key=lambda t: t[:2])
        boxes.append(best[5])
        places.append((best[2], best[3], best[4]))
    return places


def picture() -> str:
    """The picture as SVG text."""
    walk = simulate_walks(subjects=3, frames=200, markers="plug-in-gait", seed=11)[0]
    clouds, truth = simulate_occlusions(walk, occlusions=1, ghosts=2, seed=28)
    frame = round(next(event.time for event in walk.events if event.label == "Foot Strike" and event.time > 0.5) * walk.rate)
    points, names = clouds[frame], walk.labels
    column = {name: walk.positions[frame, i] for i, name in enumerate(names)}
    facing = (column["LASI"] + column["RASI"]) / 2 - (column["LPSI"] + column["RPSI"]) / 2
    flat = seen_from_ahead(points, float(np.arctan2(facing[1], facing[0])))
    flat[:, 1] += HEIGHT / 2 + 4
    given = {name: int(place) for name, place in zip(names, truth[frame], strict=True) if place >= 0}
    ghosts = sorted(set(range(len(points))) - set(given.values()))

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="Helvetica, Arial, sans-serif">',
        "<title>An anonymous cloud of points, and the same points labelled</title>",
        '<defs><linearGradient id="sky" x1="0" y1="0" x2="1" y2="1"><stop offset="0" stop-color="#0d1730"/>'
        '<stop offset="0.6" stop-color="#142a45"/><stop offset="1" stop-color="#0e4957"/></linearGradient></defs>',
        f'<rect width="{WIDTH}" height="{HEIGHT}" rx="16" fill="url(#sky)"/>',
        f'<path d="M{WIDTH / 2} 40V{HEIGHT - 40}" stroke="#ffffff" stroke-opacity=".14"/>',
    ]
    for x, text in ((WIDTH / 4, "what the cameras deliver"), (3 * WIDTH / 4, "the same points, labelled")):
        out.append(f'<text x="{x}" y="34" fill="#c9d8ea" font-size="15" text-anchor="middle">{text}</text>')
    out += [f'<circle cx="{x + WIDTH / 4:.1f}" cy="{y:.1f}" r="3.4" fill="{STAR}"/>' for x, y in flat]

    shown = flat + np.array([3 * WIDTH / 4, 0.0])
    for chain in BONES.split(", "):
        for a, b in pairwise(chain.split()):
            if a in given and b in given:
                (x1, y1), (x2, y2) = shown[given[a]], shown[given[b]]
                out.append(f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#9fc3dc" stroke-opacity=".45" stroke-width="1.3"/>')
    order = sorted(given, key=lambda name: shown[given[name]][1])
    places = place_names(shown[[given[name] for name in order]], order, shown)
    for name, (x, y, anchor) in zip(order, places, strict=True):
        color = {"L": LEFT, "R": RIGHT}.get(name[0] if name != "RBAK" else "", MIDDLE)
        cx, cy = shown[given[name]]
        out.append(f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="3.8" fill="{color}"/>')
        out.append(f'<text x="{x:.1f}" y="{y:.1f}" fill="{color}" font-size="9.5" text-anchor="{anchor}">{name}</text>')
    for ghost in ghosts:
        x, y = shown[ghost]
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.4" fill="{GHOST}"/>')
        out.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="9" fill="none" stroke="{GHOST}" stroke-dasharray="2.5 2.5"/>')
    hidden = ", ".join(name for name in names if name not in given)
    legend = ((LEFT, "left"), (RIGHT, "right"), (MIDDLE, "middle"), (GHOST, f"ghosts stay unlabelled; {hidden} is hidden"))
    x = (WIDTH - sum(30 + LETTER * len(text) for _, text in legend)) / 2
    for color, text in legend:
        out.append(f'<circle cx="{x:.0f}" cy="{HEIGHT - 25}" r="4" fill="{color}"/>')
        out.append(f'<text x="{x + 9:.0f}" y="{HEIGHT - 21}" fill="#c9d8ea" font-size="12">{text}</text>')
        x += 30 + LETTER * len(text)
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    Path(__file__).with_name("picture.svg").write_text(picture(), encoding="utf-8")
