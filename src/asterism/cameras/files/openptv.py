"""OpenPTV's orientation files .ori and .addpar, with parameters/ptv.par for pixels and the window, in and out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import OPENCV_FROM_UPRIGHT, image_size, numbers, rig_of, rotation_of, within
from asterism.cameras.files._lens import TOLERABLE_PX, corner_radius, lens_lost
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import decoded, read_bytes
from asterism.geometry import rotation_from_vector
from asterism.recording import Floats
from asterism.recording.display import significant

_GRID = (17, 13, 5)
_PIXEL_MM = 0.01
_WORST_FIT_PX = 3.0


@dataclass(frozen=True)
class Setup:
    """What ptv.par and criteria.par say: image size (px), pixel size (mm), the window, the measuring volume's depth.

    indices    refractive indices of air, window, medium
    thickness  of the window, mm
    depth      (z_min, z_max) mm of the measuring volume, None where it is not known
    """

    size: tuple[int, int]
    pixel: tuple[float, float]
    indices: tuple[float, float, float] = (1.0, 1.0, 1.0)
    thickness: float = 0.0
    depth: tuple[float, float] | None = None

    @property
    def refracts(self) -> bool:
        """Whether light bends on its way."""
        return len(set(self.indices)) > 1


@dataclass(frozen=True)
class Orientation:
    """One camera as OpenPTV has it, in mm: axes right, up, backwards.

    axes      (3, 3) world from camera; place (3,) of its centre; window (3,) from the origin to the window's inner face
    inner     (xh, yh, cc): offset of the principal point and its distance
    lens      (k1, k2, k3, p1, p2, scale of x, shear), Brown's, on the sensor around its middle
    """

    axes: Floats
    place: Floats
    window: Floats
    inner: Floats
    lens: Floats


def read_openptv(paths: Sequence[Path]) -> Rig:
    """The cameras of .ori files as one rig, each with its .addpar (else an ideal lens) and the parameters folder's ptv.par.

    Directions follow OpenPTV's own geometry: x to the right, y up on the sensor, the rows of the .ori's matrix are the world's axes. Pixels
    are ours, half a pixel less than in OpenPTV's own target files. Where a window and a medium bend the light, or the lens is not centred
    on the principal point, an equivalent camera without either is fitted over the image and the depth of the measuring volume
    (criteria.par; else 0.2 of the distance around where each ray passes the origin): the metadata has the residuals (`fit_px`, RMS and
    largest). It is right behind the window only.
    Raises AsterismError where ptv.par is missing or a file is damaged.
    """
    setup = _setup(paths[0])
    cameras, fits = [], {}
    for path in paths:
        orientation = _orientation(path)
        name = path.name.removesuffix(".ori").split(".")[0]
        fitted, left = _as_camera(path, name, orientation, setup)
        cameras.append(fitted)
        if left is not None:
            fits[name] = left
    lacks = ["its window and medium: each camera is an equivalent one without them, see fit_px"] if setup.refracts else []
    lacks += ["the depth of the measuring volume (criteria.par)"] if setup.depth is None and fits else []
    metadata = {
        "files": [str(path) for path in paths],
        "fit_px": {name: {"rms": left[0], "largest": left[1]} for name, left in fits.items()},
    }
    return rig_of(paths[0].parent, "OpenPTV", cameras, metadata, lacks, equivalent=bool(fits))


def _setup(path: Path) -> Setup:
    # OpenPTV's projects have .ori files beside the folder of parameters or in a folder of their own.
    folders = [path.parent / "parameters", path.parent.parent / "parameters", path.parent]
    folder = next((folder for folder in folders if (folder / "ptv.par").is_file()), None)
    if folder is None:
        raise AsterismError(f"{path} needs parameters/ptv.par beside it: without it the image and pixel size are not known; copy it there.")
    words = _words(folder / "ptv.par")
    count = int(words[0]) if words and words[0].isdigit() else 0
    tail = numbers(f"{folder / 'ptv.par'}", "numbers after the file names", words[1 + 2 * count :])
    if count < 1 or len(tail) < 7:
        raise AsterismError(f"{folder / 'ptv.par'} is damaged: it breaks off before the pixel size; copy it again.")
    # A file that ends with the pixel's size knows of no tank: nothing but air.
    glass = tail[8:12] if len(tail) >= 12 else np.array([1.0, 1.0, 1.0, 0.0])
    if min(*tail[5:7], *glass[:3]) <= 0 or glass[3] < 0:
        raise AsterismError(f"{folder / 'ptv.par'} is damaged: its pixels, indices or window are not positive; copy it again.")
    depth = None
    if (folder / "criteria.par").is_file():
        limits = numbers(f"{folder / 'criteria.par'}", "limits", _words(folder / "criteria.par"))
        if len(limits) >= 6:
            depth = (float(min(limits[1], limits[4])), float(max(limits[2], limits[5])))
    return Setup(
        image_size(str(folder / "ptv.par"), tail[3:5]),
        (float(tail[5]), float(tail[6])),
        (float(glass[0]), float(glass[1]), float(glass[2])),
        float(glass[3]),
        depth,
    )


def _orientation(path: Path) -> Orientation:
    values = numbers(str(path), "orientation", _words(path))
    if len(values) not in (18, 21):
        raise AsterismError(f"{path} is damaged: it has {len(values)} numbers, an orientation has 18 or 21; copy it again.")
    axes = rotation_of(str(path), values[6:15])
    if values[17] <= 0:
        raise AsterismError(f"{path} is damaged: the distance of its principal point is not positive; copy it again.")
    lens = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    beside = path.with_name(path.name.removesuffix(".ori") + ".addpar")
    if beside.is_file():
        lens = numbers(str(beside), "lens", _words(beside), 7)
    window = values[18:21] if len(values) == 21 else np.zeros(3)
    return Orientation(axes, values[:3], window, values[15:18], lens)


def _middle(size: tuple[int, int]) -> Floats:
    """The middle of the sensor (2,) px: OpenPTV counts pixels from the corner of the first one, we from its centre."""
    return (np.array(size) - 1) / 2


def _words(path: Path) -> list[str]:
    return decoded(path, read_bytes(path)).split()


def _on_sensor(orientation: Orientation, flat: Floats) -> Floats:
    """Points x, y (n, 2) of the ideal sensor, mm, as the lens puts them: Brown's terms, then scale and shear."""
    k1, k2, k3, p1, p2, scale, shear = orientation.lens
    x, y = flat[:, 0] + orientation.inner[0], flat[:, 1] + orientation.inner[1]
    square = x * x + y * y
    factor = 1.0 + square * (k1 + square * (k2 + square * k3))
    # Brown's terms in OpenPTV's order, whose p1 and p2 are OpenCV's p2 and p1.
    u = x * factor + p1 * (square + 2 * x * x) + 2 * p2 * x * y
    v = y * factor + p2 * (square + 2 * y * y) + 2 * p1 * x * y
    return np.stack([scale * u - np.sin(shear) * v, np.cos(shear) * v], axis=1)


