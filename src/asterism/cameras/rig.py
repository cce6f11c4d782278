"""A rig: cameras that share a world frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from asterism.cameras.camera import Camera
from asterism.errors import AsterismError
from asterism.recording import Floats, as_vertical
from asterism.recording.display import Rows, as_html, as_text, listed, significant


@dataclass(frozen=True, repr=False)
class Rig:
    """Cameras in one world frame.

    cameras   in order; names are unique
    vertical  (3,) unit vector, up, or None where it is not known
    metadata  plain values worth keeping: file, format, when and how it was calibrated, residuals, ...
    lacks     what the file that it came from does not say and somebody may miss, one phrase each ("image sizes", "units: metres assumed")
    """

    cameras: tuple[Camera, ...]
    vertical: Floats | None = None
    metadata: dict[str, Any] = field(default_factory=dict)
    lacks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        if not names:
            raise AsterismError("a rig needs at least one camera.")
        if len(set(names)) < len(names):
            twice = next(name for name in names if names.count(name) > 1)
            raise AsterismError(f"two cameras of the rig are called {twice}; rename one.")
        object.__setattr__(self, "cameras", tuple(self.cameras))
        if self.vertical is not None:
            object.__setattr__(self, "vertical", as_vertical(self.vertical))

    def _facts(self) -> Rows:
        posed = sum(camera.posed for camera in self.cameras)
        sizes = sorted({f"{camera.size[0]} x {camera.size[1]}" for camera in self.cameras if camera.size})
        return (
            ("file", str(self.metadata.get("file", ""))),
            ("cameras", listed(self.names)),
            ("with a pose", str(posed) if posed < len(self) else ""),
            ("image sizes", listed(sizes)),
            ("vertical", "" if self.vertical is None else ", ".join(f"{significant(value, 3)}" for value in self.vertical)),
            ("lacks", ", ".join(self.lacks)),
        )

    def __repr__(self) -> str:
        return as_text("Rig", self._facts())

    def _repr_html_(self) -> str:
        return as_html("Rig", self._facts())

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self.cameras)

    def __getitem__(self, which: int | str) -> Camera:
        """A camera by place or by name. Raises AsterismError where no camera has that name."""
        if isinstance(which, str):
            for camera in self.cameras:
                if camera.name == which:
                    return camera
            raise AsterismError(f"the rig has no camera {which}; it has {', '.join(self.names)}.")
        return self.cameras[which]

    @property
    def names(self) -> tuple[str, ...]:
        """Camera names, in order."""
        return tuple(camera.name for camera in self.cameras)

    def select(self, names: tuple[str, ...] | list[str]) -> Rig:
        """The rig with these cameras in this order. Raises AsterismError where a name is absent.

        >>> rig = Rig(tuple(Camera(name, None, (500.0, 500.0), (319.5, 239.5)) for name in ("left", "middle", "right")))
        >>> rig.select(["right", "left"]).names
        ('right', 'left')
        """
        return replace(self, cameras=tuple(self[name] for name in names))

    def project(self, points: ArrayLike) -> Floats:
        """World points (..., 3) m in every camera: (C, ..., 2) px, NaN as `Camera.project` says; image borders do not cut."""
        return np.stack([camera.project(points) for camera in self.cameras])

    def moved(self, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> Rig:
        """The same rig in another world frame: a world point X becomes scale rotation X + translation (3,) m.

        >>> rig = Rig((Camera("c1", None, (500.0, 500.0), (319.5, 239.5)),))
        >>> rig.moved(np.eye(3), [0.0, 0.0, 1.5])["c1"].position
        array([0. , 0. , 1.5])
        """
        r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
        cameras = [
            replace(camera, rotation=camera.rotation @ r.T, translation=scale * camera.translation - camera.rotation @ r.T @ t)
            for camera in self.cameras
        ]
        return replace(self, cameras=tuple(cameras), vertical=None if self.vertical is None else r @ self.vertical)
