"""A dressed wearer, a camera and a way of taking pictures in; the colour image and the truth of each circle in it out."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from asterism.cameras import Camera
from asterism.errors import AsterismError
from asterism.garment.pattern import Pattern
from asterism.recording import Floats
from asterism.simulation.garment import _raster_kernels as kernels
from asterism.simulation.garment.suit import Mesh

Image = NDArray[np.uint8]

_LEAST_DEPTH = 0.05
"""m: what is nearer to a camera than this is not drawn."""
_STEP = 1e-4
"""m, by which a circle's middle is moved to measure its ellipse in the image."""


class GarmentScene(Protocol):
    """What can be photographed: a garment on a wearer, a sheet in somebody's hands."""

    @property
    def pattern(self) -> Pattern:
        """What is printed on it."""

    def mesh(self, time: float) -> Mesh:
        """Its surface at a moment."""

    def circles(self, time: float) -> Floats:
        """(rows, cols, 3) m, the middle of each circle at a moment."""


@dataclass(frozen=True)
class Lamp:
    """A lamp without size.

    position  (3,) m
    colour    (3,) red, green, blue: what arrives at 1 m, 1 lights white cloth to the image's highest value at exposure 1
    """

    position: tuple[float, float, float]
    colour: tuple[float, float, float] = (1.0, 1.0, 1.0)


def ring_of_lamps(strength: float = 2.4, colour: Sequence[float] = (1, 1, 1)) -> tuple[Lamp, ...]:
    """Six lamps at equal angles around the wearer, 3 m away, at 2.6 and 1.04 m in turn."""
    red, green, blue = (strength * float(part) for part in colour)
    angles = 2 * np.pi * np.arange(6) / 6 + 0.3
    places = [(float(3.0 * np.cos(a)), float(3.0 * np.sin(a)), 2.6 if i % 2 == 0 else 0.4 * 2.6) for i, a in enumerate(angles)]
    return tuple(Lamp(place, (red, green, blue)) for place in places)


@dataclass(frozen=True)
class PhotoSettings:
    """How a picture is taken. Light is linear until the last step, which is sRGB's curve; colours are red, green, blue.

    lamps          that light the cloth; cloth does not shade itself
    ambient        (3,) light from everywhere
    exposure       factor on all light
    white_balance  (3,) the camera's factors on its channels
    bleeding       m, standard deviation of the soft edge of a printed circle
    gain           m, by which ink spreads beyond a circle's radius
    black          reflectance of the dark cloth; print on it never covers it fully: `opacity` is what a colour keeps
    blur           px, standard deviation of the lens' blur
    vignetting     share of the light that the image's corners lack
    noise          standard deviation of a pixel in the finished image, as a share of its highest value; 0.1 is a ratio of 20 dB
    shutter        s, open time; the picture is the mean of `moments` moments in it
    jpeg           quality 1 to 100, or 0 for none
    samples        per pixel and axis
    clutter        coloured rectangles in the background
    """

    lamps: tuple[Lamp, ...] = field(default_factory=ring_of_lamps)
    ambient: tuple[float, float, float] = (0.25, 0.25, 0.25)
    exposure: float = 1.0
    white_balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    bleeding: float = 0.0003
    gain: float = 0.0
    black: float = 0.02
    opacity: float = 0.9
    blur: float = 0.5
    vignetting: float = 0.15
    noise: float = 0.01
    shutter: float = 0.0
    moments: int = 1
    jpeg: int = 0
    samples: int = 3
    clutter: int = 12

    def check(self) -> None:
        """Raise AsterismError where a number is out of range."""
        for name in ("exposure", "bleeding", "gain", "black", "opacity", "blur", "vignetting", "noise", "shutter", "clutter"):
            if not 0 <= getattr(self, name) < np.inf:
                raise AsterismError(f"{name} is {getattr(self, name)}; it must be at least 0.")
        if not 1 <= self.samples <= 8 or self.moments < 1 or not 0 <= self.jpeg <= 100:
            raise AsterismError("a photo has 1 to 8 samples per pixel and axis, at least one moment, and a JPEG quality of 0 to 100.")


