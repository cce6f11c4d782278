"""glTF 2.0 (.glb, .gltf): a skinned skeleton and its animation in, a skeleton's motion out, and back with a body of its own.

Khronos Group, glTF 2.0 Specification (2021): accessors 3.6, nodes 3.5, skins 3.7.3, animations 3.11; metres, y up, facing z: 3.4.
"""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import read_bytes
from asterism.findings import Finding
from asterism.formats._bones import SkeletonFile, fill_missing_bones, forward_of, turned_into, unlike, vertical_of
from asterism.formats._findings import bones_lost, header_doubt
from asterism.geometry import nearest_orthogonal
from asterism.recording import Floats, SkeletonMotion
from asterism.recording.bone_names import split_name

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942
_COMPONENTS: dict[int, Any] = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_FLOAT, _UINT, _USHORT = 5126, 5125, 5123
_MOST_FRAMES = 400_000
"""An hour at 100 Hz: with 50 bones 1.4 GB. A damaged time must not ask for more."""
_MOST_ZEROS = 1_000_000
"""Values of an accessor that has no bytes in the file: as many as keys of an animation may be."""
_SPARSE_KEYS = 30.0
"""Frames per second at which an animation is sampled whose keys do not lie evenly: that of most animation programs' timelines. At half of
it a foot strike falls between frames; at double files double."""

_BONE_WIDTH = 0.12
"""Of the length of the bone, as wide as its body is drawn, up to `_WIDEST`. At half of it limbs are lines, at double they touch."""
_WIDEST = 0.035
"""m"""
_END = "_end"
"""Behind the name of a bone, the name of a node at its end, which is no joint."""
_STUB = 0.03
"""m, as long as a bone without an end is drawn."""
_COLOURS = {"left": (0.80, 0.15, 0.13), "right": (0.11, 0.40, 0.75), "": (0.75, 0.75, 0.75)}
"""Of the bodies of the bones: left red, right blue, as on all pages."""


@dataclass
class _Scene:
    """A glTF document with its buffers. parents (N,): the node above each, -1 for none."""

    path: Path
    json: dict[str, Any]
    buffers: list[bytes]
    parents: list[int] = field(default_factory=list)


def read_gltf(path: Path, animation: str | int | None = None, vertical: Floats | None = None) -> SkeletonFile:
    """The skeleton of a glTF file and one of its animations, in metres, in the file's axes.

    animation  its name or number from 0; None: the first. Without any, the motion is one frame of the rest pose.

    The rest pose is that to which the skin is bound, else that of the nodes. Bones are the joints of all skins, or without a skin the
    nodes that an animation turns. Raises AsterismError where there are neither, and where the file is damaged.
    """
    scene = _opened(path)
    bones, findings = _bones(scene)
    nodes = scene.json["nodes"]
    names = unlike([str(nodes[n].get("name", f"node {n}")) for n in bones])
    place = {n: b for b, n in enumerate(bones)}
    parents = tuple(place[scene.parents[n]] if b else -1 for b, n in enumerate(bones))
    tracks, times, told = _tracks(scene, animation)
    findings += told
    rate = _rate_of(times)
    frames = np.zeros(1) if times is None else times[0] + np.arange(round((times[-1] - times[0]) * rate) + 1) / rate
    worlds = _worlds(scene, bones, tracks, frames)
    rest = _rest(scene, bones, _worlds(scene, bones, {}, np.zeros(1))[:, 0])
    rest_turns = _turns(path, rest)
    turned = _turns(path, worlds.reshape(-1, 4, 4)).reshape(len(bones), -1, 3, 3) @ rest_turns.swapaxes(1, 2)[:, None]
    above = np.array([max(parent, 0) for parent in parents])
    rotations = turned[above].swapaxes(2, 3) @ turned
    rotations[0] = turned[0]
    offsets = rest[:, :3, 3] - rest[above, :3, 3]
    offsets[0] = 0.0
    ends = _ends(scene, bones, rest, offsets)
    motion = SkeletonMotion(names, parents, offsets, ends, rotations.swapaxes(0, 1), worlds[0, :, :3, 3], rate)
    # what rigid bones do not hold, as a share of the skeleton
    slid = np.abs(worlds[:, :, :3, 3].swapaxes(0, 1) - motion.joints).max(axis=(0, 2))
    if slid.max() > 1e-3 * max(float(np.ptp(rest[:, :3, 3], axis=0).max()), 1e-9):
        b = int(slid.argmax())
        findings.append(bones_lost(f"bones slide or grow, {names[b]} is up to {1e3 * slid[b]:.0f} mm off; they were taken as rigid"))
    motion, doubts = vertical_of(motion, vertical)
    return SkeletonFile(forward_of(motion), "glTF", 1.0, tuple(findings + doubts))