def _off_sensor(orientation: Orientation, seen: Floats) -> Floats:
    """The inverse of `_on_sensor`, by fixed-point steps."""
    flat = seen - orientation.inner[:2]
    with np.errstate(over="ignore", invalid="ignore"):
        # Distortion is mild, so each step gains a digit or more; a lens that folds over gives NaN, which the fit then refuses.
        for _ in range(100):
            flat = flat + (seen - _on_sensor(orientation, flat))
    return flat


def _as_camera(path: Path, name: str, orientation: Orientation, setup: Setup) -> tuple[Camera, tuple[float, float] | None]:
    """The camera, exactly where the model allows, else the equivalent one and its residuals (RMS, largest; px)."""
    k1, k2, k3, p1, p2, scale, shear = orientation.lens
    cc = float(orientation.inner[2])
    turn = OPENCV_FROM_UPRIGHT @ orientation.axes.T
    focal = (cc * float(scale) / setup.pixel[0], cc * float(np.cos(shear)) / setup.pixel[1])
    middle = _middle(setup.size)
    camera = within(
        path,
        lambda: Camera(
            name,
            setup.size,
            focal,
            (float(middle[0] + orientation.inner[0] / setup.pixel[0]), float(middle[1] - orientation.inner[1] / setup.pixel[1])),
            turn,
            -turn @ (1e-3 * orientation.place),
            (k1 * cc**2, k2 * cc**4, k3 * cc**6),
            (-p2 * cc, p1 * cc),
        ),
    )
    distorts = bool(np.any(orientation.lens[:5]))
    # Without these three the two lens models say the same in other units, and nothing need be fitted.
    if not setup.refracts and shear == 0 and not (distorts and np.any(orientation.inner[:2])):
        return camera, None
    pixels, points = _sample(path, orientation, setup)
    length = float(np.linalg.norm(orientation.window))
    normal = -orientation.window / length if setup.refracts else camera.rotation[2]
    fitted, left = _equivalent(camera, normal, pixels, points)
    if not left[0] < _WORST_FIT_PX:
        raise AsterismError(
            f"{path}: no camera without its lens and window comes nearer to it than {significant(left[0], 2)} px; is its .addpar right?"
        )
    return fitted, left


