"""A C3D file and new parameters in; a new file whose data block is still to be filled, all pointers right, out."""

from __future__ import annotations

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.c3d._edit import with_number
from asterism.formats.c3d._file import C3DFile
from asterism.formats.c3d._layout import BLOCK, LIMIT
from asterism.formats.c3d._numbers import Words
from asterism.formats.c3d._parameters import Parameters, Record


def assembled(
    file: C3DFile, parameters: Parameters, width: int, points: int, rate: float | None, *, real: bool = False
) -> tuple[bytearray, Words]:
    """A new file with header, parameters and what follows the data, pointers updated; and its data block, to be filled: (frames, width).

    The block's words are in the file's byte order; real: they are of real numbers, also where those of the file are integers.
    """
    raw, start, kind = file.raw, file.layout.start, np.dtype(np.uint32) if real else file.point_words.dtype
    begin, size = min(file.header.parameters_at, start), file.layout.frames * width * kind.itemsize
    section, shift = raw[begin:start], 0
    tail, tail_shift = tail_of(file, size - (file.layout.stop - start), parameters is not file.parameters)
    # Changed parameters, or data of another length, move what comes behind.
    if parameters is not file.parameters or tail_shift:
        if begin == start:
            raise AsterismError(
                f"{file.path} keeps its parameters behind its data, so its points cannot be renamed; export it again first."
            )
        section, shift = _fitted_section(file, parameters, tail_shift)
    head = bytearray(raw[:begin])
    processor = file.processor
    # A wrong count that agrees with the data is left: the file stays as it was.
    if points != file.header.points and points != file.layout.points:
        head[2:4] = processor.bytes_of_unsigned(points)
    # The header counts blocks of 512 bytes from 1.
    if shift:
        head[16:18] = processor.bytes_of_unsigned(start // BLOCK + 1 + shift)
    if rate is not None:
        head[20:24] = processor.store(processor.words_of_floats([rate]))
    at = len(head) + len(section)
    data = bytearray(at + size + len(tail))
    data[: len(head)], data[len(head) : at], data[at + size :] = head, section, tail
    words = np.frombuffer(data, dtype=kind.newbyteorder(processor.order), count=file.layout.frames * width, offset=at)
    return data, words.reshape(file.layout.frames, width)


def tail_of(file: C3DFile, growth: int, changed: bool = True) -> tuple[bytes, int]:
    """What follows the data, with padding up to a whole block before it; and by how many blocks it moves.

    changed: whether anything else in the file does.
    """
    tail = bytes(file.raw[file.layout.stop :])
    # Behind more frames than 16 bits count, other readers take padding for frames.
    if (growth or changed) and file.layout.frames >= LIMIT and len(tail) <= BLOCK and not any(tail):
        return b"", 0
    if not growth:
        return tail, 0
    # The piece of a frame at which a file breaks off would count as whole frames where frames have become smaller.
    if file.layout.cut:
        return b"", 0
    # Padding behind the data carries nothing, whatever a program left in it: it only has to end the last block.
    before, after = -file.layout.stop % BLOCK, -(file.layout.stop + growth) % BLOCK
    if len(tail) <= before or (len(tail) <= BLOCK and not any(tail)):
        return (bytes(after) if len(file.raw) % BLOCK == 0 else tail), 0
    return bytes(after) + tail[before:], (growth + after - before) // BLOCK


def _fitted_section(file: C3DFile, parameters: Parameters, tail_shift: int) -> tuple[bytes, int]:
    """The parameter section in whole blocks, and by how many blocks it has grown."""
    start = file.layout.start
    room = start - file.header.parameters_at
    # A parameter that the data cut short must end before another can follow.
    parameters = parameters.repaired()
    # Rounded up to whole blocks, as the format has it.
    blocks = -(-len(parameters.to_bytes()) // BLOCK)
    shift = max(0, blocks - room // BLOCK)
    changes: dict[tuple[str, str], Record | None] = {}
    for group in parameters.groups:
        block = parameters.count(group, "DATA_START")
        # Behind 32 MB, pointers to what follows the data are wrapped round 16 bits.
        if block is not None and group != "POINT":
            behind = block + max(0, -(-(file.layout.stop // BLOCK + 1 - block) // (LIMIT + 1))) * (LIMIT + 1)
            block = behind if (behind - 1) * BLOCK < len(file.raw) else block
        # Only pointers at or behind the data move with them.
        if block is not None and block >= start // BLOCK + 1 and (shift or (tail_shift and block > start // BLOCK + 1)):
            moved = block + shift + (tail_shift if block > start // BLOCK + 1 else 0)
            changes[group, "DATA_START"] = with_number(parameters, group, "DATA_START", moved)
    parameters = parameters.replaced(changes)
    section = parameters.to_bytes()
    counted = section[2] + shift if section[2] else 0
    # The count has one byte: longer sections are found by the header's pointer.
    section = section[:2] + bytes([min(counted, 255)]) + section[3:]
    return section.ljust(room + shift * BLOCK, b"\0"), shift
