"""Files in, recordings out and back: C3D, TRC, CSV, QTM's TSV and MAT, MOT and STO, NPZ; chosen by content and suffix. Blobs as 2D CSV."""

from __future__ import annotations

from asterism.formats._dispatch import (
    check_suffix,
    convert,
    describe,
    is_recording_file,
    read,
    read_clouds,
    read_evidence,
    write,
    write_points,
)
from asterism.formats.csv_blobs import read_blobs, write_blobs
from asterism.formats.storage import Table, read_table, write_table

__all__ = [
    "Table",
    "check_suffix",
    "convert",
    "describe",
    "is_recording_file",
    "read",
    "read_blobs",
    "read_clouds",
    "read_evidence",
    "read_table",
    "write",
    "write_blobs",
    "write_points",
    "write_table",
]
