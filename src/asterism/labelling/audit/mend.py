"""Labelled recordings and their wrong labels in; the recordings with the labels put right out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count as count_from
from itertools import islice

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.labelling.audit.errors import ALWAYS, EXCHANGED, JUMP, LabelError
from asterism.recording import Floats, Ints, Recording


def mend_errors(
    recording: Recording, errors: Sequence[LabelError], columns: Mapping[str, int] | None = None
) -> tuple[Recording, list[LabelError]]:
    """The recording with wrong labels put right, and the errors that were mended.

    errors   of this recording, frames counted from 0
    columns  the column of each marker that the errors name; by default that with the marker's name as label

    Two labels that are exchanged are exchanged back. Among more labels each sample gets the label whose path it continues at the beginning
    and the end of the frames; where neither is seen, they stay. The samples of a jump lose their label: they become columns *1, *2, ....
    Hints mend nothing. O(frames) for each error.
    """
    place = {label: column for column, label in enumerate(recording.labels)} if columns is None else columns
    origin = np.full(recording.visible.shape, -1, dtype=np.int64) if recording.origin is None else recording.origin.copy()
    positions, mended = recording.positions.copy(), []
    for error in errors:
        frames = slice(error.first_frame, error.last_frame + 1)
        own = np.array([place[name] for name in error.markers], dtype=np.int64)
        order = _order(error, positions, frames, own)
        if order is None:
            continue
        # Origins move along, so that the file is written with each sample in its own column.
        positions[frames, own], origin[frames, own] = positions[frames, own[order]], origin[frames, own[order]]
        mended.append(error)
    # Jumps come after the exchanges: they are frames of the corrected columns.
    jumped = [error for error in errors if error.kind == JUMP]
    apart, apart_origin = np.full((len(positions), len(jumped), 3), np.nan), np.full((len(positions), len(jumped)), -1, dtype=np.int64)
    for i, error in enumerate(jumped):
        frames, column = slice(error.first_frame, error.last_frame + 1), place[error.markers[0]]
        # The samples stay in the file as points without a name: nothing that was measured is lost.
        apart[frames, i], apart_origin[frames, i] = positions[frames, column], origin[frames, column]
        positions[frames, column], origin[frames, column] = np.nan, -1
    if not mended and not jumped:
        return recording, []
    result = replace(
        recording,
        positions=np.concatenate([positions, apart], axis=1),
        labels=(*recording.labels, *_free_numbers(recording.labels, len(jumped))),
        origin=None if recording.origin is None else np.concatenate([origin, apart_origin], axis=1),
    )
    return result, [*mended, *jumped]


def _order(error: LabelError, positions: Floats, frames: slice, own: Ints) -> Ints | None:
    """Whose sample each of the columns `own` gets in these frames, as places in `own`; None where that is not known."""
    if error.kind not in (EXCHANGED, ALWAYS):
        return None
    # Two exchanged labels have one other order only.
    if len(own) == 2:
        return np.array([1, 0])
    cost = np.zeros((len(own), len(own)))
    seen = False
    # The frames just outside say whose path each sample continues.
    for inside, outside in ((frames.start, frames.start - 1), (frames.stop - 1, frames.stop)):
        if 0 <= outside < len(positions):
            apart = np.linalg.norm(positions[outside, own][:, None] - positions[inside, own][None], axis=2)
            seen |= bool(np.isfinite(apart).all())
            cost += np.nan_to_num(apart)
    order = linear_sum_assignment(cost)[1]
    # The order as it stands mends nothing, and without an end that is seen it would be a guess.
    return np.asarray(order) if seen and (order != np.arange(len(own))).any() else None


def _free_numbers(labels: Sequence[str], count: int) -> list[str]:
    """Names *1, *2, ... that no label has."""
    taken = set(labels)
    return list(islice((name for number in count_from(1) if (name := f"*{number}") not in taken), count))
