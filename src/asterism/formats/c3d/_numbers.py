"""Numbers as the three processors of C3D files store them: bytes or 16/32-bit words in, NumPy arrays out, and back.

The format knows three: PC (84, little-endian IEEE), DEC (85, little-endian integers, VAX F floats) and SGI/MIPS (86, big-endian
IEEE). A VAX F float keeps its two 16-bit halves in the other order and has an exponent that is larger by two.
Source: the public C3D format specification, "Processor type" and "Floating-point format".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Words = NDArray[Any]
"""Raw 16-bit or 32-bit unsigned words in native order: bit patterns, not values."""


@dataclass(frozen=True)
class Processor:
    """One way to store numbers: `code` as the file states it, `order` "<" or ">", `vax` for VAX F floats."""

    code: int
    name: str
    order: Literal["<", ">"]
    vax: bool = False

    def words16(self, raw: bytes | bytearray | memoryview, count: int = -1, offset: int = 0) -> Words:
        """16-bit patterns, native order."""
        return np.frombuffer(raw, dtype=f"{self.order}u2", count=count, offset=offset).astype(np.uint16, copy=False)

    def words32(self, raw: bytes | bytearray | memoryview, count: int = -1, offset: int = 0) -> Words:
        """32-bit patterns, native order, VAX floats in the order in which they lie in the file."""
        return np.frombuffer(raw, dtype=f"{self.order}u4", count=count, offset=offset).astype(np.uint32, copy=False)

    def integers(self, words: Words) -> NDArray[np.int16]:
        """Signed values of 16-bit patterns."""
        return words.view(np.int16)

    def floats(self, words: Words) -> NDArray[np.floating[Any]]:
        """Values of 32-bit patterns: float32, or float64 for VAX floats, whose range float32 does not hold."""
        if not self.vax:
            return words.view(np.float32)
        # The two halves of a VAX float are exchanged.
        bits = (words << np.uint32(16)) | (words >> np.uint32(16))
        exponent = ((bits >> np.uint32(23)) & np.uint32(0xFF)).astype(np.int32)
        mantissa = ((bits & np.uint32(0x7FFFFF)) | np.uint32(0x800000)).astype(np.float64)
        # An exponent of 0 is 0, whatever the mantissa says.
        values = np.where(exponent == 0, 0.0, np.ldexp(mantissa, exponent - 129 - 23))
        return np.where(bits >> np.uint32(31), -values, values)

    def words_of_floats(self, values: ArrayLike) -> Words:
        # float32 is what the format holds; rounding happens once, here.
        """32-bit patterns of values, rounded to what 32 bits hold."""
        single = np.ascontiguousarray(values, dtype=np.float32)
        bits = single.view(np.uint32)
        if not self.vax:
            return bits.copy()
        exponent = (bits >> np.uint32(23)) & np.uint32(0xFF)
        # The exponent is larger by two; 0 stays 0.
        bits = np.where(exponent == 0, np.uint32(0), bits + np.uint32(2 << 23))
        return (bits << np.uint32(16)) | (bits >> np.uint32(16))

    def words_of_integers(self, values: ArrayLike) -> Words:
        """16-bit patterns of signed values."""
        return np.ascontiguousarray(values, dtype=np.int16).view(np.uint16).copy()

    def store(self, words: Words) -> bytes:
        """The bytes of 16-bit or 32-bit patterns."""
        return words.astype(words.dtype.newbyteorder(self.order)).tobytes()

    def float_at(self, raw: bytes | bytearray, offset: int) -> float:
        """One float; 0 where the bytes end before."""
        return float(self.floats(self.words32(raw, 1, offset))[0]) if offset + 4 <= len(raw) else 0.0

    def unsigned_at(self, raw: bytes | bytearray, offset: int) -> int:
        """One unsigned 16-bit integer; 0 where the bytes end before."""
        return self.unsigned_of(raw[offset : offset + 2]) if offset + 2 <= len(raw) else 0

    def unsigned_of(self, two: bytes | bytearray) -> int:
        """Two bytes as an unsigned integer."""
        return int.from_bytes(two, "little" if self.order == "<" else "big")

    def bytes_of_unsigned(self, value: int) -> bytes:
        """One unsigned 16-bit integer as bytes."""
        return value.to_bytes(2, "little" if self.order == "<" else "big")


PC = Processor(84, "PC", "<")
DEC = Processor(85, "DEC", "<", vax=True)
SGI = Processor(86, "SGI", ">")
PROCESSORS = {processor.code: processor for processor in (PC, DEC, SGI)}