def _sample(path: Path, orientation: Orientation, setup: Setup) -> tuple[Floats, Floats]:
    """Pixels all over the image (n, 2), and the points (n, 3) m in the measuring volume that they see."""
    columns, rows, layers = _GRID
    grid = np.stack(np.meshgrid(np.linspace(0, setup.size[0], columns), np.linspace(0, setup.size[1], rows)), axis=-1).reshape(-1, 2)
    sensor = (grid - _middle(setup.size)) * np.array([setup.pixel[0], -setup.pixel[1]])
    flat = _off_sensor(orientation, sensor)
    rays = np.concatenate([flat, np.full((len(flat), 1), -orientation.inner[2])], axis=1) @ orientation.axes.T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    starts = np.broadcast_to(orientation.place, rays.shape)
    if setup.refracts:
        starts, rays = _through_window(path, orientation, setup, starts, rays)
    # Behind a window an equivalent camera is right at some depths only, so it is fitted where the measuring volume is.
    if setup.depth is not None and setup.refracts:
        points = [starts + rays * ((z - starts[:, 2]) / rays[:, 2])[:, None] for z in np.linspace(*setup.depth, layers)]
    else:
        near = -(starts * rays).sum(axis=1, keepdims=True)
        points = [starts + rays * np.maximum(near * part, 1.0) for part in np.linspace(0.8, 1.2, layers)]
    return np.tile(grid, (layers, 1)), 1e-3 * np.concatenate(points)


