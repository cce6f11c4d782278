"""Courses of the correction loop in; `docs/loop.svg` out: labels touched by hand against what is wrong or missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PICTURE = Path(__file__).parents[2] / "docs" / "loop.svg"

_WIDTH, _HEIGHT = 720, 420
_LEFT, _RIGHT, _TOP, _LOW = 84, 700, 60, 362
_COLORS = ("#0f7b8a", "#d1495b", "#d98f2b", "#5b5f97", "#3a9d5d", "#8d5a97")
_SHARES = (0.0, 0.0001, 0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8)
_ASKED_TOUCHED, _ASKED_WRONG = 0.005, 0.001


@dataclass(frozen=True)
class Line:
    """One course: its name, whether its line is dashed, and (share touched, share wrong or missing) after each round."""

    name: str
    dashed: bool
    points: Sequence[tuple[float, float]]


def picture(lines: Sequence[Line], people: int) -> str:
    """The SVG text; both scales are square roots, so that small shares show."""
    widest = 1.15 * max(_ASKED_TOUCHED, *(touched for line in lines for touched, _ in line.points))
    highest = 1.15 * max(_ASKED_WRONG, *(error for line in lines for _, error in line.points))

    def across(share: float) -> float:
        return _LEFT + (_RIGHT - _LEFT) * (share / widest) ** 0.5

    def up(share: float) -> float:
        return _LOW - (_LOW - _TOP) * (share / highest) ** 0.5

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="12">',
        "<title>Labels touched by hand against labels wrong or missing, from one trial to all subjects</title>",
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" rx="12" fill="#ffffff"/>',
        f'<text x="{_LEFT}" y="26" fill="#16213a" font-size="14">From one walk to {people} people, 3 of 15 markers hidden, 3 ghosts: '
        "errors as hand work grows</text>",
        f'<text x="{_LEFT}" y="44" fill="#5b6780">A dot is a round: label, settle what is flagged, learn. '
        "Dashed: the first walk was named, not labelled.</text>",
        f'<rect x="{_LEFT}" y="{up(_ASKED_WRONG):.1f}" width="{across(_ASKED_TOUCHED) - _LEFT:.1f}" '
        f'height="{_LOW - up(_ASKED_WRONG):.1f}" fill="#e3f4ea"/>',
    ]
    last_x, last_y = float("-inf"), float("inf")
    for share in _SHARES:
        x, y = across(share), up(share)
        if x <= _RIGHT and x - last_x > 44:
            out.append(f'<path d="M{x:.1f} {_TOP}V{_LOW}" stroke="#e6ebf2"/>')
            out.append(f'<text x="{x:.1f}" y="{_LOW + 18}" fill="#5b6780" text-anchor="middle">{100 * share:g} %</text>')
            last_x = x
        if y >= _TOP and last_y - y > 18:
            out.append(f'<path d="M{_LEFT} {y:.1f}H{_RIGHT}" stroke="#e6ebf2"/>')
            out.append(f'<text x="{_LEFT - 8}" y="{y + 4:.1f}" fill="#5b6780" text-anchor="end">{100 * share:g} %</text>')
            last_y = y
    out.append(f'<text x="{across(_ASKED_TOUCHED) - 6:.1f}" y="{_LOW - 6}" fill="#3a7d55" text-anchor="end">asked</text>')
    middle = (_LEFT + _RIGHT) / 2
    out.append(f'<text x="{middle}" y="{_HEIGHT - 16}" fill="#16213a" text-anchor="middle">labels touched by hand, of all</text>')
    middle = (_LOW + _TOP) / 2
    out.append(
        f'<text x="24" y="{middle}" fill="#16213a" text-anchor="middle" transform="rotate(-90 24 {middle})">labels wrong or missing</text>'
    )
    for number, line in enumerate(lines):
        color = _COLORS[number % len(_COLORS)]
        places = [(across(touched), up(error)) for touched, error in line.points]
        dash = ' stroke-dasharray="6 4"' if line.dashed else ""
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        out.append(f'<polyline points="{path}" fill="none" stroke="{color}" stroke-width="2" stroke-linejoin="round"{dash}/>')
        out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{color}"/>' for x, y in places]
        y = _TOP + 16 + 18 * number
        out.append(f'<path d="M{_RIGHT - 150} {y - 4}h24" stroke="{color}" stroke-width="2"{dash}/>')
        out.append(f'<text x="{_RIGHT - 120}" y="{y}" fill="#16213a">from {line.name}</text>')
    return "\n".join([*out, "</svg>", ""])
