"""BVH (Biovision hierarchy): a text file of bones and their joint angles in, a skeleton's motion out, and back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically
from asterism.files.text import decoded, lines_of, read_bytes
from asterism.findings import Finding
from asterism.formats._bones import (
    SkeletonFile,
    as_euler,
    fill_missing_bones,
    forward_of,
    from_euler,
    turned_into,
    unlike,
    vertical_of,
)
from asterism.formats._findings import bones_lost, cut_off, header_conflict, missing_samples, units_assumed, units_doubtful
from asterism.formats._units import METRES_PER_UNIT
from asterism.recording import Floats, SkeletonMotion

_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")
_DIGITS = 6
"""Behind the point of what is written: 1e-6 of a degree turns a hand at 1 m by 2e-8 m. At half of it, by 2e-5 m."""

_MOVES = 1e-3
"""Share of the skeleton's size by which the position channels of a bone must vary to be a movement: rounded positions vary by less. At half
of it the rounding of files with three digits would count, at double a bone that slides by 3 mm would not be said."""

_DEEPEST = 500
"""Bones behind each other. A hand with fingers ends 12 bones behind the hips; a file of 501 is damaged or made to do harm."""


@dataclass
class BvhJoint:
    """A joint as the file has it, in the file's units. parent: -1 of the root; end: of its end site, or None; channels in their order."""

    name: str
    parent: int
    offset: Floats
    channels: tuple[str, ...] = ()
    end: Floats | None = None


@dataclass(frozen=True)
class Document:
    """A BVH file as it is. values: (T, C) of all channels in their order; head: the lines of the hierarchy, as they stand."""

    joints: list[BvhJoint]
    values: Floats
    frame_time: float
    head: list[str]
    findings: list[Finding]


def read_bvh(path: Path, unit: str | float | None = None, vertical: Floats | None = None) -> SkeletonFile:
    """The skeleton of a BVH file, in metres, in the file's axes.

    unit      of length, such as "cm" or "in", or metres per unit; None: of m, cm and mm the one that fits the size of a person
    vertical  an axis; None: y, as BVH has it, unless the skeleton stands along another one

    The position channels of a joint replace its OFFSET, as animation programs have it. A bone that only places the skeleton in the room
    (the root has one child, and that moves) is joined with its child. Raises AsterismError for several roots and damaged files.
    """
    document = parse(path)
    joints, findings = document.joints, list(document.findings)
    rotations, positions, moves = _channels(document)
    offsets = np.array([joint.offset for joint in joints])
    size = max(float(np.ptp(_rest(joints, offsets), axis=0).max()), 1e-9)
    # Where a joint has positions, they are where it is: their median replaces the offset, which may be zero.
    sliding: list[tuple[str, float]] = []
    for j in range(len(joints)):
        if moves[j] and np.isfinite(positions[:, j]).any():
            middle = np.nanmedian(positions[:, j], axis=0)
            slid = float(np.nanmax(np.abs(positions[:, j] - middle)))
            # digits that were printed say no more than the OFFSET
            if np.abs(middle - offsets[j]).max() > _MOVES * size:
                offsets[j] = middle
            sliding.append((joints[j].name, slid))
    # A root that only carries the moving hips is no bone of the body.
    first = 0
    root, turned = positions[:, 0], rotations[:, 0]
    slid_of = dict(sliding)
    while moves[0]:
        children = [j for j, joint in enumerate(joints) if joint.parent == first]
        if len(children) != 1 or slid_of.get(joints[children[0]].name, 0.0) <= _MOVES * size:
            break
        first, above = children[0], turned
        root = root + np.einsum("tij,tj->ti", above, positions[:, first])
        turned = above @ rotations[:, first]
    if not moves[0]:
        root = np.tile(offsets[0], (len(root), 1))
    kept = list(range(first, len(joints)))
    if first:
        findings.append(
            bones_lost(f"{joints[first].name} moves on {joints[0].name}, which places it in the room; both were read as one bone")
        )
    lost = [(name, slid) for name, slid in sliding if slid > _MOVES * size and name in {joints[j].name for j in kept[1:]}]
    scale, told = _unit(path, unit, _stature(joints, offsets, first))
    findings += told
    if lost:
        name, most = max(lost, key=lambda one: one[1])
        findings.append(
            bones_lost(f"{len(lost)} bones slide on those above them, {name} by {1e3 * scale * most:.0f} mm; they were taken as rigid")
        )
    offsets[first] = 0.0
    rotations[:, first] = turned
    unknown = ~np.isfinite(rotations[:, kept]).all(axis=(1, 2, 3)) | ~np.isfinite(root).all(axis=1)
    if unknown.any():
        findings.append(missing_samples(f"{int(unknown.sum())} of {len(root)} frames have values that are no numbers; they are missing"))
    names = unlike([joints[j].name for j in kept])
    parents = tuple(joints[j].parent - first if j > first else -1 for j in kept)
    ends = np.array([np.full(3, np.nan) if joint.end is None else joint.end for joint in joints])[kept]
    motion = SkeletonMotion(
        names, parents, offsets[kept] * scale, ends * scale, rotations[:, kept], root * scale, _rate(document.frame_time)
    )
    motion, vertical_findings = vertical_of(motion, vertical)
    return SkeletonFile(forward_of(motion), "BVH", scale, tuple(findings + vertical_findings))


