"""Points of a garment at each moment in; trajectories by identity, as arrays, as a recording and as a file, out."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.errors import AsterismError, guarded_reading
from asterism.files.atomic import write_atomically
from asterism.files.npz import arrays_of_npz
from asterism.files.text import read_bytes
from asterism.garment.dense.points import DensePoints
from asterism.recording import Floats, Recording, as_vertical

FORMAT_VERSION = 1
_AGAIN = "capture it again with asterism garment capture"


@dataclass(frozen=True, eq=False)
class DenseTrajectories:
    """Where each circle of a garment was, over time.

    ids         (m,) int32 ascending
    positions   (T, m, 3) m, NaN where fewer than two cameras saw a circle or their rays did not fit
    covariance  (T, m, 6) m2, float32: xx, xy, xz, yy, yz, zz, of the centres' errors, not of the rig's
    cameras     (T, m) uint8, how many cameras a position was made from, 0 where there is none
    rate        frames per second
    vertical    (3,) unit vector, up
    """

    ids: NDArray[np.int32]
    positions: Floats
    covariance: NDArray[np.float32]
    cameras: NDArray[np.uint8]
    rate: float
    vertical: Floats = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))

    def __post_init__(self) -> None:
        shape = self.positions.shape[:2]
        if self.positions.shape[1:] != (len(self.ids), 3) or self.covariance.shape != (*shape, 6) or self.cameras.shape != shape:
            raise AsterismError(
                f"{len(self.ids)} identities, positions {self.positions.shape}, covariance {self.covariance.shape} and cameras "
                f"{self.cameras.shape} do not fit together."
            )
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise AsterismError(f"the rate is {self.rate:g}; give frames per second.")

    def __len__(self) -> int:
        return len(self.positions)

    def covariances(self, frame: int) -> Floats:
        """(m, 3, 3) m2 of one frame, NaN where there is no position."""
        return np.asarray(self.covariance[frame], dtype=np.float64)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)

    def points(self, frame: int) -> DensePoints:
        """The points of one frame, for `garment.surface`; what they were made from is not known any more."""
        there = np.isfinite(self.positions[frame, :, 0])
        number, none = int(there.sum()), np.empty((0, 2), dtype=np.int64)
        # What the points were made from was not kept: their misfits are unknown and their scale is in the covariance.
        return DensePoints(
            self.ids[there], self.positions[frame, there], self.covariances(frame)[there], self.cameras[frame, there].astype(np.int64),
            np.full(number, np.nan), 1.0, number, none, none, np.empty(0, dtype=np.int64),
        )  # fmt: skip

    def recording(self) -> Recording:
        """The same as a recording, circle 4711 with the label g4711: for everything that takes labelled trajectories."""
        return Recording(self.positions, tuple(f"g{number}" for number in self.ids.tolist()), self.rate, self.vertical)

    def save(self, path: str | Path) -> Path:
        """Write an NPZ file, which `asterism.read` takes as a recording, too. Returns its path.

        It holds `ids`, `positions`, `covariance`, `cameras`, `rate` and `vertical`. Raises AsterismError where it cannot be written.
        """
        path = Path(path)
        buffer = io.BytesIO()
        stored: dict[str, Any] = {
            "asterism": 1,
            "kind": "recording",
            "garment": FORMAT_VERSION,
            "positions": self.positions,
            "labels": np.array([f"g{number}" for number in self.ids.tolist()], dtype=str).reshape(len(self.ids)),
            "rate": self.rate,
            "vertical": self.vertical,
            "notes": "{}",
            "ids": self.ids,
            "covariance": self.covariance,
            "cameras": self.cameras,
        }
        np.savez_compressed(buffer, **stored)
        write_atomically(path, buffer.getvalue())
        return path

    @classmethod
    def load(cls, path: str | Path) -> DenseTrajectories:
        """Read what `save` wrote. Raises AsterismError, naming the file, where it is missing, damaged, of a later version or another's."""
        path = Path(path)
        with guarded_reading(path, _AGAIN):
            stored = arrays_of_npz(read_bytes(path))
            if "garment" not in stored:
                raise AsterismError(f"{path} holds no trajectories of a garment; give a file that asterism garment capture wrote.")
            if int(stored["garment"]) > FORMAT_VERSION:
                raise AsterismError(f"{path} was written by a later Asterism; update Asterism.")
            return cls(
                np.asarray(stored["ids"], dtype=np.int32), np.asarray(stored["positions"], dtype=np.float64),
                np.asarray(stored["covariance"], dtype=np.float32), np.asarray(stored["cameras"], dtype=np.uint8),
                float(stored["rate"]), as_vertical(stored["vertical"]),
            )  # fmt: skip


def dense_trajectories(frames: Sequence[DensePoints], rate: float, vertical: Floats | None = None) -> DenseTrajectories:
    """The trajectories of all identities that occur in any frame. Raises AsterismError where the rate is none."""
    ids = np.unique(np.concatenate([np.empty(0, dtype=np.int32), *(frame.ids for frame in frames)])).astype(np.int32)
    positions = np.full((len(frames), len(ids), 3), np.nan)
    covariance = np.full((len(frames), len(ids), 6), np.nan, dtype=np.float32)
    cameras = np.zeros((len(frames), len(ids)), dtype=np.uint8)
    # Identities differ from frame to frame, so each frame goes into its own columns.
    for t, frame in enumerate(frames):
        at = np.searchsorted(ids, frame.ids)
        positions[t, at] = frame.positions
        covariance[t, at] = frame.covariance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
        cameras[t, at] = np.minimum(frame.cameras, 255)
    return DenseTrajectories(ids, positions, covariance, cameras, rate, np.array([0.0, 0.0, 1.0]) if vertical is None else vertical)
