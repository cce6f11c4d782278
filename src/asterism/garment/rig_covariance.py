"""A calibration in; the covariance of all its camera parameters, as a file that later steps can carry on to points, out."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from asterism.calibration.boards import BoardCalibration
from asterism.cameras.bundle import PARAMETERS
from asterism.errors import AsterismError, guarded_reading
from asterism.files.atomic import write_atomically
from asterism.files.npz import arrays_of_npz
from asterism.files.text import read_bytes
from asterism.recording import Floats

FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class RigCovariance:
    """How exactly a rig is known.

    names   of the cameras
    free    (C, 15) bool: which parameters were adjusted, in the order of `cameras.bundle.PARAMETERS`
    matrix  (n, n) their covariance, row by row of `free`: px, m and rad. The camera without free turns and shifts holds the world
    """

    names: tuple[str, ...]
    free: NDArray[np.bool_]
    matrix: Floats

    def __post_init__(self) -> None:
        if self.free.shape != (len(self.names), len(PARAMETERS)) or self.matrix.shape != (int(self.free.sum()),) * 2:
            raise AsterismError(
                f"{len(self.names)} cameras, free parameters {self.free.shape} and a covariance {self.matrix.shape} do not fit together."
            )

    @classmethod
    def of(cls, made: BoardCalibration) -> RigCovariance:
        """That of a calibration by a board or a coded target."""
        return cls(tuple(camera.name for camera in made.adjustment.cameras), made.adjustment.free, made.adjustment.covariance)

    def save(self, path: str | Path) -> Path:
        """Write an NPZ file with `names`, `parameters`, `free` and `covariance`. Raises AsterismError where it cannot be written."""
        buffer = io.BytesIO()
        stored: dict[str, Any] = {
            "asterism": FORMAT_VERSION,
            "kind": "rig covariance",
            "names": np.array(self.names, dtype=str),
            "parameters": np.array(PARAMETERS, dtype=str),
            "free": self.free,
            "covariance": self.matrix,
        }
        np.savez_compressed(buffer, **stored)
        write_atomically(Path(path), buffer.getvalue())
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> RigCovariance:
        """Read what `save` wrote. Raises AsterismError, naming the file, where it is missing, damaged, of a later version or another's."""
        path = Path(path)
        with guarded_reading(path, "calibrate again with asterism garment calibrate"):
            stored = arrays_of_npz(read_bytes(path))
            if str(stored.get("kind")) != "rig covariance":
                raise AsterismError(f"{path} holds no covariance of a rig; give a file that asterism garment calibrate wrote.")
            if int(stored["asterism"]) > FORMAT_VERSION:
                raise AsterismError(f"{path} was written by a later Asterism; update Asterism.")
            free = np.asarray(stored["free"], dtype=np.bool_)
            return cls(tuple(str(name) for name in stored["names"]), free, np.asarray(stored["covariance"], dtype=np.float64))