@dataclass(frozen=True)
class CircleTruth:
    """What is true of the circles of a garment in one image; all but `ids` are NaN where the circle is not there or behind the camera.

    ids        (n,) int32 identities, -1 for circles at a border, whose block is incomplete
    cells      (n, 2) row and column on the sheet
    positions  (n, 3) m, the middle in space
    centres    (n, 2) px, the image of the middle
    diameters  (n, 2) px, longer and shorter diameter of the ellipse
    tilt       (n,) rad, between the cloth's normal and the direction to the camera; above pi / 2 it faces away
    visible    (n,) share of the circle that is in the image and in front of everything else, 0 to 1
    """

    ids: NDArray[np.int32]
    cells: NDArray[np.int64]
    positions: Floats
    centres: Floats
    diameters: Floats
    tilt: Floats
    visible: Floats

    def readable(self, diameter: float = 6.0, tilt: float = np.radians(60.0), visible: float = 0.9) -> NDArray[np.bool_]:
        """(n,) circles whose longer diameter is at least so many px, seen within so many rad, and by this share.

        The shorter diameter is then at least `diameter` cos(tilt).
        """
        return np.asarray((self.diameters[:, 0] >= diameter) & (self.tilt <= tilt) & (self.visible >= visible))


@dataclass(frozen=True)
class Photo:
    """A picture (h, w, 3) uint8, blue, green, red as OpenCV has it, and the truth."""

    image: Image
    truth: CircleTruth


def photograph(
    worn: GarmentScene, camera: Camera, time: float = 0.0, settings: PhotoSettings | None = None, *, rng: np.random.Generator
) -> Photo:
    """Take a picture of a dressed wearer, or of a waved sheet.

    time  s; the truth is that of the middle of the shutter's open time, which ends half of it later
    rng   the noise, and the room's background

    The same arguments and generator give the same picture. Cost: O(triangles + samples) a moment, 0.3 s for a whole body in 1280 x 960
    pixels with 3 x 3 samples each; memory 12 bytes a sample. Raises AsterismError where the camera has no image size.
    """
    settings = settings or PhotoSettings()
    settings.check()
    if camera.size is None:
        raise AsterismError(f"camera {camera.name}: its image size is not known; give it one.")
    width, height = camera.size
    offsets = settings.shutter * ((np.arange(settings.moments) + 0.5) / settings.moments - 0.5)
    light = np.zeros((height, width, 4))
    seen = np.zeros(worn.pattern.shape, dtype=np.int64)
    # Motion blur: the mean of pictures during the shutter's time.
    for offset in offsets:
        _expose(worn, worn.mesh(time + float(offset)), camera, settings, light, seen)
    light /= settings.moments
    room = _room(width, height, settings.clutter, rng)
    # What no triangle covers shows the room.
    picture = light[..., :3] + (1.0 - light[..., 3:]) * room * np.asarray(settings.ambient) * 2.0
    image = _developed(picture, settings, rng)
    return Photo(image, _truth(worn, camera, time, seen / (settings.moments * settings.samples**2)))


def ink_colours(hsv: Floats, settings: PhotoSettings) -> Floats:
    """(q + 2, 3) linear reflectances of the inks on dark cloth, the cloth and skin."""
    bright = np.array([colorsys.hsv_to_rgb(*colour) for colour in hsv])
    # Print on dark cloth is not opaque.
    inks = settings.black + settings.opacity * (_linear(bright) - settings.black).clip(0.0)
    return np.concatenate([inks, np.full((1, 3), settings.black), np.array([[0.45, 0.27, 0.20]])])


