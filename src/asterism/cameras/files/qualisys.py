"""Qualisys' calibration export .qca.txt: XML in sub-pixels and millimetres, in and out."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import OPENCV_FROM_UPRIGHT, attribute, image_size, numbers, rig_of, rotation_of, within, xml_root
from asterism.cameras.files._lens import POLYNOMIALS, lens_lost, with_shapes
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically

SUBPIXELS = 64.0
"""Per pixel: QTM's unit for focal lengths, centres and sensor limits."""


def read_qualisys(path: Path) -> Rig:
    """A rig from QTM's export.

    x, y, z is where a camera stands (mm); the rows of r are its axes in the world: right, up, backwards. Distortion coefficients are
    those of the normalized plane, OpenCV's (not sub-pixels, as some converters take them). Residuals are millimetres in
    the room: they go to the metadata, not to `Camera.error`. Inactive cameras are left out and named.
    Raises AsterismError where the file is damaged, or a camera has skew.
    """
    root = xml_root(path, "calibration")
    cameras: list[Camera] = []
    inactive, turned, cropped = [], [], []
    residuals: dict[str, float] = {}
    for element in root.iterfind("cameras/camera"):
        name = element.get("serial") or str(len(cameras) + 1)
        if element.get("active", "1") == "0" or element.get("calibrated", "true") == "false":
            inactive.append(name)
            continue
        cameras.append(within(path, lambda e=element, n=name: _camera(path, n, e)))
        residuals[name] = float(numbers(f"{path}, camera {name}", "avg-residual", element.get("avg-residual", "0"), 1)[0])
        # Marker images are the sensor's; videos may show a part of it, and their pixels are then others.
        if _is_cropped(element.find("fov_video"), cameras[-1]):
            cropped.append(name)
        if element.get("viewrotation", "0") != "0":
            turned.append(name)
    results = root.find("results")
    metadata = {"residuals_mm": residuals, "wand_length_std_mm": None if results is None else results.get("std-dev")}
    lacks = ["reprojection errors in pixels (its residuals are millimetres, see the metadata)"] if residuals else []
    lacks += [f"a calibration of {', '.join(inactive)}, which is not active"] if inactive else []
    lacks += [
        f"videos of the whole sensor of {', '.join(cropped)}: theirs are cropped or scaled (fov_video), pixels here are the sensor's"
    ] * bool(cropped)
    lacks += [f"upright images of {', '.join(turned)}: pixels are those of the sensor, whose view is turned"] if turned else []
    return rig_of(path, "Qualisys", cameras, metadata, lacks)


def _is_cropped(video: ET.Element | None, camera: Camera) -> bool:
    """Whether the pixels of a camera's videos are not those of its sensor."""
    width, height = camera.size or (0, 0)
    whole = {"left": 0, "top": 0, "right": width - 1, "bottom": height - 1}
    return video is not None and any(video.get(side, str(end)) != str(end) for side, end in whole.items())


def _camera(path: Path, name: str, element: ET.Element) -> Camera:
    where = f"{path}, camera {name}"
    lens, pose = element.find("intrinsic"), element.find("transform")

    def of_lens(key: str) -> float:
        return float(numbers(where, key, attribute(lens, key, where), 1)[0])

    def of_pose(key: str) -> float:
        return float(numbers(where, key, attribute(pose, key, where), 1)[0])

    if of_lens("skew") != 0:
        raise AsterismError(f"{where}: its sensor is skewed, which this camera model does not have.")
    # QTM's camera axes point right, up and backwards; OpenCV's right, down and ahead.
    turn = OPENCV_FROM_UPRIGHT @ rotation_of(where, [of_pose(f"r{i}{j}") for i in (1, 2, 3) for j in (1, 2, 3)])
    low, high = [of_lens("sensorMinU"), of_lens("sensorMinV")], [of_lens("sensorMaxU"), of_lens("sensorMaxV")]
    return Camera(
        name,
        image_size(where, np.floor((np.array(high) - low) / SUBPIXELS) + 1),
        (of_lens("focalLengthU") / SUBPIXELS, of_lens("focalLengthV") / SUBPIXELS),
        (of_lens("centerPointU") / SUBPIXELS, of_lens("centerPointV") / SUBPIXELS),
        turn,
        -turn @ (1e-3 * np.array([of_pose("x"), of_pose("y"), of_pose("z")])),
        tuple(of_lens(f"radialDistortion{i}") for i in (1, 2, 3)),
        (of_lens("tangentalDistortion1"), of_lens("tangentalDistortion2")),
    )


def write_qualisys(path: Path, rig: Rig) -> list[str]:
    """Write QTM's XML. Returns what it does not carry. Raises AsterismError for cameras without pose or size, or a lens it cannot carry."""
    root = ET.Element("calibration", {"type": "regular", "source": "Asterism"})
    cameras = ET.SubElement(root, "cameras")
    kept = rig.metadata.get("residuals_mm") or {}
    lefts: dict[str, float] = {}
    for given in rig:
        if not given.posed or given.size is None:
            raise AsterismError(f"{path}: camera {given.name} has no pose or image size and this format needs both; write .toml instead.")
        camera, lefts[given.name] = with_shapes(str(path), given, POLYNOMIALS[:2])
        width, height = given.size
        one = ET.SubElement(cameras, "camera", {"active": "1", "serial": camera.name, "viewrotation": "0"})
        if camera.name in kept:
            one.set("avg-residual", repr(kept[camera.name]))
        for field in ("fov_marker", "fov_marker_max", "fov_video", "fov_video_max"):
            ET.SubElement(one, field, {"left": "0", "top": "0", "right": str(width - 1), "bottom": str(height - 1)})
        axes, place = OPENCV_FROM_UPRIGHT @ camera.rotation, 1000.0 * camera.position
        pose = {key: repr(float(value)) for key, value in zip("xyz", place, strict=True)}
        pose |= {f"r{i + 1}{j + 1}": repr(float(axes[i, j])) for i in range(3) for j in range(3)}
        ET.SubElement(one, "transform", pose)
        k = (*camera.radial, 0.0, 0.0, 0.0)
        lens = {"focalLengthU": SUBPIXELS * camera.focal[0], "focalLengthV": SUBPIXELS * camera.focal[1]}
        lens |= {"centerPointU": SUBPIXELS * camera.centre[0], "centerPointV": SUBPIXELS * camera.centre[1]}
        lens |= {"sensorMinU": 0.0, "sensorMinV": 0.0, "sensorMaxU": SUBPIXELS * (width - 1), "sensorMaxV": SUBPIXELS * (height - 1)}
        lens |= {"skew": 0.0, "radialDistortion1": k[0], "radialDistortion2": k[1], "radialDistortion3": k[2]}
        lens |= {"tangentalDistortion1": camera.tangential[0], "tangentalDistortion2": camera.tangential[1]}
        ET.SubElement(one, "intrinsic", {key: repr(float(value)) for key, value in lens.items()})
    ET.indent(root)
    write_atomically(path, b"<?xml version='1.0' encoding='UTF-8'?>\n" + ET.tostring(root, encoding="utf-8") + b"\n")
    lost = [*(["the vertical"] if rig.vertical is not None else []), *lens_lost(lefts)]
    return lost + (["the reprojection errors in pixels"] if any(camera.error == camera.error for camera in rig) else [])