def _through_window(path: Path, orientation: Orientation, setup: Setup, starts: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Where the rays leave the window's inner face, and their directions behind it: Snell's law at both faces."""
    distance = float(np.linalg.norm(orientation.window))
    if not distance > 0:
        raise AsterismError(f"{path} has no window but ptv.par names a medium; add the window's vector (three numbers) at its end.")
    normal = orientation.window / distance
    if not starts[0] @ normal > distance + setup.thickness:
        raise AsterismError(f"{path}: the camera stands inside the tank, behind its window; mend the window's vector in the last line.")
    for face, (before, behind) in zip(
        (distance + setup.thickness, distance), zip(setup.indices[:2], setup.indices[1:], strict=True), strict=True
    ):
        along = rays @ normal
        starts = starts + rays * ((face - starts @ normal) / along)[:, None]
        # Snell's law in vectors: the part along the face shrinks with the index, the rest follows from length one.
        sideways = (before / behind) * (rays - along[:, None] * normal)
        rays = sideways - normal * np.sqrt(1.0 - (sideways**2).sum(axis=1))[:, None]
    return starts, rays


def _equivalent(start: Camera, normal: Floats, pixels: Floats, points: Floats) -> tuple[Camera, tuple[float, float]]:
    """The camera of ours, pose and lens with five coefficients, that sees the points nearest to the pixels; residuals RMS and largest, px.

    A window's distortion is round about its normal (3,), which points away from the camera: the search starts from the camera as it is and
    from one turned so that the window is round about its principal point. Where the normal is the camera's own axis, its pose is kept.
    """
    from scipy.optimize import least_squares

    size = 9 if np.array_equal(normal, start.rotation[2]) else 15
    axis = start.rotation @ normal
    sine = np.cross(axis, [0.0, 0.0, 1.0])
    aside = float(np.arcsin(min(1.0, float(np.linalg.norm(sine)))))
    turn = rotation_from_vector(-sine / max(float(np.linalg.norm(sine)), 1e-12) * aside)
    was = turn[:, 2]
    centre = np.array(start.centre) - np.array(start.focal) * was[:2] / was[2]
    turned = replace(
        start, rotation=turn @ start.rotation, translation=turn @ start.translation, centre=(float(centre[0]), float(centre[1]))
    )
    # Coefficients are searched for in units of what they do at the image's corner, so that all are about one.
    wide = float(np.tan(aside)) + corner_radius(start.size or (0, 0), (0, 0)) / start.focal[0]
    far = float(np.linalg.norm(start.position))

    def camera(q: Floats, base: Camera) -> Camera:
        p = np.concatenate([q, np.zeros(15 - len(q))])
        k = np.array([*base.radial, 0.0, 0.0, 0.0])[:3] + p[4:7] / wide ** np.array([2, 4, 6])
        return replace(
            base,
            focal=(base.focal[0] * np.exp(p[0]), base.focal[1] * np.exp(p[1])),
            centre=(base.centre[0] + base.focal[0] * p[2], base.centre[1] + base.focal[0] * p[3]),
            radial=tuple(k.tolist()),
            tangential=(base.tangential[0] + p[7] / wide, base.tangential[1] + p[8] / wide),
            rotation=rotation_from_vector(p[9:12]) @ base.rotation,
            translation=rotation_from_vector(p[9:12]) @ base.translation + far * p[12:15],
        )

    def missed(p: Floats, base: Camera) -> Floats:
        wrong = camera(p, base).project(points) - pixels
        # Where the trial lens has no image, a large but finite miss keeps the search going.
        return np.where(np.isfinite(wrong), wrong, 1e3).ravel()

    best, lefts = start, np.array([np.inf])
    # The problem has a valley for each of the two; the deeper one is taken.
    for base in (turned, start):
        found = least_squares(missed, np.zeros(size), method="lm", x_scale="jac", max_nfev=1500, args=(base,)).x
        left = np.linalg.norm(missed(found, base).reshape(-1, 2), axis=1)
        if (left**2).mean() < (lefts**2).mean():
            best, lefts = camera(found, base), left
    return best, (float(np.sqrt((lefts**2).mean())), float(lefts.max()))


def write_openptv(path: Path, rig: Rig) -> list[str]:
    """Write name.CAMERA.ori and .addpar for each camera, and parameters/ptv.par beside them; without window and medium.

    `path` is name.ori. Where the lens is not centred on the image, OpenPTV's is fitted, and what it misses is said. Returns what is lost.
    Raises AsterismError for cameras without pose or size, of different sizes, or with a lens that is missed by more than 0.1 px.
    """
    sizes = {camera.size for camera in rig}
    if len(sizes) != 1 or None in sizes or not all(camera.posed for camera in rig):
        raise AsterismError(f"{path}: this format needs cameras of one image size, each with its pose; write .toml instead.")
    lefts: dict[str, float] = {}
    files: list[tuple[Path, str]] = []
    names = []
    for camera in rig:
        orientation, left = _as_orientation(camera)
        if left > TOLERABLE_PX:
            raise AsterismError(
                f"{path}: camera {camera.name} has a lens that OpenPTV's misses by {significant(left, 2)} px; write .toml instead."
            )
        lefts[camera.name] = left
        if Path(camera.name).name != camera.name:
            raise AsterismError(f"{path}: camera {camera.name!r} cannot be part of a file's name; rename it, or write .toml instead.")
        stem = f"{path.name.removesuffix('.ori')}_{camera.name}" if len(rig) > 1 else path.name.removesuffix(".ori")
        names.append(stem)
        files.append((path.with_name(f"{stem}.ori"), _ori_text(orientation)))
        files.append((path.with_name(f"{stem}.addpar"), " ".join(repr(float(v)) for v in orientation.lens) + "\n"))
    width, height = rig.cameras[0].size or (0, 0)
    listed = [line for name in names for line in (f"img/{name}", f"cal/{name}")]
    setup = [str(len(rig)), *listed, "1", "0", "1", str(width), str(height), str(_PIXEL_MM), str(_PIXEL_MM), "0", "1", "1", "1", "0"]
    folder = path.parent / "parameters"
    existing = [place for place, _ in files if place.exists() and place != path]
    # Several files make one rig: none is written unless all can be.
    if (folder / "ptv.par").exists() or existing:
        taken = folder / "ptv.par" if (folder / "ptv.par").exists() else existing[0]
        raise AsterismError(f"{taken} exists and would be replaced; write to another folder.")
    folder.mkdir(exist_ok=True)
    for place, text in files:
        write_atomically(place, utf8(text))
    write_atomically(folder / "ptv.par", utf8("\n".join(setup) + "\n"))
    lost = [*lens_lost(lefts), *(["the vertical"] if rig.vertical is not None else [])]
    return lost + (["the reprojection errors"] if any(camera.error == camera.error for camera in rig) else [])


def _as_orientation(camera: Camera) -> tuple[Orientation, float]:
    """OpenPTV's form of a camera, and the largest error of its lens in the image, px."""
    from scipy.optimize import least_squares

    width, height = camera.size or (0, 0)
    cc = camera.focal[1] * _PIXEL_MM
    grid = np.stack(np.meshgrid(np.linspace(0, width, 17), np.linspace(0, height, 13)), axis=-1).reshape(-1, 2)
    flat = camera.undistort(grid)
    there = np.isfinite(flat[:, 0])
    middle = _middle((width, height))
    seen = ((grid - middle) * [_PIXEL_MM, -_PIXEL_MM])[there]
    k = (*camera.radial, 0.0, 0.0, 0.0)
    offset = (camera.centre - middle) * [_PIXEL_MM, -_PIXEL_MM]
    scale = camera.focal[0] / camera.focal[1]
    start = np.array([offset[0] / scale, offset[1], cc, k[0], k[1], k[2], camera.tangential[1], -camera.tangential[0], scale])
    powers = np.array([1.0, 1.0, 1.0, cc**2, cc**4, cc**6, cc, cc, 1.0])

    def orientation(p: Floats) -> Orientation:
        v = p / powers
        axes = (OPENCV_FROM_UPRIGHT @ camera.rotation).T
        return Orientation(axes, 1000.0 * camera.position, np.zeros(3), v[:3], np.array([*v[3:9], 0.0]))

    def missed(p: Floats) -> Floats:
        ideal = flat[there] * [p[2], -p[2]]
        wrong: Floats = ((_on_sensor(orientation(p), ideal) - seen) / _PIXEL_MM).ravel()
        return wrong

    best = start if np.abs(missed(start)).max() < 1e-9 else least_squares(missed, start, method="lm", x_scale="jac", max_nfev=2000).x
    return orientation(best), float(np.abs(missed(best)).max())


def _ori_text(orientation: Orientation) -> str:
    axes = orientation.axes
    # The file holds the rotation twice, as angles and as a matrix: both say the same.
    omega, phi = np.arctan2(-axes[1, 2], axes[2, 2]), np.arcsin(np.clip(axes[0, 2], -1, 1))
    kappa = np.arctan2(-axes[0, 1], axes[0, 0])
    rows = [orientation.place, (omega, phi, kappa), (), *axes, (), orientation.inner[:2], orientation.inner[2:], (), (0.0, 0.0, 1.0)]
    return "\n".join(" ".join(repr(float(value)) for value in row) for row in rows) + "\n"