def _expose(worn: GarmentScene, mesh: Mesh, camera: Camera, settings: PhotoSettings, light: Floats, seen: NDArray[Any]) -> None:
    """Add the light of one moment to an image (h, w, 4), and the samples of each circle to `seen`."""
    height, width = light.shape[:2]
    xy = camera.project(mesh.vertices)
    depth = mesh.vertices @ camera.rotation[2] + camera.translation[2]
    there = np.isfinite(xy[:, 0]) & (depth > _LEAST_DEPTH)
    triangles, piece = mesh.triangles, mesh.piece
    # Triangles that reach into the image; behind the camera nothing projects.
    kept = there[triangles].all(axis=1)
    corners = xy[triangles]
    with np.errstate(invalid="ignore"):
        kept &= (corners.min(axis=1) < (width - 0.5, height - 0.5)).all(axis=1) & (corners.max(axis=1) > -0.5).all(axis=1)
    triangles, piece, corners = np.ascontiguousarray(triangles[kept]), piece[kept], corners[kept]
    if not len(triangles):
        return
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    turn = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    # A window around the wearer: most samples of an image see none.
    low = np.clip(np.floor(corners.min(axis=(0, 1)) + 0.5), 0, (width, height)).astype(np.int64)
    high = np.clip(np.ceil(corners.max(axis=(0, 1)) + 0.5), 0, (width, height)).astype(np.int64)
    samples = settings.samples
    corner = low * samples
    span = (high - low) * samples
    front = np.zeros((span[1], span[0]), dtype=np.float32)
    # The nearest triangle of each sample first, its colour afterwards: each sample is shaded once.
    owner = np.full((span[1], span[0]), -1, dtype=np.int32)
    nearness = np.where(there, 1.0 / np.where(there, depth, 1.0), 0.0)
    kernels.rasterise(xy, nearness, triangles, samples, corner, front, owner)
    pattern = worn.pattern
    cells = np.array([(p.row, p.row + p.rows - 1, p.column, p.column + p.columns - 1) for p in pattern.pieces], dtype=np.int64)
    radius = (0.5 * pattern.diameter + settings.gain) / pattern.pitch
    rules = np.array([radius, max(settings.bleeding, 1e-6) / pattern.pitch, 1.0 / samples**2])
    falls = _light(mesh, settings)
    kernels.shade(
        xy, nearness, triangles, mesh.sheet, falls, piece, turn < 0, cells, pattern.colours, ink_colours(pattern.hsv, settings), rules,
        samples, corner, owner, light, seen,
    )  # fmt: skip


def _light(mesh: Mesh, settings: PhotoSettings) -> Floats:
    """(v, 3) light on each vertex: ambient, and of each lamp by distance and angle."""
    light = np.tile(np.asarray(settings.ambient, dtype=np.float64), (len(mesh.vertices), 1))
    for lamp in settings.lamps:
        towards = np.asarray(lamp.position) - mesh.vertices
        # Light falls with the square of the distance; below 10 cm it grows no more.
        square = np.maximum(np.einsum("vi,vi->v", towards, towards), 0.01)
        cosine = np.clip(np.einsum("vi,vi->v", towards, mesh.normals) / np.sqrt(square), 0.0, None)
        light += (cosine / square)[:, None] * np.asarray(lamp.colour)
    return light


