"""Where cameras may hang: walls, tripods and ceilings of a room whose z points up; and the lenses that they may have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.cameras.accuracy import Volume
from asterism.cameras.aim import looking
from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Floats

MARGIN = 1.5
"""m between the volume and the walls, where none are given."""
LOWEST, HIGHEST = 2.2, 2.6
"""m, where cameras hang, where no heights are given (thesis 3.2.1); at least at the height of the volume (3.2.2)."""


@dataclass(frozen=True)
class Mounts:
    """Where cameras may hang.

    room     the box whose four walls (or a row of tripods before them) carry cameras
    heights  (lowest, highest) m
    ceiling  whether they may also hang anywhere over the floor, at the highest height

    A place is three numbers: metres along the walls, from the corner at low x and low y, anticlockwise; height; and 0. On the ceiling:
    x, y, and 1.
    """

    room: Volume
    heights: tuple[float, float]
    ceiling: bool = False

    def __post_init__(self) -> None:
        if not 0 <= self.heights[0] <= self.heights[1] < np.inf:
            raise AsterismError(f"cameras cannot hang from {self.heights[0]} to {self.heights[1]} m; give the lowest height first.")
        if self.heights[1] > self.room.high[2]:
            raise AsterismError(
                f"cameras cannot hang at {self.heights[1]:g} m in a room of {self.room.high[2]:g} m; give lower heights, or a higher room."
            )

    @classmethod
    def around(
        cls, volume: Volume, room: Volume | None = None, heights: tuple[float, float] | None = None, *, ceiling: bool = False
    ) -> Mounts:
        """The mounts for a volume: walls 1.5 m around it, 2.2 m high and up to 2.6 m or as high as the volume, where nothing else is given.

        In a room that is lower they hang as high as that. Raises AsterismError where the room does not hold the volume, or ends below them.
        """
        wanted = max(HIGHEST, float(volume.high[2])) if heights is None else heights[1]
        # Without a room, walls stand around the volume as far as people set up tripods.
        if room is None:
            aside = np.array([MARGIN, MARGIN, 0.0])
            room = Volume(volume.low - aside, np.array([*(volume.high + aside)[:2], max(wanted, volume.high[2] + 0.5)]))
        if np.any(room.low[:2] > volume.low[:2]) or np.any(room.high < volume.high):
            raise AsterismError("the room does not hold the volume; make it larger, or the volume smaller.")
        if heights is None:
            top = min(wanted, float(room.high[2]))
            heights = (min(LOWEST, top), top)
        return cls(room, heights, ceiling)

    @property
    def around_m(self) -> float:
        """The length of the walls, m."""
        return float(2 * self.room.size[:2].sum())

    def position(self, place: Floats) -> Floats:
        """(3,) m in the room; a place beyond the limits is moved to them."""
        (left, front, _), (right, back, _) = self.room.low, self.room.high
        if place[2] > 0.5:
            x, y = float(np.clip(place[0], left, right)), float(np.clip(place[1], front, back))
            return np.array([x, y, self.heights[1]])
        width, depth, _ = self.room.size
        # The walls are one closed line, on which a search may go round any number of times.
        along = place[0] % self.around_m
        height = float(np.clip(place[1], *self.heights))
        if along < width:
            return np.array([left + along, front, height])
        if along < width + depth:
            return np.array([right, front + along - width, height])
        if along < 2 * width + depth:
            return np.array([right - (along - width - depth), back, height])
        return np.array([left, back - (along - 2 * width - depth), height])

    def candidates(self, spacing: float) -> Floats:
        """(M, 3) places all over the mounts, about `spacing` m apart."""
        along = np.linspace(0.0, self.around_m, max(4, round(self.around_m / spacing)), endpoint=False)
        low, high = self.heights
        heights = np.linspace(low, high, max(1, min(4, 1 + int(np.ceil((high - low) / spacing)))))
        places = [np.array([a, h, 0.0]) for a in along for h in heights]
        if self.ceiling:
            xs, ys, _ = self.room.axes(spacing)
            places += [np.array([x, y, 1.0]) for x in xs for y in ys]
        return np.array(places)

    def toward(self, angle: float, centre: Floats) -> Floats:
        """The place on the walls, as high as may be, in direction `angle` rad from `centre` (3,) m."""
        ahead = np.array([np.cos(angle), np.sin(angle)])
        with np.errstate(divide="ignore"):
            edge = np.where(ahead > 0, self.room.high[:2], self.room.low[:2])
            # A direction along a wall never reaches that wall.
            reach = np.where(np.abs(ahead) < 1e-12, np.inf, (edge - centre[:2]) / ahead)
        x, y = centre[:2] + reach.min() * ahead
        width, depth, _ = self.room.size
        along = {
            0: width + (y - self.room.low[1]) if ahead[0] > 0 else 2 * width + depth + (self.room.high[1] - y),
            1: width + depth + (self.room.high[0] - x) if ahead[1] > 0 else x - self.room.low[0],
        }[int(np.argmin(reach))]
        return np.array([along, self.heights[1], 0.0])


def focal_length(width: int, *, fov: float | None = None, focal_mm: float | None = None, pixel_um: float | None = None) -> float:
    """The focal length in pixels of images `width` px wide, from the horizontal angle of view (degrees), or focal length and pixel pitch.

    Raises AsterismError where neither or both are given, or a number is impossible.

    >>> round(focal_length(1280, fov=65.0))
    1005
    >>> round(focal_length(1280, focal_mm=4.8, pixel_um=4.8))
    1000
    """
    if (fov is None) == (focal_mm is None) or (focal_mm is None) != (pixel_um is None):
        raise AsterismError("a lens is its angle of view (--fov), or its focal length and the pixels' pitch (--focal-mm and --pixel-um).")
    if fov is not None:
        if not 0 < fov < 170:
            raise AsterismError(
                f"an angle of view of {fov} degrees needs a lens with strong distortion, which a plan does not model; give 1 to 169."
            )
        return float(0.5 * width / np.tan(np.radians(0.5 * fov)))
    if focal_mm is None or pixel_um is None or not (focal_mm > 0 and pixel_um > 0):
        raise AsterismError("focal length (mm) and pixel pitch (µm) must be positive.")
    return 1000.0 * focal_mm / pixel_um


def camera_at(name: str, position: Floats, target: Floats, size: tuple[int, int], focal: float) -> Camera:
    """A level camera without distortion that stands somewhere and looks at a target."""
    rotation, translation = looking(position, target)
    return Camera(name, size, (focal, focal), (0.5 * (size[0] - 1), 0.5 * (size[1] - 1)), rotation, translation)
