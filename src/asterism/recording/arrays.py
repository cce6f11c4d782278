"""Shared by all types of this package: array types, the frame rate and the vertical."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError

Floats = NDArray[np.float64]
"""An array of numbers; the docstring that uses it says shape and unit."""

Ints = NDArray[np.int64]
"""An array of whole numbers."""


def as_vertical(vertical: ArrayLike | str) -> Floats:
    """The unit vector that points up, from a vector or an axis name ("z", "-y").

    Raises AsterismError for anything else.

    >>> as_vertical("-y")
    array([ 0., -1.,  0.])
    """
    if isinstance(vertical, str):
        match = re.fullmatch(r"([+-]?)([xyz])", vertical.strip().casefold())
        if not match:
            raise AsterismError(f"vertical {vertical!r} is not an axis; give x, y, z, -x, -y or -z.")
        vector = np.zeros(3)
        vector["xyz".index(match[2])] = -1.0 if match[1] == "-" else 1.0
        return vector
    vector = np.asarray(vertical, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or np.linalg.norm(vector) == 0:
        raise AsterismError("the vertical must be three finite numbers, not all zero; it points up.")
    return vector / np.linalg.norm(vector)


def axis_name(vertical: Floats) -> str:
    """A vertical as --vertical takes it: an axis where it is one, else three numbers.

    >>> axis_name(np.array([0.0, -1.0, 0.0]))
    '-y'
    """
    axis = int(np.abs(vertical).argmax())
    if abs(vertical[axis]) > 1.0 - 1e-6:
        return f"{'-' if vertical[axis] < 0 else ''}{'xyz'[axis]}"
    return ",".join(f"{number:.4g}" for number in vertical)


def nan_quantile(values: Floats, shares: ArrayLike, axis: int) -> Floats:
    """The quantiles along an axis of the values that are there, NaN where none is, one after the other along a new first axis.

    As `numpy.nanquantile`, which, like `numpy.nanmedian`, loads `numpy.ma`: a tenth of the time that a short command takes.
    """
    # Of no values at all none is there.
    if not values.shape[axis]:
        return np.full((np.size(shares), *np.delete(values.shape, axis)), np.nan)
    # Sorting puts NaN last, so that the values that are there come first.
    ordered = np.sort(values, axis=axis)
    missing = np.isnan(values)
    found = []
    if not missing.any():
        # All rows have their quantiles in the same places.
        for share in np.atleast_1d(shares):
            place = share * (values.shape[axis] - 1)
            low = int(place)
            below, above = (ordered.take(at, axis=axis) for at in (low, min(low + 1, values.shape[axis] - 1)))
            found.append(below + (above - below) * (place - low))
        return np.stack(found)
    # At least 0: a row without a value takes its first NaN.
    last = np.maximum((~missing).sum(axis=axis, keepdims=True) - 1, 0)
    for share in np.atleast_1d(shares):
        place = share * last
        low = np.floor(place).astype(np.int64)
        below, above = (np.take_along_axis(ordered, at, axis=axis) for at in (low, np.minimum(low + 1, last)))
        found.append(np.squeeze(below + (above - below) * (place - low), axis=axis))
    return np.stack(found)


def nan_median(values: Floats, axis: int) -> Floats:
    """The median along an axis of the values that are there, NaN where none is."""
    return np.asarray(nan_quantile(values, 0.5, axis)[0])


def nan_mean(values: Floats, axis: int) -> Floats:
    """The mean along an axis of the values that are there, NaN where none is.

    To the last bit what `numpy.nanmean` gives. That one warns where no value is there, and such a warning can be kept back for all threads
    of a program only: `warnings.catch_warnings` of one thread undoes that of another.

    >>> nan_mean(np.array([[1.0, np.nan], [3.0, np.nan]]), axis=0)
    array([ 2., nan])
    """
    missing = np.isnan(values)
    count = (~missing).sum(axis=axis)
    return np.asarray(np.where(missing, 0.0, values).sum(axis=axis) / np.where(count, count, np.nan))


def nan_var(values: Floats, axis: int) -> Floats:
    """The variance along an axis of the values that are there, NaN where none is: `numpy.nanvar` without its warnings, see `nan_mean`.

    >>> nan_var(np.array([[1.0, np.nan], [3.0, np.nan]]), axis=0)
    array([ 1., nan])
    """
    return nan_mean((values - np.expand_dims(nan_mean(values, axis), axis)) ** 2, axis)


def missing_codes(values: NDArray[Any]) -> NDArray[np.bool_]:
    """Which samples are a program's number for "missing", such as -9999 or 9999999: (..., 3) in a file's own unit in, (...) out.

    A code consists of nines, or is an end of the 16-bit integers. It counts where all three coordinates have it, which no measured
    point does to the last bit, or where one coordinate alone is 999999 or more: a kilometre, also in millimetres.
    """
    x, y, z = values[..., 0], values[..., 1], values[..., 2]
    alike = (x == y) & (y == z) & (x != 0)
    # Most recordings have no suspect: two comparisons tell it.
    large = (values >= 999_999) | (values <= -999_999)
    suspect = alike | large.any(axis=-1) if large.any() else alike
    if not suspect.any():
        return np.zeros(suspect.shape, dtype=np.bool_)
    size = np.abs(values[suspect].astype(np.float64))
    some = np.where(np.isfinite(size), size, 0.0)
    # 9999.9 is a code as well: the next power of ten is one unit, or a tenth or less of one, away; to the digits that 32 bits hold.
    gap = 10.0 ** np.ceil(np.log10(np.clip(some, 999.0, 1e300))) - some
    nines = (gap > 0) & (np.abs(gap[..., None] - [1.0, 0.1, 0.01, 0.001]) <= 6e-8 * some[..., None]).any(axis=-1)
    limits = (some == 32767) | (some == 32768)
    coded = np.zeros(suspect.shape, dtype=np.bool_)
    coded[suspect] = (alike[suspect] & (nines | limits).all(axis=-1)) | (nines & (some >= 999_999)).any(axis=-1)
    return coded


def frame_rows(offsets: Ints, cells: Ints) -> tuple[Ints, Ints]:
    """The rows of some cells of a flat array, and the offsets of these cells in an array of only these rows.

    offsets (n + 1,): cell i has the rows offsets[i]:offsets[i + 1]. cells (m,): the cells to take, in order.
    Returns the rows (r,) and the new offsets (m + 1,).
    """
    counts = np.diff(offsets)[cells]
    new = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    # Each cell's rows are consecutive: its start, repeated, and a count within it.
    rows = np.repeat(offsets[cells] - new[:-1], counts) + np.arange(new[-1])
    return rows, new


def check_offsets(offsets: Ints, rows: int, what: str) -> None:
    """Raise AsterismError unless offsets (n + 1,) rise from 0 to the number of rows: kernels read where they say, and ask no more."""
    if len(offsets) < 1 or offsets[0] != 0 or offsets[-1] != rows or (np.diff(offsets) < 0).any():
        raise AsterismError(f"the offsets of {rows} {what} do not rise from 0 to {rows}; give where each frame begins, and their end.")


def same_values(one: object, other: object, names: Iterable[str]) -> bool:
    """Whether two objects of one type have equal attributes of these names; in arrays, NaN equals NaN."""
    return all(_same(getattr(one, name), getattr(other, name)) for name in names)


def _same(one: object, other: object) -> bool:
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        # NaN equals NaN here: two recordings with the same gaps are the same.
        return one.shape == other.shape and bool(((one == other) | ((one != one) & (other != other))).all())
    return type(one) is type(other) and bool(one == other)


def checked_rate(rate: float) -> float:
    """A frame rate as a float. Raises AsterismError where it is not a positive number."""
    if not np.isfinite(rate) or rate <= 0:
        raise AsterismError(f"frame rate {rate} is not a positive number of frames per second; give the right one.")
    return float(rate)
