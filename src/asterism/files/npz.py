"""The bytes of an NPZ file in, its arrays out: without pickle, and with sizes that the file can hold."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

FREE_BYTES = 256 << 20
"""What a file may unpack to, however small it is."""

MOST_TIMES_PACKED = 60
"""What it may unpack to beyond that, times its own size. Positions pack to a half, with gaps to a tenth; deflate can reach a thousandth."""

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_MOST_MEMBERS = 10_000


def most_unpacked(packed: int) -> int:
    """How many bytes a file of so many bytes may hold."""
    return FREE_BYTES + MOST_TIMES_PACKED * packed


def arrays_of_npz(data: bytes, only: Collection[str] | None = None) -> dict[str, NDArray[Any]]:
    """The arrays in an NPZ file by name; of these only some where they are named.

    Raises ValueError where the file claims more than it can hold, is packed otherwise than NumPy does, or an array is damaged or holds
    objects; and whatever the standard library raises for a damaged archive.
    """
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = archive.infolist()
        # The directory is checked before anything is unpacked.
        if len(members) > _MOST_MEMBERS or sum(member.file_size for member in members) > most_unpacked(len(data)):
            raise ValueError("it claims to hold more than it can")
        if any(member.compress_type not in _METHODS for member in members):
            raise ValueError("it is packed otherwise than NumPy does")
        # NumPy's own names without their ending.
        names = {member.filename.removesuffix(".npy"): member for member in members}
        return {name: _array(archive.read(member)) for name, member in names.items() if only is None or name in only}


def _array(data: bytes) -> NDArray[Any]:
    """One member; its size is checked against its header first."""
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"an array has format version {version}")
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read_header(stream)
    # In Python's integers, which cannot overflow.
    count = 1
    for length in shape:
        count *= int(length)
    # Objects would be unpickled, which runs code.
    if dtype.hasobject or min(shape, default=0) < 0 or count * dtype.itemsize > len(data) - stream.tell():
        raise ValueError("an array in it is longer than its data, or holds objects")
    if dtype.kind not in "biufSU":
        raise ValueError(f"an array in it holds {dtype}")
    # The copy frees the file's bytes.
    values = np.frombuffer(data, dtype, count, stream.tell())
    return np.array(values.reshape(shape, order="F" if fortran else "C"))