def write_gltf(path: Path, motion: SkeletonMotion, *, like: Path | None = None, missing: str = "hold") -> list[str]:
    """Write a skeleton with a skin, a body for each bone, and its motion as an animation; returns what glTF cannot carry.

    like     a glTF file that is kept with all it has, with the animation as its first; the motion has its bones as `read_gltf` gives them
    missing  as for `asterism.formats.bvh.write_bvh`

    A .gltf holds its buffer itself, so that it is one file as a .glb is.
    """
    filled, lost = fill_missing_bones(motion, missing)
    if like is None:
        filled, axes = turned_into(filled, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
        document, data = _new_document(filled)
        if axes:
            lost.append(axes)
    else:
        document, data = _with_animation(_opened(like), like, filled)
        if path.parent.resolve() != like.parent.resolve() and any(
            "uri" in one and not one["uri"].startswith("data:") for one in _links(document)
        ):
            lost.append(f"the files beside {like.name}, which it names: copy them to {path.parent}")
    if path.suffix.casefold() == ".glb":
        write_atomically(path, _as_glb(document, bytes(data)))
    else:
        uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
        document["buffers"][0]["uri"] = uri
        write_atomically(path, utf8(json.dumps(document, ensure_ascii=False)))
    return lost


def _links(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [*document.get("images", []), *document.get("buffers", [])]


# Reading.


def _opened(path: Path) -> _Scene:
    data = read_bytes(path)
    binary = b""
    if len(data) >= 12 and struct.unpack_from("<I", data)[0] == _MAGIC:
        text, binary = _chunks(path, data)
    else:
        text = data
    try:
        document = json.loads(text.decode("utf-8-sig"))
    except ValueError as problem:
        raise AsterismError(f"{path} is damaged (its JSON cannot be read); export it again.") from problem
    version = str(document.get("asset", {}).get("version", "")) if isinstance(document, dict) else ""
    if not version.startswith("2"):
        raise AsterismError(f"{path} is glTF {version or 'without a version'}, and 2.0 is read; export it as glTF 2.0.")
    scene = _Scene(path, document, [_buffer(path, one, binary, k) for k, one in enumerate(document.get("buffers", []))])
    nodes = document.get("nodes", [])
    scene.parents = [-1] * len(nodes)
    for n, node in enumerate(nodes):
        for child in node.get("children", []):
            if not 0 <= child < len(nodes) or scene.parents[child] != -1:
                raise AsterismError(f"{path}: node {child} hangs on two nodes or does not exist; export it again.")
            scene.parents[child] = n
    for n in range(len(nodes)):
        seen, at = 0, n
        while at >= 0:
            at, seen = scene.parents[at], seen + 1
            if seen > len(nodes):
                raise AsterismError(f"{path}: its nodes hang on each other in a circle; export it again.")
    return scene


def _chunks(path: Path, data: bytes) -> tuple[bytes, bytes]:
    """The JSON and the binary chunk of a GLB file."""
    _, version, length = struct.unpack_from("<III", data)
    if version != 2:
        raise AsterismError(f"{path} is a GLB of version {version}, and 2 is read; export it as glTF 2.0.")
    if length > len(data):
        raise AsterismError(f"{path} ends after {len(data)} of {length} bytes; it was cut off: copy or export it again.")
    at, found = 12, dict[int, bytes]()
    while at + 8 <= length:
        size, kind = struct.unpack_from("<II", data, at)
        if at + 8 + size > len(data):
            raise AsterismError(f"{path}: a chunk of {size} bytes reaches beyond its end; export it again.")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    if _JSON not in found:
        raise AsterismError(f"{path} has no JSON chunk; export it again.")
    return found[_JSON], found.get(_BIN, b"")


def _buffer(path: Path, one: dict[str, Any], binary: bytes, k: int) -> bytes:
    uri = one.get("uri")
    if uri is None:
        if k:
            raise AsterismError(f"{path}: buffer {k} names no data; export it again.")
        return binary
    if uri.startswith("data:"):
        head, _, content = uri.partition(",")
        return base64.b64decode(content) if head.endswith(";base64") else unquote(content).encode("latin-1")
    # a file from elsewhere must not make us read what it likes
    beside = (path.parent / unquote(uri)).resolve()
    if ":" in uri.split("/")[0] or not beside.is_relative_to(path.parent.resolve()):
        raise AsterismError(f"{path}: its buffer {uri!r} lies outside of its folder; put both into one folder, or export it as .glb.")
    if not beside.is_file():
        raise AsterismError(f"{path}: its buffer {uri!r} is not beside it; copy it there, or export it as .glb.")
    return read_bytes(beside)


def _accessor(scene: _Scene, index: int) -> Floats:
    """(count, width) the values of an accessor as numbers; integers that stand for shares become -1 to 1."""
    one = scene.json["accessors"][index]
    count, width, kind = int(one["count"]), _WIDTHS[one["type"]], np.dtype(_COMPONENTS[one["componentType"]])
    if not 0 <= count <= (_MOST_ZEROS if "bufferView" not in one else 100_000_000):
        raise AsterismError(f"{scene.path}: accessor {index} has {count} values; export it again.")
    values = (
        _view(scene, one["bufferView"], int(one.get("byteOffset", 0)), count, width, kind)
        if "bufferView" in one
        else np.zeros((count, width), kind)
    )
    sparse = one.get("sparse")
    if sparse:
        many = int(sparse["count"])
        at, new = sparse["indices"], sparse["values"]
        places = _view(scene, at["bufferView"], int(at.get("byteOffset", 0)), many, 1, np.dtype(_COMPONENTS[at["componentType"]]))[:, 0]
        values = values.copy()
        values[places] = _view(scene, new["bufferView"], int(new.get("byteOffset", 0)), many, width, kind)
    out = values.astype(np.float64)
    if one.get("normalized") and kind.kind in "iu":
        out = np.maximum(out / np.iinfo(kind).max, -1.0)
    return out


def _view(scene: _Scene, index: int, offset: int, count: int, width: int, kind: np.dtype[Any]) -> NDArray[Any]:
    view = scene.json["bufferViews"][index]
    data = scene.buffers[view["buffer"]]
    size = width * kind.itemsize
    stride, start = int(view.get("byteStride") or size), int(view.get("byteOffset", 0)) + offset
    needed = offset + (stride * (count - 1) + size if count else 0)
    if start < 0 or offset < 0 or stride < size or needed > int(view["byteLength"]) or start + needed - offset > len(data):
        raise AsterismError(f"{scene.path} ends before all values of its buffer; it was cut off: copy or export it again.")
    rows = np.lib.stride_tricks.as_strided(np.frombuffer(data, np.uint8)[start:], (count, size), (stride, 1))
    return np.ascontiguousarray(rows).view(kind).reshape(count, width)


def _bones(scene: _Scene) -> tuple[list[int], list[Finding]]:
    """The nodes that are bones, each behind its parent."""
    document, parents = scene.json, scene.parents
    joints = {int(n) for skin in document.get("skins", []) for n in skin["joints"]}
    if not joints:
        joints = {
            int(channel["target"]["node"])
            for one in document.get("animations", [])
            for channel in one["channels"]
            if channel["target"].get("path") == "rotation" and "node" in channel["target"]
        }
    if not joints:
        raise AsterismError(f"{scene.path} has no skeleton: no skin, and no animation that turns nodes; export it with its armature.")
    if any(not 0 <= n < len(parents) for n in joints):
        raise AsterismError(f"{scene.path}: a joint of its skin does not exist; export it again.")

    def ancestors(n: int) -> list[int]:
        out = [n]
        while parents[out[-1]] >= 0:
            out.append(parents[out[-1]])
        return out

    # a node between two joints is a bone, too
    for n in list(joints):
        line = ancestors(n)
        last = max(i for i, one in enumerate(line) if one in joints)
        joints.update(line[:last])
    roots = sorted(n for n in joints if parents[n] not in joints)
    trees = {root: [n for n in joints if root in ancestors(n)] for root in roots}
    findings = list[Finding]()
    if len(roots) > 1:
        chosen = max(roots, key=lambda root: len(trees[root]))
        joints = set(trees[chosen])
        left = [str(document["nodes"][root].get("name", root)) for root in roots if root != chosen]
        findings.append(bones_lost(f"it has {len(roots)} separate skeletons; the largest was read, without {', '.join(left[:4])}"))
    order, waiting = list[int](), [next(n for n in sorted(joints) if parents[n] not in joints)]
    while waiting:
        n = waiting.pop(0)
        order.append(n)
        waiting[:0] = [c for c in document["nodes"][n].get("children", []) if c in joints]
    return order, findings


Track = tuple[Floats, Floats, str]
"""Times (K,) s, values (K, width) or three times as many for cubic splines, and the kind of interpolation."""


def _tracks(scene: _Scene, animation: str | int | None) -> tuple[dict[tuple[int, str], Track], Floats | None, list[Finding]]:
    """What an animation sets, by node and path, all times of its keys (K,) s, and which was taken of several."""
    every = scene.json.get("animations", [])
    if not every:
        if animation is not None:
            raise AsterismError(f"{scene.path} has no animation.")
        return {}, None, []
    names = [str(one.get("name", f"animation {k}")) for k, one in enumerate(every)]
    chosen = (
        0
        if animation is None
        else int(animation)
        if str(animation).isdigit()
        else names.index(str(animation))
        if animation in names
        else -1
    )
    if not 0 <= chosen < len(every):
        raise AsterismError(f"{scene.path} has no animation {animation!r}; it has {', '.join(names[:10])}.")
    findings = []
    if animation is None and len(every) > 1:
        findings.append(header_doubt(f"it has {len(every)} animations ({', '.join(names[:6])}); the first was read"))
    tracks, times = dict[tuple[int, str], Track](), list[Floats]()
    samplers = every[chosen]["samplers"]
    for channel in every[chosen]["channels"]:
        target = channel["target"]
        if "node" not in target or target["path"] not in ("rotation", "translation", "scale"):
            continue
        sampler = samplers[channel["sampler"]]
        keys, values = _accessor(scene, sampler["input"])[:, 0], _accessor(scene, sampler["output"])
        kind = str(sampler.get("interpolation", "LINEAR"))
        if not len(keys) or len(values) != len(keys) * (3 if kind == "CUBICSPLINE" else 1) or (np.diff(keys) <= 0).any():
            raise AsterismError(f"{scene.path}: an animation has keys that do not increase, or other numbers of times and values.")
        if not (np.isfinite(keys).all() and np.isfinite(values).all()):
            raise AsterismError(f"{scene.path}: an animation holds values that are no numbers; export it again.")
        tracks[int(target["node"]), target["path"]] = (keys, values, kind)
        times.append(keys)
    return tracks, np.unique(np.concatenate(times)) if times else None, findings


def _rate_of(times: Floats | None) -> float:
    """Frames per second of keys at these times: theirs where they lie evenly, else `_SPARSE_KEYS`."""
    if times is None or len(times) < 2:
        return _SPARSE_KEYS
    step = float(np.median(np.diff(times)))
    steps = np.round(np.diff(times) / step)
    even = np.abs(np.diff(times) / step - steps).max() < 0.05
    # over all keys: times are single numbers of 24 bits, one step of which says little
    rate = float(steps.sum() / (times[-1] - times[0])) if even and (len(times) > 2 or step * _SPARSE_KEYS <= 1.0) else _SPARSE_KEYS
    printed = round(rate) if abs(rate - round(rate)) < 2e-4 * rate else round(rate, 2)
    rate = float(printed) if printed and abs(rate - printed) < 2e-4 * rate else rate
    if (times[-1] - times[0]) * rate > _MOST_FRAMES:
        raise AsterismError(f"an animation of {times[-1] - times[0]:.0f} s at {rate:.0f} frames per second is too long; export it again.")
    return rate


def _sampled(track: Track, frames: Floats, turn: bool) -> Floats:
    """(T, width) the values of a track at times (T,) s; before the first and after the last key these hold."""
    keys, values, kind = track
    at = np.clip(np.searchsorted(keys, frames + 1e-6, side="right") - 1, 0, len(keys) - 1)
    after = np.minimum(at + 1, len(keys) - 1)
    span = np.where(after > at, keys[after] - keys[at], 1.0)
    share = np.clip((frames - keys[at]) / span, 0.0, 1.0)[:, None]
    if kind == "STEP":
        out = values[at]
    elif kind == "CUBICSPLINE":
        tangent_in, points, tangent_out = values.reshape(len(keys), 3, -1).swapaxes(0, 1)
        u, step = share, span[:, None]
        out = (
            (2 * u**3 - 3 * u**2 + 1) * points[at]
            + step * (u**3 - 2 * u**2 + u) * tangent_out[at]
            + (3 * u**2 - 2 * u**3) * points[after]
            + step * (u**3 - u**2) * tangent_in[after]
        )
    elif not turn:
        out = (1 - share) * values[at] + share * values[after]
    else:
        a, b = (q / np.linalg.norm(q, axis=1, keepdims=True) for q in (values[at], values[after]))
        cosine = (a * b).sum(axis=1, keepdims=True)
        b, cosine = np.where(cosine < 0, -b, b), np.abs(cosine)
        angle = np.arccos(np.minimum(cosine, 1.0))
        sine = np.sin(angle)
        small = sine < 1e-6
        safe = np.where(small, 1.0, sine)
        out = np.where(small, 1 - share, np.sin((1 - share) * angle) / safe) * a + np.where(small, share, np.sin(share * angle) / safe) * b
    return np.asarray(out, dtype=np.float64)


def _worlds(scene: _Scene, bones: list[int], tracks: dict[tuple[int, str], Track], frames: Floats) -> Floats:
    """(B, T, 4, 4) from each bone to the scene, at times (T,) s."""
    found = dict[int, Floats]()

    def world(n: int) -> Floats:
        chain = list[int]()
        while n >= 0 and n not in found:
            chain.append(n)
            n = scene.parents[n]
        for one in reversed(chain):
            local = _local(scene, one, tracks, frames)
            found[one] = found[scene.parents[one]] @ local if scene.parents[one] >= 0 else local
        return found[chain[0]] if chain else found[n]

    return np.stack([world(n) for n in bones])


def _local(scene: _Scene, n: int, tracks: dict[tuple[int, str], Track], frames: Floats) -> Floats:
    node = scene.json["nodes"][n]
    if "matrix" in node and not any((n, path) in tracks for path in ("rotation", "translation", "scale")):
        return np.tile(np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T, (len(frames), 1, 1))
    parts = dict[str, Floats]()
    for path, usual in _parts(node).items():
        track = tracks.get((n, path))
        parts[path] = np.tile(usual, (len(frames), 1)) if track is None else _sampled(track, frames, path == "rotation")
    out = np.tile(np.eye(4), (len(frames), 1, 1))
    out[:, :3, :3] = _matrices(parts["rotation"]) * parts["scale"][:, None, :]
    out[:, :3, 3] = parts["translation"]
    return out


def _parts(node: dict[str, Any]) -> dict[str, Floats]:
    """Translation (3,), rotation (4,) x y z w, and scale (3,) of a node; a matrix is taken apart."""
    if "matrix" in node:
        matrix = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        turn: Floats = nearest_orthogonal(matrix[:3, :3] / np.where(scale > 0, scale, 1.0))
        return {"translation": matrix[:3, 3], "rotation": _quaternions(turn[None])[0], "scale": scale}
    return {
        "translation": np.array(node.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64),
        "rotation": np.array(node.get("rotation", (0.0, 0.0, 0.0, 1.0)), dtype=np.float64),
        "scale": np.array(node.get("scale", (1.0, 1.0, 1.0)), dtype=np.float64),
    }


def _matrices(quaternions: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(quaternions, axis=1, keepdims=True)
    found: Floats = Rotation.from_quat(np.where(length > 0, quaternions, (0.0, 0.0, 0.0, 1.0))).as_matrix()
    return found


def _quaternions(rotations: Floats) -> Floats:
    """(T, 4) x y z w of rotations (T, 3, 3); each with the sign that is nearer to the one before."""
    from scipy.spatial.transform import Rotation

    found: Floats = Rotation.from_matrix(rotations).as_quat()
    turns = np.cumprod(np.where((found[1:] * found[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    found[1:] *= turns[:, None]
    return found


def _turns(path: Path, matrices: Floats) -> Floats:
    """(N, 3, 3) the rotations in matrices (N, 4, 4)."""
    part = matrices[:, :3, :3]
    scale = np.linalg.norm(part, axis=1, keepdims=True)
    turns = part / np.where(scale > 0, scale, 1.0)
    # what only scales along its own axes is a rotation already
    sheared = np.abs(turns.swapaxes(1, 2) @ turns - np.eye(3)).max(axis=(1, 2)) > 1e-7
    turns[sheared] = nearest_orthogonal(turns[sheared])
    if (np.linalg.det(turns) < 0).any():
        raise AsterismError(
            f"{path}: bones are mirrored by a negative scale; apply the scale in the program that made it, and export again."
        )
    return turns


def _rest(scene: _Scene, bones: list[int], nodes: Floats) -> Floats:
    """(B, 4, 4) from each bone to the scene in the rest pose: as the skin is bound, else as the nodes (B, 4, 4) stand."""
    place = {n: b for b, n in enumerate(bones)}
    bound = dict[int, Floats]()
    for skin in scene.json.get("skins", []):
        if "inverseBindMatrices" not in skin:
            continue
        inverse = _accessor(scene, skin["inverseBindMatrices"]).reshape(-1, 4, 4).swapaxes(1, 2)
        if len(inverse) < len(skin["joints"]):
            raise AsterismError(f"{scene.path}: a skin has fewer bind matrices than joints; export it again.")
        for n, matrix in zip(skin["joints"], inverse, strict=False):
            if n in place and n not in bound and abs(np.linalg.det(matrix)) > 1e-30:
                bound[n] = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    if len(bound) < 2:
        return nodes
    rest = nodes.copy()
    known = [place[n] for n in bound]
    there = np.stack(list(bound.values()))
    # By the lengths of the bones, which no posture changes: a mesh may be in centimetres.
    bind = {place[n]: matrix[:3, 3] for n, matrix in bound.items()}
    pairs = [(place[n], place[scene.parents[n]]) for n in bound if place.get(scene.parents[n]) in bind]
    spread = sum(float(np.linalg.norm(bind[b] - bind[a])) for b, a in pairs)
    scale = sum(float(np.linalg.norm(nodes[b, :3, 3] - nodes[a, :3, 3])) for b, a in pairs) / spread if spread > 0 else 1.0
    # A skin is bound in its mesh's axes: the scene's, or those of what stands above the root.
    above = np.eye(4)
    if scene.parents[bones[0]] >= 0:
        above = _worlds(scene, [scene.parents[bones[0]]], {}, np.zeros(1))[0, 0]
    options = [np.eye(3), nearest_orthogonal(above[:3, :3])]
    middle = nodes[known, :3, 3] - nodes[known, :3, 3].mean(axis=0)
    shape = scale * (there[:, :3, 3] - there[:, :3, 3].mean(axis=0))
    turn = min(options, key=lambda one: float(np.linalg.norm(shape @ one.T - middle)))
    for b, matrix in zip(known, there, strict=True):
        rest[b, :3, :3] = turn @ matrix[:3, :3]
        rest[b, :3, 3] = scale * turn @ matrix[:3, 3]
    # joints that no skin binds stand on those above them as their nodes do
    for b, n in enumerate(bones):
        if b and n not in bound:
            over = place[scene.parents[n]]
            rest[b] = rest[over] @ np.linalg.inv(nodes[over]) @ nodes[b]
    return rest


def _ends(scene: _Scene, bones: list[int], rest: Floats, offsets: Floats) -> Floats:
    """(B, 3) m, where bones end: at a node that hangs on them and is no bone, else a half as far on as they are from the one above.

    NaN where another bone hangs on a bone. rest (B, 4, 4): from each bone to the scene in the rest pose.
    """
    ends = np.full_like(offsets, np.nan)
    for b, n in enumerate(bones):
        below = scene.json["nodes"][n].get("children", [])
        marks = [c for c in below if str(scene.json["nodes"][c].get("name", "")).casefold().endswith("end") and c not in bones]
        if marks:
            at = np.append(_parts(scene.json["nodes"][marks[0]])["translation"], 1.0)
            ends[b] = (rest[b] @ at)[:3] - rest[b, :3, 3]
        elif b and not any(c in bones for c in below):
            ends[b] = 0.5 * offsets[b]
    return ends


# Writing.


class _Writer:
    """Arrays in; accessors of one buffer out."""

    def __init__(self, document: dict[str, Any], data: bytearray, buffer: int = 0) -> None:
        self.document, self.data, self.buffer = document, data, buffer

    def add(self, values: NDArray[Any], kind: int, component: str, *, target: int | None = None, bounds: bool = False) -> int:
        array = np.ascontiguousarray(values, dtype=_COMPONENTS[kind])
        while len(self.data) % 4:
            self.data.append(0)
        view = {"buffer": self.buffer, "byteOffset": len(self.data), "byteLength": array.nbytes}
        if target is not None:
            view["target"] = target
        self.data += array.tobytes()
        views = self.document.setdefault("bufferViews", [])
        views.append(view)
        accessor: dict[str, Any] = {"bufferView": len(views) - 1, "componentType": kind, "count": len(array), "type": component}
        if bounds:
            flat = array.reshape(len(array), -1)
            accessor |= {"min": flat.min(axis=0).tolist(), "max": flat.max(axis=0).tolist()}
        accessors = self.document.setdefault("accessors", [])
        accessors.append(accessor)
        return len(accessors) - 1


def _new_document(motion: SkeletonMotion) -> tuple[dict[str, Any], bytearray]:
    """A document with the skeleton, bodies of its bones, a skin, and the motion."""
    rest = motion.rest_joints.copy()
    tips = rest + motion.ends
    # the rest pose stands on the floor
    lift = -float(np.nanmin(np.concatenate([rest, tips])[:, 1]))
    rest[:, 1] += lift
    children = [[c for c, parent in enumerate(motion.parents) if parent == b] for b in range(len(motion.names))]
    nodes: list[dict[str, Any]] = []
    for b, name in enumerate(motion.names):
        node: dict[str, Any] = {"name": name, "translation": (motion.offsets[b] if b else rest[0]).tolist()}
        nodes.append(node | ({"children": list(children[b])} if children[b] else {}))
    for b in np.nonzero(np.isfinite(motion.ends).all(axis=1))[0].tolist():
        nodes[b].setdefault("children", []).append(len(nodes))
        nodes.append({"name": f"{motion.names[b]}{_END}", "translation": motion.ends[b].tolist()})
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "asterism"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(nodes) - 1]}],
        "nodes": nodes,
    }
    data = bytearray()
    writer = _Writer(document, data)
    inverse = np.tile(np.eye(4), (len(rest), 1, 1))
    inverse[:, :3, 3] = -rest
    # columns one after the other, as glTF has matrices
    matrices = writer.add(inverse.swapaxes(1, 2).reshape(-1, 16), _FLOAT, "MAT4")
    document["skins"] = [{"joints": list(range(len(rest))), "inverseBindMatrices": matrices, "skeleton": 0}]
    document["materials"] = [
        {
            "name": side or "middle",
            "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8},
        }
        for side, colour in _COLOURS.items()
    ]
    document["meshes"] = [{"name": "body", "primitives": _bodies(motion, rest, children, writer)}]
    document["animations"] = [_animation(motion, list(range(len(rest))), motion.rotations, motion.root, writer)]
    document["buffers"] = [{"byteLength": len(data)}]
    return document, data


def _bodies(motion: SkeletonMotion, rest: Floats, children: list[list[int]], writer: _Writer) -> list[dict[str, Any]]:
    """The primitives of a mesh: for each bone a spindle from its joint to its end and to each joint that hangs on it, by side."""
    spindles: dict[str, list[tuple[int, Floats]]] = {side: [] for side in _COLOURS}
    for b, name in enumerate(motion.names):
        to = [rest[c] for c in children[b]]
        if np.isfinite(motion.ends[b]).all():
            to.append(rest[b] + motion.ends[b])
        ends = [end for end in to if np.linalg.norm(end - rest[b]) > 1e-4] or [rest[b] + np.array([0.0, _STUB, 0.0])]
        spindles[split_name(name)[0]] += [(b, _spindle(rest[b], end)) for end in ends]
    primitives = []
    for material, shapes in enumerate(spindles.values()):
        if not shapes:
            continue
        corners = np.concatenate([shape for _, shape in shapes])
        joints = np.zeros((len(corners), 4))
        joints[:, 0] = np.repeat([b for b, _ in shapes], len(corners) // len(shapes))
        faces = corners.reshape(-1, 3, 3)
        normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        attributes = {
            "POSITION": writer.add(corners, _FLOAT, "VEC3", target=34962, bounds=True),
            "NORMAL": writer.add(np.repeat(normals, 3, axis=0), _FLOAT, "VEC3", target=34962),
            "JOINTS_0": writer.add(joints, _USHORT, "VEC4", target=34962),
            "WEIGHTS_0": writer.add(np.tile([1.0, 0.0, 0.0, 0.0], (len(corners), 1)), _FLOAT, "VEC4", target=34962),
        }
        indices = writer.add(np.arange(len(corners)), _UINT, "SCALAR", target=34963)
        primitives.append({"attributes": attributes, "indices": indices, "material": material})
    return primitives


def _spindle(start: Floats, end: Floats) -> Floats:
    """(24, 3) the corners of eight triangles: two pyramids on a square, the shorter one at the start."""
    along = end - start
    length = float(np.linalg.norm(along))
    along = along / length
    side = np.cross(along, np.eye(3)[int(np.abs(along).argmin())])
    side /= np.linalg.norm(side)
    width = min(_BONE_WIDTH * length, _WIDEST)
    other = np.cross(along, side)
    ring = [start + 0.2 * (end - start) + width * v for v in (side, other, -side, -other)]
    corners = list[Floats]()
    for i in range(4):
        a, b = ring[i], ring[(i + 1) % 4]
        corners += [a, b, end, b, a, start]
    return np.array(corners)


def _animation(motion: SkeletonMotion, nodes: list[int], rotations: Floats, root: Floats, writer: _Writer) -> dict[str, Any]:
    """An animation of nodes. rotations (T, B, 3, 3) and root (T, 3): of each node on the one above it."""
    times = writer.add(np.arange(len(motion)) / motion.rate, _FLOAT, "SCALAR", bounds=True)
    samplers = [{"input": times, "output": writer.add(root, _FLOAT, "VEC3"), "interpolation": "LINEAR"}]
    channels = [{"sampler": 0, "target": {"node": nodes[0], "path": "translation"}}]
    for b, n in enumerate(nodes):
        output = writer.add(_quaternions(rotations[:, b]), _FLOAT, "VEC4")
        channels.append({"sampler": len(samplers), "target": {"node": n, "path": "rotation"}})
        samplers.append({"input": times, "output": output, "interpolation": "LINEAR"})
    return {"name": "motion", "channels": channels, "samplers": samplers}


def _with_animation(scene: _Scene, like: Path, motion: SkeletonMotion) -> tuple[dict[str, Any], bytearray]:
    """The document of another file with the motion as its first animation, and its first buffer with the data of that."""
    source = read_gltf(like).motion
    motion = motion.in_axes(source.vertical, source.forward)
    if motion.names != source.names:
        raise AsterismError(f"the motion has other bones than {like.name}; map it to that skeleton first.")
    bones, _ = _bones(scene)
    nodes = _worlds(scene, bones, {}, np.zeros(1))[:, 0]
    rest = _turns(like, _rest(scene, bones, nodes))
    turned = motion.turned @ rest
    local = turned.copy()
    for b, parent in enumerate(motion.parents[1:], start=1):
        local[:, b] = turned[:, parent].swapaxes(1, 2) @ turned[:, b]
    # the root stands on what is above it, which may turn and scale it
    above = np.eye(4)
    if scene.parents[bones[0]] >= 0:
        above = _worlds(scene, [scene.parents[bones[0]]], {}, np.zeros(1))[0, 0]
    local[:, 0] = _turns(like, above[None])[0].T @ turned[:, 0]
    inverse = np.linalg.inv(above)
    root = motion.root @ inverse[:3, :3].T + inverse[:3, 3]
    document = dict(scene.json)
    document["nodes"] = [dict(node) for node in document["nodes"]]
    for n in bones:
        # what is animated must not have a matrix
        node = document["nodes"][n]
        if "matrix" in node:
            parts = {path: values.tolist() for path, values in _parts(node).items()}
            del node["matrix"]
            node |= parts
    for key in ("accessors", "bufferViews", "buffers"):
        document[key] = [dict(one) for one in document.get(key, [])]
    if not document["buffers"]:
        document["buffers"] = [{}]
    data = bytearray(scene.buffers[0] if scene.buffers else b"")
    writer = _Writer(document, data)
    document["animations"] = [_animation(motion, bones, local, root, writer), *document.get("animations", [])]
    document["buffers"][0] = {key: value for key, value in document["buffers"][0].items() if key != "uri"} | {"byteLength": len(data)}
    return document, data


def _as_glb(document: dict[str, Any], data: bytes) -> bytes:
    text = utf8(json.dumps(document, ensure_ascii=False, separators=(",", ":")))
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    length = 12 + 8 + len(text) + 8 + len(data)
    head = struct.pack("<III", _MAGIC, 2, length)
    return head + struct.pack("<II", len(text), _JSON) + text + struct.pack("<II", len(data), _BIN) + data
