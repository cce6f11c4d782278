"""Vicon's calibration files .xcp (Nexus, Blade, Shogun): XML in pixels and millimetres, in and out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import attribute, image_size, numbers, rig_of, within, xml_root
from asterism.cameras.files._lens import POLYNOMIALS, RATIONALS, TOLERABLE_PX, Radial, corner_radius, fitted_radial, lens_lost
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.recording import Floats
from asterism.recording.display import significant

_RADII = 400
_LEAST_SLOPE = 0.6
_MODEL = "Vicon3Parameter"


def read_vicon(path: Path) -> Rig:
    """A rig from an .xcp file: where each camera stood in its first key frame.

    ORIENTATION is the quaternion x, y, z, w of the rotation camera from world in OpenCV's axes, POSITION where the camera stands (mm):
    in the sample files the cameras then see each other just where their masks are (tests/test_rig_files.py). VICON_RADIAL and
    VICON_RADIAL2 give the ideal image from the distorted one, radius (1 + k1 r2 + k2 r4 + k3 r6) in pixels; ours runs the other
    way, so radial coefficients are fitted until less than 0.001 px is left, at most 8 above and 3 below: the metadata has what is left of
    each camera (`lens_fit_px`). IMAGE_ERROR is `Camera.error`; WORLD_ERROR (mm) goes to the metadata.
    Cameras without a key frame are left out and named. Raises AsterismError where the file is damaged.
    """
    root = xml_root(path, "Cameras")
    elements = list(root.iterfind("Camera"))
    users = [element.get("USERID", "") for element in elements]
    # Operators know a camera by its user number; only where these are missing or doubled does the device's stand for it.
    by_user = len(set(users)) == len(users) and all(users)
    cameras, uncalibrated, moved, oblong, bent = [], [], [], [], []
    fits: dict[str, float] = {}
    world: dict[str, float] = {}
    for i, element in enumerate(elements):
        name = element.get("NAME") or (users[i] if by_user else element.get("DEVICEID") or str(i + 1))
        frames = element.findall("KeyFrames/KeyFrame")
        if not frames:
            uncalibrated.append(name)
            continue
        camera, fits[name], reach = _camera(path, name, element, frames[0])
        cameras.append(camera)
        if reach < 1.0:
            bent.append(f"{name} (beyond {100 * reach:.0f} % of the way)")
        if frames[0].get("WORLD_ERROR"):
            world[name] = float(numbers(f"{path}, camera {name}", "WORLD_ERROR", frames[0].get("WORLD_ERROR"), 1)[0])
        if len(frames) > 1:
            moved.append(name)
        if camera.focal[0] != camera.focal[1]:
            oblong.append(name)
    if not cameras:
        raise AsterismError(f"{path} has no calibrated camera; calibrate in Nexus and save it again.")
    metadata: dict[str, Any] = {"lens_fit_px": fits}
    metadata |= {"world_errors_mm": world} if world else {}
    metadata |= {"source": root.get("SOURCE")} if root.get("SOURCE") else {}
    lacks = [f"a calibration of {', '.join(uncalibrated)}"] if uncalibrated else []
    lacks += [f"one pose of {', '.join(moved)}: there are several key frames, the first was taken"] if moved else []
    lacks += [f"square pixels of {', '.join(oblong)}: the aspect ratio was taken as focal length x over y"] if oblong else []
    lacks += [f"a lens towards the corners of the image of {', '.join(bent)}, where its own bends over"] if bent else []
    return rig_of(path, "Vicon", cameras, metadata, lacks)


def _camera(path: Path, name: str, element: ET.Element, frame: ET.Element) -> tuple[Camera, float, float]:
    from scipy.spatial.transform import Rotation

    where = f"{path}, camera {name}"

    def of(key: str, count: int) -> Floats:
        return numbers(where, key, attribute(frame, key, where), count)

    size = image_size(where, attribute(element, "SENSOR_SIZE", where))
    focal, centre = float(of("FOCAL_LENGTH", 1)[0]), of("PRINCIPAL_POINT", 2)
    quaternion, place = of("ORIENTATION", 4), 1e-3 * of("POSITION", 3)
    if not np.linalg.norm(quaternion) > 0:
        raise AsterismError(f"{where}: its ORIENTATION is all zero; the file is damaged, export it again.")
    rotation = Rotation.from_quat(quaternion).as_matrix()
    corner = corner_radius(size, centre.tolist())
    (radial, denominator), left, reach = _turned(_inward(where, frame, centre, corner), focal, corner)
    aspect = float(numbers(where, "PIXEL_ASPECT_RATIO", element.get("PIXEL_ASPECT_RATIO", "1"), 1)[0])
    error = frame.get("IMAGE_ERROR")
    camera = within(
        path,
        lambda: Camera(
            name,
            size,
            (focal, focal / aspect),
            (float(centre[0]), float(centre[1])),
            rotation,
            -rotation @ place,
            radial,
            denominator=denominator,
            error=float("nan") if error is None else float(numbers(where, "IMAGE_ERROR", error, 1)[0]),
        ),
    )
    return camera, left, reach


def _inward(where: str, frame: ET.Element, centre: Floats, corner: float) -> Floats:
    """k1, k2, ... per px2, px4, ... of the map from the distorted to the ideal image, of which the corner is so many px from the centre.

    Raises AsterismError for another lens model, and for a lens about another centre than the principal point.
    """
    newer = frame.get("VICON_RADIAL2")
    if newer is None:
        return numbers(where, "VICON_RADIAL", frame.get("VICON_RADIAL", "0 0"))
    model, _, values = newer.partition(" ")
    if model != _MODEL:
        raise AsterismError(f"{where}: the lens model {model[:40]} is not understood, only {_MODEL}; export without it.")
    found = numbers(where, "VICON_RADIAL2", values, 5)
    # moving the centre moves a pixel by at most so many times as much
    #
    steepest = sum((2 * i + 3) * abs(k) * corner ** (2 * i + 2) for i, k in enumerate(found[2:]))
    if np.linalg.norm(found[:2] - centre) * steepest > TOLERABLE_PX:
        raise AsterismError(f"{where}: the centre of its lens is not its PRINCIPAL_POINT, which this camera model cannot have.")
    return found[2:]


def _turned(inward: Floats, focal: float, reach: float) -> tuple[Radial, float, float]:
    """Our radial coefficients for a lens given the other way round; the largest error left (px); and up to where it holds, of `reach` (px).

    It holds until the given map bends over (less than 0.6 px ideal per px distorted), which is past all points that it was fitted to.
    """
    distorted = np.linspace(reach / _RADII, reach, _RADII)
    ideal = distorted * (1.0 + sum(k * distorted ** (2 * i + 2) for i, k in enumerate(inward)))
    slope = 1.0 + sum((2 * i + 3) * k * distorted ** (2 * i + 2) for i, k in enumerate(inward))
    # Past this slope the given map comes to a fold, which no lens has: its makers fitted points further inside.
    bends = slope < _LEAST_SLOPE
    last = int(np.argmax(bends)) if bends.any() else _RADII
    radial, left = fitted_radial(ideal[:last] / focal, distorted[:last] / focal, focal, POLYNOMIALS + RATIONALS)
    return radial, left, last / _RADII


def write_vicon(path: Path, rig: Rig) -> list[str]:
    """Write an .xcp with VICON_RADIAL2, fitted the other way round; what that leaves is said where it is above 0.001 px.

    Returns what it does not carry. Raises AsterismError for cameras without pose or size, and for a lens that the three radial coefficients
    would miss by more than 0.1 px.
    """
    from scipy.spatial.transform import Rotation

    root = ET.Element("Cameras", {"SOURCE": "Asterism", "VERSION": "2.0"})
    lefts: dict[str, float] = {}
    # Names that are numbers go where user numbers stand, which the reader takes for names.
    users = {camera.name: camera.name for camera in rig if camera.name.isdigit()}
    for i, camera in enumerate(rig):
        if not camera.posed or camera.size is None:
            raise AsterismError(f"{path}: camera {camera.name} has no pose or image size and this format needs both; write .toml instead.")
        inward, left = _inward_of(camera)
        if left > TOLERABLE_PX:
            raise AsterismError(
                f"{path}: camera {camera.name} has a lens that Vicon's three coefficients miss by {significant(left, 2)} px; "
                "write .toml instead."
            )
        lefts[camera.name] = left
        own = {} if camera.name in users else {"NAME": camera.name}
        user = users.get(camera.name, str(i if not users else 1000 + i))
        one = ET.SubElement(
            root,
            "Camera",
            {
                **own,
                "DEVICEID": user,
                "USERID": user,
                "SENSOR_SIZE": f"{camera.size[0]} {camera.size[1]}",
                "PIXEL_ASPECT_RATIO": repr(camera.focal[0] / camera.focal[1]),
            },
        )
        frame = {
            "FRAME": "0",
            "FOCAL_LENGTH": repr(camera.focal[0]),
            "PRINCIPAL_POINT": _words(camera.centre),
            "ORIENTATION": _words(Rotation.from_matrix(camera.rotation).as_quat()),
            "POSITION": _words(1000.0 * camera.position),
            "VICON_RADIAL2": f"{_MODEL} {_words(camera.centre)} {_words(inward)}",
        }
        frame |= {"IMAGE_ERROR": repr(camera.error)} if camera.error == camera.error else {}
        ET.SubElement(ET.SubElement(one, "KeyFrames"), "KeyFrame", frame)
    ET.indent(root)
    write_atomically(path, b'<?xml version="1.0" encoding="UTF-8" standalone="no" ?>\n' + ET.tostring(root, encoding="utf-8") + b"\n")
    return [*(["the vertical"] if rig.vertical is not None else []), *lens_lost(lefts)]


def _inward_of(camera: Camera) -> tuple[Floats, float]:
    """k1, k2, k3 from the distorted to the ideal image (px), and how far the lens is missed in the image (px)."""
    width, height = camera.size or (0, 0)
    grid = np.stack(np.meshgrid(np.linspace(0, width, 33), np.linspace(0, height, 25)), axis=-1).reshape(-1, 2)
    flat = camera.undistort(grid)
    flat, grid = flat[np.isfinite(flat[:, 0])], grid[np.isfinite(flat[:, 0])]
    focal = np.array(camera.focal)
    seen, ideal = (grid - camera.centre) / focal, flat
    # Our lens leads from the ideal to the distorted image, theirs back: a fit over the image turns it round.
    square = (seen**2).sum(axis=1)
    scale = float(square.max(initial=1e-12))
    columns = np.stack([(seen * ((square / scale) ** (i + 1))[:, None]).ravel() for i in range(3)], axis=1)
    k = np.linalg.lstsq(columns, (ideal - seen).ravel(), rcond=None)[0]
    left = float(np.abs((columns @ k - (ideal - seen).ravel()).reshape(-1, 2) * focal).max(initial=0.0))
    return np.array([v / scale ** (i + 1) / camera.focal[0] ** (2 * i + 2) for i, v in enumerate(k)]), left


def _words(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
