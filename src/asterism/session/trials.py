"""The path of a recording in; the recordings that are asked for poses and markers that it does not show, out."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from asterism import formats
from asterism.errors import AsterismError
from asterism.recording import Recording, is_unnamed

_MOST = 12
"""Files of a folder that are asked whether they show the same person: a folder of a study would take minutes."""


def trials_of(path: Path, named: Sequence[Path] = (), *, without: Sequence[Path] = ()) -> list[Path]:
    """The recordings to ask about the gaps of a file, the same behind every command.

    Those of its format in its folder come first, the nearest by name before the others, at most 12; then at most 12 of the named ones that
    lie elsewhere. The file itself is left out, and those of `without`, which need not exist. Whether they show the same person is not
    known yet (`asterism.motion.gaps.trials_of_person`).
    """
    seen = {_real(one) for one in (path, *without)}
    beside = [one for one in sorted(path.parent.iterdir()) if one.suffix.lower() == path.suffix.lower() and one.is_file()]
    names = [one.name for one in beside]
    place = names.index(path.name) if path.name in names else 0
    near = sorted(beside, key=lambda one: abs(names.index(one.name) - place))
    # so that a file tells the same whichever of its folder are named
    folder = {_real(one) for one in beside}
    found = list[Path]()
    for some in (near, [one for one in named if _real(one) not in folder]):
        new = [one for one in dict.fromkeys(some) if _real(one) not in seen][:_MOST]
        seen.update(map(_real, new))
        found += new
    return found


def read_trials(recording: Recording, paths: Sequence[Path], vertical: ArrayLike | str | None = None) -> list[Recording]:
    """Those of the files that can be read; none where no named marker of a recording has a gap. Kept until a file changes."""
    if not has_gaps(recording):
        return []
    return [one for path in paths if (one := read_trial(path, vertical)) is not None]


def has_gaps(recording: Recording) -> bool:
    """Whether a named marker is missing in some frame."""
    named = [column for column, label in enumerate(recording.labels) if not is_unnamed(label)]
    return not recording.visible[:, named].all()


def read_trial(path: Path, vertical: ArrayLike | str | None = None) -> Recording | None:
    """A recording that tells of another one; None where it cannot be read."""
    axis = vertical if vertical is None or isinstance(vertical, str) else tuple(np.asarray(vertical, dtype=float).tolist())
    try:
        return _read(path, path.stat().st_mtime_ns, axis)
    except (AsterismError, OSError):
        return None


@lru_cache(maxsize=2 * _MOST + 1)
def _read(path: Path, changed: int, vertical: tuple[float, ...] | str | None) -> Recording:
    return formats.read(path, vertical=vertical)


def _real(path: Path) -> str:
    return os.path.realpath(path)
