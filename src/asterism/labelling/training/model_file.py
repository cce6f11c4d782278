"""Plain arrays and a head in; one model file out, and back: an NPZ without pickle, damage refused with a sentence."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from asterism.errors import AsterismError, cause_of, refuse_special
from asterism.files.atomic import write_atomically
from asterism.files.npz import arrays_of_npz
from asterism.labelling.training.model_schema import check_contents

FORMAT = "asterism-model"
FORMAT_VERSION = 3
"""1 kept no sample of the training, 2 does, 3 may start from virtual people."""

VIRTUAL_SINCE = 3
"""From this version on a model without a sample is one of virtual people."""

Contents = tuple[dict[str, Any], dict[str, Any]]


def write_arrays(path: str | os.PathLike[str], head: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write a model under a temporary name, then rename it. Raises AsterismError where the place cannot be written."""
    path = Path(path)
    text = json.dumps({"format": FORMAT, "version": FORMAT_VERSION, **head})
    packed = io.BytesIO()
    # The head is JSON in an array of bytes: plain text needs no pickle.
    np.savez_compressed(packed, allow_pickle=False, head=np.frombuffer(text.encode(), dtype=np.uint8), **arrays)
    write_atomically(path, packed.getvalue())


def describe_model(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a model was trained on, in plain values, without what it learned. Raises AsterismError as `reading` does."""
    with reading(path) as (head, _):
        about = dict(head["about"])
        content: dict[str, Any] = {"format": "Asterism model", "version": head["version"], "markers": list(head["marker_set"]["names"])}
        return {**content, "partial_solvers": {}, **about}


@contextmanager
def reading(path: str | os.PathLike[str]) -> Iterator[Contents]:
    """The head and the arrays of a model file, for as long as something is made of them.

    Raises AsterismError where the file is missing, no model, of a later version or damaged. Any other error inside
    the `with` block counts as damage: the caller could not use what the file holds.
    """
    path = Path(path)
    if path.is_dir():
        raise AsterismError(f"{path} is a folder; name the model's file in it.")
    refuse_special(path)
    if not path.is_file():
        raise AsterismError(f"{path} does not exist; train a model first (asterism train), or check the path.")
    try:
        # Sizes are checked against the file's before anything is unpacked.
        arrays = arrays_of_npz(path.read_bytes())
        head = json.loads(arrays.pop("head").tobytes().decode())
        if not isinstance(head, dict) or head["format"] != FORMAT:
            raise AsterismError(f"{path} is no Asterism model; train one with asterism train.")
        if head["version"] > FORMAT_VERSION:
            raise AsterismError(f"{path} was written by a later Asterism (model format {head['version']}); update Asterism.")
        # Contents are checked before objects are made of them, so that a message can name the entry.
        check_contents(head, arrays)
        yield head, arrays
    except AsterismError as problem:
        if path.name in str(problem):
            raise
        raise AsterismError(f"{path}: {problem}") from problem
    except Exception as problem:  # a damaged archive raises anything from zlib.error to SyntaxError
        raise AsterismError(f"{path} is damaged or no Asterism model ({cause_of(problem)}); train it again.") from problem
