"""A marker set in; a model of virtual people who wear it, made in seconds and kept for the next time, out."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np
import scipy

from asterism.errors import AsterismError
from asterism.files.cache import VARIABLE, cache_folder
from asterism.labelling.marker_model import MarkerModel
from asterism.labelling.training.learning import TrainingConfig, TrainingRules
from asterism.labelling.training.model_file import FORMAT_VERSION
from asterism.labelling.training.train import train_on_virtual_people
from asterism.labelling.training.virtual import VIRTUAL_PEOPLE, check_places
from asterism.progress import Progress
from asterism.recording import MarkerSet
from asterism.skeleton import place_by_name

_SOURCES = ("skeleton", "labelling/body", "labelling/training")
"""Rooms whose sources decide what a model of virtual people is."""


def virtual_model(
    marker_set: str | Path | MarkerSet | Sequence[str], *, people: int = VIRTUAL_PEOPLE, seed: int = 0, progress: Progress | None = None
) -> MarkerModel:
    """A model that needs no labelled file: of virtual people who wear the markers of this set.

    marker_set  one that says where each marker sits (`MarkerSet.places`), or whose names shipped sets know; a shipped one's name, or a file
    people      virtual people who teach it
    seed        other people with another seed

    The first call takes seconds. The model is then kept in `cache_folder`, under a hash of all that it depends on, and read from there. A
    kept file that is damaged is made anew. Where the folder cannot be written, the model is made each time, and a warning says so once.
    `about["virtual_people"]` is the number of people. The same arguments give the same model, bit for bit.
    Raises AsterismError where the set does not say of each marker where it sits, has fewer than four markers, or `people` is below two.
    """
    # A set with the usual names needs no table: what a shipped set calls so sits there.
    worn = place_by_name(MarkerSet.load(marker_set))
    check_places(worn)
    if len(worn) < 4:
        raise AsterismError(f"{worn.title or 'the marker set'} has {len(worn)} markers; four are the fewest that can be told apart.")
    if people < 2:
        raise AsterismError(f"{people} virtual people are no population; give two or more, such as {VIRTUAL_PEOPLE}.")
    config = TrainingConfig(seed, rules=TrainingRules(virtual_people=people))
    path = cache_folder() / "models" / f"virtual-{_key(worn, config)}.model"
    kept = _kept(path, worn)
    if kept is not None:
        return kept
    model = MarkerModel(train_on_virtual_people(worn, config, progress))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        model.save(path)
    except (OSError, AsterismError) as problem:
        # the cause alone: the sentence around it names the file and the mend, as the warning does
        cause = problem if isinstance(problem, OSError) else problem.__cause__ or problem
        _warn_once(str(path.parent), str(getattr(cause, "strerror", None) or cause))
    return model


def _kept(path: Path, worn: MarkerSet) -> MarkerModel | None:
    """The model in this file with the set's own spellings; None where there is none, or it is damaged."""
    try:
        model = MarkerModel.load(path)
    except (AsterismError, OSError):
        return None
    # Aliases do not change what is learned, so that they are not in the key.
    return MarkerModel(replace(model.state, marker_set=worn)) if model.marker_set.names == worn.names else None


def _key(worn: MarkerSet, config: TrainingConfig) -> str:
    """A name for the model that this marker set, configuration, and these sources and libraries give."""
    places = {name: asdict(place) for name, place in worn.places.items()}
    depends = [FORMAT_VERSION, worn.names, places, worn.pairs, config.to_dict(), np.__version__, scipy.__version__]
    return hashlib.sha256(_sources() + json.dumps(depends, sort_keys=True).encode()).hexdigest()[:32]


@cache
def _sources() -> bytes:
    """The digest of the sources and tables that decide what a model of virtual people is."""
    digest = hashlib.sha256()
    package = resources.files("asterism")
    for room in _SOURCES:
        _add_folder(package.joinpath(*room.split("/")), digest)
    return digest.digest()


def _add_folder(folder: Traversable, digest: hashlib._Hash) -> None:
    # The order of a folder's entries is the file system's.
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir() and entry.name != "__pycache__":
            _add_folder(entry, digest)
        elif entry.is_file() and not entry.name.endswith((".pyc", ".nbi", ".nbc")):
            digest.update(entry.name.encode() + entry.read_bytes())


@cache
def _warn_once(folder: str, cause: str) -> None:
    """Say once in a process that models are not kept."""
    warnings.warn(
        f"{folder} cannot be written ({cause}), so the model is made anew each time; name another folder in {VARIABLE}.", stacklevel=4
    )