def _room(width: int, height: int, clutter: int, rng: np.random.Generator) -> Floats:
    """(h, w, 3) reflectance of what is behind the wearer: a wall, a floor and things on it."""
    wall = np.linspace(0.28, 0.18, height)[:, None, None] * np.array([1.0, 0.98, 0.95])
    room = np.repeat(wall, width, axis=1)
    room[int(0.82 * height) :] *= 0.7
    for _ in range(clutter):
        x, y = rng.integers(0, width), rng.integers(0, height)
        w, h = rng.integers(width // 40 + 1, width // 6 + 2), rng.integers(height // 40 + 1, height // 5 + 2)
        room[y : y + h, x : x + w] = rng.uniform(0.03, 0.5, 3)
    return room


def _developed(light: Floats, settings: PhotoSettings, rng: np.random.Generator) -> Image:
    """The light of a picture (h, w, 3) as the camera delivers it, blue, green, red."""
    import cv2

    picture = (light * settings.exposure * np.asarray(settings.white_balance)).astype(np.float32)
    # Lens and sensor spread the light before the curve, and the noise comes after it.
    if settings.blur > 0:
        picture = cv2.GaussianBlur(picture, (0, 0), settings.blur, borderType=cv2.BORDER_REPLICATE)
    height, width = picture.shape[:2]
    if settings.vignetting > 0:
        x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
        picture *= (1.0 - settings.vignetting * 0.5 * (x**2 + y**2))[..., None].astype(np.float32)
    # The sRGB curve, as cameras deliver their pictures.
    curve = np.clip(picture, 0.0, 1.0)
    shown = np.where(curve <= 0.0031308, 12.92 * curve, 1.055 * np.power(curve, 1 / 2.4, dtype=np.float32) - 0.055)
    shown = shown + settings.noise * rng.standard_normal(shown.shape, dtype=np.float32)
    image = np.clip(np.rint(255 * shown[..., ::-1]), 0, 255).astype(np.uint8)
    # Through a real JPEG: its blocks are what a reader meets.
    if settings.jpeg:
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg])[1], cv2.IMREAD_COLOR)
    return np.ascontiguousarray(image)


def _linear(shown: Floats) -> Floats:
    """sRGB values 0 to 1 as linear light."""
    return np.where(shown <= 0.04045, shown / 12.92, ((shown + 0.055) / 1.055) ** 2.4)


def _truth(worn: GarmentScene, camera: Camera, time: float, seen: Floats) -> CircleTruth:
    """The truth of each circle; seen: (rows, cols) px2 that it covers in the image."""
    cells = np.argwhere(worn.pattern.colours >= 0)
    at = (cells[:, 0], cells[:, 1])
    middle = worn.circles(time)
    positions = middle[at]
    down, right = _tangents(middle, worn.pattern.pitch)
    down, right = down[at], right[at]
    normal = np.cross(down, right)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards = camera.position - positions
    with np.errstate(invalid="ignore"):
        tilt = np.arccos(np.clip(np.einsum("ni,ni->n", normal, towards) / np.linalg.norm(towards, axis=1), -1.0, 1.0))
    centres = camera.project(positions)
    # The ellipse of a small circle is the projection's derivative, by differences.
    moved = [camera.project(positions + sign * _STEP * axis) for axis in (down, right) for sign in (1, -1)]
    jacobian = np.stack([moved[0] - moved[1], moved[2] - moved[3]], axis=2) / (2 * _STEP)
    finite = np.isfinite(jacobian).all(axis=(1, 2))
    diameters = np.full((len(cells), 2), np.nan)
    diameters[finite] = worn.pattern.diameter * np.linalg.svd(jacobian[finite], compute_uv=False)
    # Visible is what was sampled over what the ellipse covers.
    area = 0.25 * np.pi * diameters.prod(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        visible = np.where(tilt < 0.5 * np.pi, np.clip(seen[at] / area, 0.0, 1.0), 0.0)
    return CircleTruth(worn.pattern.ids[at], cells, positions, centres, diameters, tilt, np.where(np.isfinite(visible), visible, 0.0))


def _tangents(middle: Floats, pitch: float) -> tuple[Floats, Floats]:
    """Down and right along the cloth at each circle (rows, cols, 3), per metre of flat cloth, from its neighbours; else NaN."""
    out = []
    for axis in (0, 1):
        ahead, behind = np.full_like(middle, np.nan), np.full_like(middle, np.nan)
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(0, -1), slice(1, None)
        step = (middle[tuple(high)] - middle[tuple(low)]) / pitch
        ahead[tuple(low)], behind[tuple(high)] = step, step
        # Both neighbours where they are there, else the one that is.
        both = 0.5 * (ahead + behind)
        out.append(np.where(np.isfinite(both), both, np.where(np.isfinite(ahead), ahead, behind)))
    return out[0], out[1]
