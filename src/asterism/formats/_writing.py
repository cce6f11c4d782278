"""Shared by writers of text files: a recording in; its points in order, and numbers as text, out."""

from __future__ import annotations

import numpy as np

from asterism.formats._columns import Points
from asterism.recording import Floats, Recording


def all_points(recording: Recording, format: str, *, events: bool = False) -> tuple[Floats, tuple[str, ...], list[str]]:
    """Positions (T, P, 3) m and labels to write, and what `format` cannot carry.

    These are the recording's columns, then the other points of its source (computed ones).
    `events` says whether the format can carry events.
    """
    positions, labels, omitted = recording.positions, list(recording.labels), []
    source = recording.source
    if isinstance(source, Points):
        # A recording of other frames than its source has no place for the source's other points.
        if len(source.positions) == len(positions):
            others = [c for c in range(len(source.labels)) if c not in set(recording.taken)]
            positions = np.concatenate([positions, source.positions[:, others]], axis=1)
            labels += [source.labels[c] for c in others]
    elif source is not None:
        omitted.append(
            f"what {recording.metadata.get('file', 'the source')} holds besides markers and events (analog, computed points, parameters)"
        )
    if recording.events and not events:
        omitted.append(f"{len(recording.events)} events, for which {format} has no place")
    return positions, tuple(labels), omitted


def dense_rows(values: Floats, decimals: int) -> Floats:
    """(T, 3 P) numbers of a text file. A point exactly at zero moves by one last digit, since zeros read as missing."""
    # Adding zero turns -0 into 0, which would be written with its sign.
    values = np.round(values, decimals) + 0.0
    at_zero = (values == 0).all(axis=2)
    if at_zero.any():
        values[at_zero, 0] = 10.0**-decimals
    return values.reshape(len(values), 3 * values.shape[1])


def spelled_numbers(rows: Floats, delimiter: str, decimals: int) -> list[str]:
    """Each row as text, blank where NaN."""
    pattern = delimiter.join([f"%.{decimals}f"] * rows.shape[1])
    texts = [pattern % tuple(row) for row in rows.tolist()]
    return [text.replace("nan", "") if "nan" in text else text for text in texts]
