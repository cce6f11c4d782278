"""Rigs of research data as JSON: Human3.6M (intrinsics and extrinsics by subject) and Shelf (fx, fy, cx, cy, R, T per camera)."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from asterism.cameras.camera import Camera
from asterism.cameras.files._common import numbers, rig_of, rotation_of, within
from asterism.cameras.rig import Rig
from asterism.errors import AsterismError
from asterism.files.text import decoded, read_bytes


def read_json(path: Path) -> Rig:
    """A rig from Human3.6M's or Shelf's JSON, both in millimetres.

    Human3.6M has a rig for each subject: the first is taken and `lacks` names the others; translations are camera from world.
    Shelf's T is where the camera stands. Raises AsterismError where the file is damaged or holds something else.
    """
    try:
        content = json.loads(decoded(path, read_bytes(path)))
    except (ValueError, RecursionError) as problem:
        raise AsterismError(f"{path} is damaged: it is no JSON ({problem}); fetch it again.") from problem
    if isinstance(content, dict) and {"intrinsics", "extrinsics"} <= set(content):
        return _human36m(path, content)
    if isinstance(content, dict) and content and all(isinstance(c, dict) and {"R", "T", "fx"} <= set(c) for c in content.values()):
        return rig_of(path, "Shelf JSON", [within(path, lambda n=n, c=c: _shelf(path, n, c)) for n, c in content.items()], {})
    raise AsterismError(f"{path} is JSON, but no rig of Human3.6M's or Shelf's kind; write it as TOML.")


def _human36m(path: Path, content: dict[str, Any]) -> Rig:
    intrinsics, subjects = content["intrinsics"], content["extrinsics"]
    if not isinstance(intrinsics, dict) or not isinstance(subjects, dict) or not subjects:
        raise AsterismError(f"{path} is damaged: its intrinsics or extrinsics are empty; fetch it again.")
    # The same cameras stood elsewhere for each subject, so one rig is one subject's.
    subject = next(iter(subjects))
    cameras = []
    if not isinstance(subjects[subject], dict) or not subjects[subject]:
        raise AsterismError(f"{path} is damaged: subject {subject} has no cameras; fetch it again.")
    for name, pose in subjects[subject].items():
        where, lens = f"{path}, camera {name}", intrinsics.get(name)
        if not isinstance(pose, dict) or not isinstance(lens, dict):
            raise AsterismError(f"{where}: it lacks its intrinsics or extrinsics; fetch the file again.")
        cameras.append(
            within(
                path,
                lambda name=name, where=where, lens=lens, pose=pose: Camera.from_opencv(
                    name,
                    numbers(where, "calibration_matrix", lens.get("calibration_matrix"), 9).reshape(3, 3),
                    numbers(where, "distortion", lens.get("distortion")),
                    rotation_of(where, pose.get("R")),
                    1e-3 * numbers(where, "t", pose.get("t"), 3),
                ),
            )
        )
    others = [key for key in subjects if key != subject]
    lacks = [f"which subject: {subject} was taken, {', '.join(others)} have rigs of their own"] if others else []
    return rig_of(path, "Human3.6M JSON", cameras, {"subject": subject}, lacks)


def _shelf(path: Path, name: str, camera: dict[str, Any]) -> Camera:
    where = f"{path}, camera {name}"
    radial, (p1, p2) = numbers(where, "k", camera.get("k", [0, 0, 0])), numbers(where, "p", camera.get("p", [0, 0]), 2)
    fx, fy, cx, cy = (float(numbers(where, key, camera.get(key), 1)[0]) for key in ("fx", "fy", "cx", "cy"))
    place = 1e-3 * numbers(where, "T", camera["T"], 3)
    turn = rotation_of(where, camera["R"])
    return Camera(name, None, (fx, fy), (cx, cy), turn, -turn @ place, tuple(radial), (float(p1), float(p2)))
