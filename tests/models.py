"""Trained models that tests share: trained once, and kept on disk for the other workers and for the next run."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
import scipy

import asterism
from asterism import labelling
from asterism.labelling import CapturabilityRules, TrainingRules
from asterism.labelling.partial.solver_search import SearchSettings
from asterism.labelling.training.trials import TrainingTrial

BRIEF = TrainingRules(
    virtual_people=0,
    trial_frames=8,
    folds=2,
    trials=(TrainingTrial(), TrainingTrial(0.2), TrainingTrial(0.2, 3)),
    time_trials=(TrainingTrial(0.2),),
    stretches=1,
    stretch_frames=30,
)
"""Training that tries its model on little, so that its confidence is low: for tests of what is learned, not of what is labelled."""

SHORT = TrainingRules(
    virtual_people=0,
    folds=2,
    trial_frames=30,
    trials=(TrainingTrial(), TrainingTrial(0.2), TrainingTrial(0.34), TrainingTrial(0.2, 3), TrainingTrial(0.2, clutter=3.0, spread=0.03)),
    stretches=1,
    stretch_frames=100,
)
"""Training that tries its model in fewer trials of each kind than the default one, in a third of its time: what `trained` uses."""

BRIEF_EXAMINATION = CapturabilityRules(
    search=SearchSettings(
        screening_frames=60,
        evaluation_frames=200,
        validation_frames=200,
        beam_width=15,
        max_markers=5,
        max_solvers=15,
        coverage_patterns=500,
        max_classifiers=100,
    ),
    change_frames=60,
    hardest=1,
    targets=(0.99, 0.99999),
)
"""A marker set examined with few partial solvers, and few changes of it tried: for tests of what is shown, not of what is found."""

_WAIT = 300.0
"""Seconds after which another process's lock is taken for one that was left behind."""
_UNUSED = 30 * 86_400.0
"""Seconds after which a model that nobody took is removed."""


def trained(recordings: Sequence[asterism.Recording], **settings: Any) -> asterism.MarkerModel:
    """What `MarkerModel.fit(recordings, **settings)` gives, read back from a file; from the disk where the same sources have trained it.

    Training is `SHORT` by default. A test of training itself calls `MarkerModel.fit`.
    """
    settings = {"training": SHORT, **settings}
    path = folder() / f"{_key(recordings, settings)}.model"
    if path.exists():
        os.utime(path)
    else:
        with _locked(path.with_suffix(".lock")):
            if not path.exists():
                _save(asterism.MarkerModel.fit(list(recordings), **settings), path)
    return asterism.MarkerModel.load(path)


@contextmanager
def training_with(rules: TrainingRules) -> Iterator[None]:
    """Whoever calls `MarkerModel.fit` here, a command for example, trains with these rules."""
    plain = asterism.MarkerModel.fit
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(asterism.MarkerModel, "fit", lambda recordings, **given: plain(recordings, **{**given, "training": rules}))
        yield


@contextmanager
def examining_briefly() -> Iterator[None]:
    """Whoever calls `labelling.capturability` here examines by `BRIEF_EXAMINATION`."""
    plain = labelling.capturability
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(labelling, "capturability", lambda recordings, **given: plain(recordings, **{"rules": BRIEF_EXAMINATION, **given}))
        yield


def folder() -> Path:
    """Where the models are kept: `ASTERISM_TEST_CACHE`, or a folder in the user's cache."""
    chosen = os.environ.get("ASTERISM_TEST_CACHE")
    if chosen:
        place = Path(chosen)
    elif sys.platform == "win32":
        place = Path(os.environ.get("LOCALAPPDATA", tempfile.gettempdir())) / "asterism-tests"
    else:
        place = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "asterism-tests"
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError:
        place = Path(tempfile.gettempdir()) / "asterism-tests"
        place.mkdir(exist_ok=True)
    return place


def _save(model: asterism.MarkerModel, path: Path) -> None:
    """Write under another name, then rename: nobody reads half a model."""
    part = path.with_suffix(f".{os.getpid()}")
    model.save(part)
    part.replace(path)
    for other in path.parent.glob("*.model"):
        with suppress(FileNotFoundError):  # another worker was faster
            if time.time() - other.stat().st_mtime > _UNUSED:
                other.unlink()


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """One process at a time."""
    while True:
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL))
            break
        except (FileExistsError, PermissionError):  # Windows: the other is just removing it
            try:
                if time.time() - path.stat().st_mtime > _WAIT:
                    path.unlink(missing_ok=True)
            except FileNotFoundError:
                pass
            time.sleep(0.05)
    try:
        yield
    finally:
        path.unlink(missing_ok=True)


def _key(recordings: Sequence[asterism.Recording], settings: dict[str, Any]) -> str:
    """A name for the model that these recordings, settings, sources and libraries give."""
    digest = hashlib.sha256(_sources())
    digest.update(repr(sorted(settings.items())).encode())
    for recording in recordings:
        for name, value in sorted(vars(recording).items()):
            if isinstance(value, np.ndarray):
                digest.update(f"{name} {value.dtype} {value.shape}".encode() + np.ascontiguousarray(value).tobytes())
            elif isinstance(value, str | int | float | tuple):
                digest.update(f"{name} {value!r}".encode())
    return digest.hexdigest()[:32]


_AFTER = "labelling/live"
"""What labels a stream: no training runs it, though `MarkerModel.stream` imports it. `tests/test_learn.py` holds that nothing else does."""
_IMPORTS = re.compile(r"^[ \t]*(?:from|import)[ \t]+(asterism[\w.]*)(?:[ \t]+import[ \t]+(\([^)]*\)|[^\n]*))?", re.MULTILINE)


def _sources() -> bytes:
    """The digest of all that can change a model: the modules that training imports.

    A model of an older form of the file, or of other training, has another key: none is ever taken for a new one. What comes after
    training (streams, reviews, commands, pages) leaves kept models alone.
    """
    return sources(Path(asterism.__file__).parent / "labelling" / "marker_model.py")


@cache
def sources(start: Path) -> bytes:
    """The digest of a source and of the modules that it imports, directly or not, without lines of comment, and of the libraries."""
    package = Path(asterism.__file__).parent
    versions = (np.__version__, scipy.__version__, numba.__version__, platform.machine(), sys.version_info[:2])
    digest = hashlib.sha256(repr(versions).encode())
    for source in sorted(_reached(package, start)):
        lines = source.read_text(encoding="utf-8").splitlines()
        digest.update(os.path.relpath(source, package).replace(os.sep, "/").encode())
        digest.update("\n".join(line for line in lines if not line.lstrip().startswith("#")).encode())
    return digest.digest()


def _reached(package: Path, start: Path) -> set[Path]:
    """The sources that a source imports, and those that these import, itself included; `_AFTER` left out."""
    reached, waiting, after = {start}, [start], package / _AFTER
    while waiting:
        text = waiting.pop().read_text(encoding="utf-8")
        for origin, names in _IMPORTS.findall(text):
            base = package.joinpath(*origin.split(".")[1:])
            for place in (base, *(base / name for name in re.findall(r"\w+", names))):
                for source in (place.with_suffix(".py"), place / "__init__.py"):
                    if source.is_file() and source not in reached and after not in source.parents:
                        reached.add(source)
                        waiting.append(source)
    return reached