def write_bvh(
    path: Path,
    motion: SkeletonMotion,
    *,
    like: Path | None = None,
    unit: str | float = "cm",
    order: str = "ZXY",
    missing: str = "hold",
) -> list[str]:
    """Write a skeleton as BVH, y up and facing z in the rest pose; returns what BVH cannot carry.

    like     a BVH file whose hierarchy, channels, unit and axes are kept as they stand; the motion holds its bones, as `read_bvh` gave them
    unit     of length of what is written
    order    of the Euler angles, the outermost axis first, of x, y and z each once
    missing  "hold": a bone that is missing stays as it last was; "interpolate": it turns evenly across the gap
    """
    filled, lost = fill_missing_bones(motion, missing)
    if like is not None:
        document = parse(like)
        source = read_bvh(like, unit=None)
        return lost + _write_like(path, filled, document, source)
    order, scale = checked_order(order), metres_in(unit)
    filled, axes = turned_into(filled, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    if axes:
        lost.append(axes)
    names = tuple(re.sub(r"[\s{}]+", "_", name) for name in filled.names)
    if names != filled.names:
        lost.append("blanks in the names of bones, which became _")
    children = [[c for c, parent in enumerate(filled.parents) if parent == b] for b in range(len(names))]
    inner = [filled.names[b] for b, below in enumerate(children) if below and np.isfinite(filled.ends[b]).all()]
    if inner:
        lost.append(f"the ends of bones on which others hang: {', '.join(inner[:5])}{' ...' if len(inner) > 5 else ''}")
    ranks: list[int] = []
    joints = [
        BvhJoint(
            names[b],
            filled.parents[b],
            filled.offsets[b] / scale,
            (*(f"{axis}position" for axis in "XYZ" if not b), *(f"{axis}rotation" for axis in order)),
            None if children[b] else np.nan_to_num(filled.ends[b]) / scale,
        )
        for b in range(len(names))
    ]
    lines = ["HIERARCHY", *_hierarchy(joints, children, 0, 0, ranks)]
    columns = [filled.root / scale]
    columns += [np.degrees(as_euler(filled.rotations[:, b], order)) for b in ranks]
    _write(path, lines, np.concatenate(columns, axis=1), 1.0 / filled.rate)
    return lost


def checked_order(order: str) -> str:
    """The order of Euler angles in capitals. Raises AsterismError where it is not x, y and z, each once."""
    if sorted(order.upper()) != ["X", "Y", "Z"]:
        raise AsterismError(f"the order of Euler angles {order!r} is not x, y and z, each once; give ZXY, XYZ or the like.")
    return order.upper()


def metres_in(unit: str | float) -> float:
    """Metres per unit, of its name or a number. Raises AsterismError where it is neither."""
    if isinstance(unit, str):
        known = METRES_PER_UNIT.get(unit.strip().casefold())
        if known is not None:
            return known
        try:
            unit = float(unit)
        except ValueError:
            raise AsterismError(f"the unit of length {unit!r} is not known; give m, cm, mm, in, ft, or metres per unit.") from None
    if not (np.isfinite(unit) and unit > 0):
        raise AsterismError(f"{unit} metres per unit cannot be; give a positive number.")
    return float(unit)


def parse(path: Path) -> Document:
    """A BVH file as it stands. Raises AsterismError, naming the line, where it is damaged or has several roots."""
    lines = lines_of(decoded(path, read_bytes(path)))
    at = next((n for n, line in enumerate(lines) if line.strip().upper() == "MOTION"), None)
    if at is None:
        raise AsterismError(f"{path} has no line MOTION behind its bones; it was cut off or is no BVH file: export it again.")
    joints = _joints(path, lines[:at])
    findings: list[Finding] = []
    count, frame_time, begin = _motion_head(path, lines, at + 1)
    width = sum(len(joint.channels) for joint in joints)
    found = _values(path, lines, begin, width)
    if found is None:
        raise AsterismError(f"{path} has no whole frame behind Frame Time: its bones have {width} channels; export it again.")
    values, cut = found
    if cut:
        findings.append(cut_off(f"its last line has fewer numbers than the {width} channels of its bones and was left out"))
    if count is not None and count != len(values):
        findings.append(header_conflict(f"it announces {count} frames and holds {len(values)}; these were read"))
    return Document(joints, values, frame_time, lines[:at], findings)


def _tokens(path: Path, lines: list[str]) -> Iterator[tuple[int, str, str]]:
    """Line number, first word in capitals, and the rest, of each statement; braces stand alone, wherever they stand in the file."""
    for n, line in enumerate(lines, start=1):
        for piece in re.split(r"([{}])", line):
            piece = piece.strip()
            if piece:
                word, _, rest = piece.partition(" ") if "\t" not in piece.split(" ")[0] else piece.partition("\t")
                yield n, word.upper(), rest.strip()


def _joints(path: Path, lines: list[str]) -> list[BvhJoint]:
    joints: list[BvhJoint] = []
    # what an open brace belongs to: a joint, or -1 - joint for its end site
    stack: list[int] = []
    opened: int | None = None
    for n, word, rest in _tokens(path, lines):
        where = f"{path}, line {n}"
        if word == "HIERARCHY":
            continue
        if word in ("ROOT", "JOINT"):
            _check_place(where, word, rest, joints, stack, opened)
            joints.append(BvhJoint(rest or f"joint {len(joints) + 1}", stack[-1] if stack else -1, np.zeros(3)))
            opened = len(joints) - 1
        elif word == "END":
            if not stack or stack[-1] < 0 or opened is not None:
                raise AsterismError(f"{where}: an end site stands outside of a joint; its braces do not pair up.")
            opened = -1 - stack[-1]
        elif word == "{":
            if opened is None:
                raise AsterismError(f"{where}: a brace opens without a joint before it.")
            stack.append(opened)
            opened = None
        elif word == "}":
            if not stack:
                raise AsterismError(f"{where}: a brace closes that was not opened.")
            stack.pop()
        elif word == "OFFSET" and stack:
            if stack[-1] < 0:
                joints[-1 - stack[-1]].end = _offset(where, rest)
            else:
                joints[stack[-1]].offset = _offset(where, rest)
        elif word == "CHANNELS" and stack and stack[-1] >= 0:
            joints[stack[-1]].channels = _channel_names(where, rest)
        else:
            raise AsterismError(f"{where}: {word[:30]} {rest[:30]} is not understood among the bones; export the file again.")
    if not joints:
        raise AsterismError(f"{path} has no ROOT; it is damaged or no BVH file: export it again.")
    if stack:
        raise AsterismError(f"{path}: {len(stack)} braces of its bones are not closed; it was cut off: export it again.")
    return joints


def _check_place(where: str, word: str, name: str, joints: list[BvhJoint], stack: list[int], opened: int | None) -> None:
    """Raise AsterismError where a joint cannot stand here."""
    if word == "ROOT" and joints and not stack and opened is None:
        raise AsterismError(
            f"{where}: a second root, {name!r}, stands beside {joints[0].name!r}; export each skeleton to a file of its own."
        )
    if opened is not None or (word == "JOINT") != bool(stack) or (stack and stack[-1] < 0):
        raise AsterismError(f"{where}: {word} {name} stands where none belongs; its braces do not pair up.")
    if len(stack) > _DEEPEST:
        raise AsterismError(f"{where}: more than {_DEEPEST} bones hang on each other; the file is damaged.")


def _offset(where: str, text: str) -> Floats:
    offset = _numbers(where, text)
    if len(offset) != 3 or not np.isfinite(offset).all():
        raise AsterismError(f"{where}: OFFSET {text} is not three numbers.")
    return offset


def _channel_names(where: str, rest: str) -> tuple[str, ...]:
    words = rest.replace(",", " ").split()
    if not words or not words[0].isdigit() or int(words[0]) != len(words) - 1:
        raise AsterismError(f"{where}: CHANNELS {rest} does not have as many names as it announces.")
    names = tuple(word[:1].upper() + word[1:].lower() for word in words[1:])
    odd = [name for name in names if name not in _CHANNELS]
    if odd or len(set(names)) != len(names):
        raise AsterismError(f"{where}: the channels {' '.join(words[1:])} are not each once of {', '.join(_CHANNELS)}.")
    return names


def _motion_head(path: Path, lines: list[str], begin: int) -> tuple[int | None, float, int]:
    """The number of frames that is announced, seconds per frame, and the line where the frames begin."""
    count, frame_time = None, None
    for n in range(begin, len(lines)):
        match = re.fullmatch(r"\s*(frames|frame\s*time)\s*:?\s*(\S+)\s*", lines[n], re.IGNORECASE)
        if match and match[1].lower() == "frames":
            count = int(match[2]) if match[2].isdigit() else None
        elif match:
            try:
                frame_time = float(match[2].replace(",", "."))
            except ValueError:
                frame_time = np.nan
            if not (np.isfinite(frame_time) and frame_time > 0):
                raise AsterismError(f"{path}, line {n + 1}: Frame Time is {match[2]}; give the seconds from frame to frame.")
            return count, frame_time, n + 1
        elif lines[n].strip():
            break
    raise AsterismError(f"{path} has no Frame Time behind MOTION; give the seconds from frame to frame.")


def _values(path: Path, lines: list[str], begin: int, width: int) -> tuple[Floats, bool] | None:
    """(T, C) the values of all frames, and whether a last frame was not whole; None where there is no whole one."""
    rows = [(n, line) for n, line in enumerate(lines[begin:], start=begin + 1) if line.strip()]
    found: list[Floats] = []
    for k, (n, line) in enumerate(rows):
        row = _numbers(f"{path}, line {n}", line, width)
        if len(row) != width:
            if k == len(rows) - 1 and len(row) < width:
                return (np.array(found), True) if found else None
            raise AsterismError(f"{path}, line {n} has {len(row)} numbers, and its bones have {width} channels; export the file again.")
        found.append(row)
    return (np.array(found), False) if found else None


def _numbers(where: str, text: str, width: int = 3) -> Floats:
    """The numbers of a line. Commas separate, or are decimal where only so the line has `width` numbers."""
    if "," in text:
        apart = text.replace(",", " ").replace(";", " ").split()
        cells = apart if len(apart) == width else text.replace(";", " ").replace(",", ".").split()
        cells = cells if len(cells) == width else apart
    else:
        cells = text.replace(";", " ").split()
    try:
        numbers = np.array(cells, dtype=np.float64)
    except ValueError:
        # what a program prints for no number
        numbers = np.array([_number(where, cell) for cell in cells])
    return np.where(np.isfinite(numbers), numbers, np.nan)


def _number(where: str, cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        if re.fullmatch(r"[+-]?(nan|inf|1\.#\w+|null|n/?a)(\(\w+\))?", cell, re.IGNORECASE):
            return float("nan")
        raise AsterismError(f"{where}: {cell[:30]!r} is not a number; export the file again.") from None


def _channels(document: Document) -> tuple[Floats, Floats, list[bool]]:
    """(T, J, 3, 3) the rotations, (T, J, 3) the positions where joints have them, else their offsets, and whether they have them."""
    joints, frames = document.joints, len(document.values)
    rotations, positions, moves, column = np.empty((frames, len(joints), 3, 3)), np.empty((frames, len(joints), 3)), [], 0
    for j, joint in enumerate(joints):
        values = document.values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        turns = [(name[0], c) for c, name in enumerate(joint.channels) if name.endswith("rotation")]
        rotations[:, j] = from_euler("".join(axis for axis, _ in turns), np.radians(values[:, [c for _, c in turns]]))
        positions[:, j] = joint.offset
        for c, name in enumerate(joint.channels):
            if name.endswith("position"):
                positions[:, j, "XYZ".index(name[0])] = values[:, c]
        moves.append(any(name.endswith("position") for name in joint.channels))
    return rotations, positions, moves


def _rest(joints: list[BvhJoint], offsets: Floats) -> Floats:
    """(N, 3) where joints and ends are in the rest pose, the root at the origin."""
    places = np.zeros((len(joints), 3))
    for j, joint in enumerate(joints):
        if joint.parent >= 0:
            places[j] = places[joint.parent] + offsets[j]
    ends = [places[j] + joint.end for j, joint in enumerate(joints) if joint.end is not None]
    return np.concatenate([places, np.reshape(ends, (-1, 3))])


def _stature(joints: list[BvhJoint], offsets: Floats, first: int) -> float:
    """The largest extent of the rest pose along an axis, in the file's unit, without the bones that only place the skeleton."""
    offsets = offsets.copy()
    offsets[: first + 1] = 0.0
    return float(np.ptp(_rest(joints, offsets), axis=0).max())


def _unit(path: Path, unit: str | float | None, stature: float) -> tuple[float, list[Finding]]:
    """Metres per unit, and what was assumed. BVH has no place for its unit."""
    if unit is not None:
        return metres_in(unit), []
    if not stature > 0:
        return 0.01, [units_assumed("BVH does not say its unit of length; cm was taken")]
    # the decade around a person of 1.7 m; inches would be children in cm, so that they must be named
    name = min(("m", "cm", "mm"), key=lambda one: abs(np.log10(stature * METRES_PER_UNIT[one] / 1.7)))
    size = stature * METRES_PER_UNIT[name]
    said = f"BVH does not say its unit of length; with {name} the skeleton is {size:.2f} m large in its rest pose"
    usual = 0.3 < size < 3.0
    return METRES_PER_UNIT[name], [units_assumed(said) if usual else units_doubtful(said)]


def _rate(frame_time: float) -> float:
    """Frames per second; the whole number where its frame time, rounded as in the file, is the file's."""
    whole = round(1.0 / frame_time)
    # frame times have six digits behind the point, mostly, and at least four
    if whole and abs(1.0 / whole - frame_time) < max(6e-7, 1e-4 * frame_time):
        return float(whole)
    printed = round(1.0 / frame_time, 3)
    return printed if printed and abs(1.0 / printed - frame_time) < 1e-9 else 1.0 / frame_time


def _hierarchy(joints: list[BvhJoint], children: list[list[int]], j: int, depth: int, ranks: list[int]) -> list[str]:
    """The lines of a joint and of all that hangs on it; ranks: the joints in the order in which they are written, added to."""
    ranks.append(j)
    tab, joint = "\t" * depth, joints[j]
    lines = [f"{tab}{'JOINT' if joint.parent >= 0 else 'ROOT'} {joint.name}", f"{tab}{{"]
    lines += [f"{tab}\tOFFSET {_row(joint.offset)}", f"{tab}\tCHANNELS {len(joint.channels)} {' '.join(joint.channels)}"]
    for child in children[j]:
        lines += _hierarchy(joints, children, child, depth + 1, ranks)
    if joint.end is not None:
        lines += [f"{tab}\tEnd Site", f"{tab}\t{{", f"{tab}\t\tOFFSET {_row(joint.end)}", f"{tab}\t}}"]
    return [*lines, f"{tab}}}"]


def _row(numbers: Floats) -> str:
    # a zero has no sign
    return " ".join(f"{number:.{_DIGITS}f}" for number in np.round(numbers, _DIGITS) + 0.0)


def _write(path: Path, head: list[str], values: Floats, frame_time: float) -> None:
    """Head and frames, CRLF nowhere. The frame time has digits enough that 119.88 frames per second stay so over an hour."""
    rows = (utf8(_row(row) + "\n") for row in values)
    top = "\n".join([*head, "MOTION", f"Frames: {len(values)}", f"Frame Time: {frame_time:.9f}", ""])
    write_atomically(path, iter([utf8(top), *rows]))


def _write_like(path: Path, motion: SkeletonMotion, document: Document, source: SkeletonFile) -> list[str]:
    """Write the motion through the channels of another file's bones. Raises AsterismError where it has not the same bones."""
    motion = motion.in_axes(source.motion.vertical, source.motion.forward)
    if motion.names != source.motion.names:
        raise AsterismError("the motion has other bones than the file whose hierarchy is to be kept; map it to that skeleton first.")
    joints, first = document.joints, len(document.joints) - len(motion.names)
    rotations, positions, _ = _channels(replace(document, values=np.repeat(document.values[:1], len(motion), axis=0)))
    # bones above the hips stay as in the first frame; the hips are where the motion has them
    above, origin = np.eye(3), positions[0, 0]
    for j in range(1, first + 1):
        above = above @ rotations[0, j - 1]
        origin = origin if j == first else origin + above @ positions[0, j]
    at_hips = motion.root / source.unit
    positions[:, first] = (at_hips - origin) @ above if first else at_hips
    rotations[:, first:] = motion.rotations
    rotations[:, first] = above.T @ rotations[:, first]
    columns, held = [], []
    for j, joint in enumerate(joints):
        order = "".join(name[0] for name in joint.channels if name.endswith("rotation"))
        angles = np.degrees(as_euler(rotations[:, j], order)) if order else np.zeros((len(motion), 0))
        if np.abs(from_euler(order, np.radians(angles)) - rotations[:, j]).max() > 1e-6:
            held.append(joint.name)
        turns = iter(angles.T)
        columns += [positions[:, j, "XYZ".index(name[0])] if name.endswith("position") else next(turns) for name in joint.channels]
    _write(path, document.head, np.stack(columns, axis=1), 1.0 / motion.rate)
    return [f"the whole rotation of {', '.join(held[:5])}, which lack channels for it"] if held else []
