"""One exam for everything that learns: `check_learner`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from asterism import AsterismError, Recording


@dataclass(frozen=True)
class Learner:
    """A class that learns from recordings, as the exam sees it.

    fit      learns from recordings
    answers  what it says of a recording, as arrays; the same learner gives the same arrays
    frames   of these arrays, those that have one row per frame, each frame answered by itself
    save, load  write it and read it back, where it can be kept
    """

    name: str
    kind: type
    fit: Callable[[Sequence[Recording]], Any]
    answers: Callable[[Any, Recording], Sequence[np.ndarray]]
    frames: bool = True
    save: Callable[[Any, Path], Any] | None = None
    load: Callable[[Path], Any] | None = None


def check_learner(learner: Learner, recordings: Sequence[Recording], other: Sequence[Recording], unseen: Recording, folder: Path) -> None:
    """Unfitted use, input that stays untouched, refit, subset of frames, no state between calls, save and load, nothing to learn from.

    `other` are recordings from which something else must be learned; `unseen` is what is answered.
    """
    check_unfitted(learner)
    before = [recording.positions.copy() for recording in recordings]
    one = learner.fit(recordings)
    for recording, positions in zip(recordings, before, strict=True):
        np.testing.assert_array_equal(recording.positions, positions, err_msg=f"{learner.name}: fit changed its input")
    asked = unseen.positions.copy()
    first = learner.answers(one, unseen)
    np.testing.assert_array_equal(unseen.positions, asked, err_msg=f"{learner.name}: answering changed its input")
    assert_equal(first, learner.answers(one, unseen), f"{learner.name}: the second answer differs from the first")
    assert_equal(first, learner.answers(learner.fit(recordings), unseen), f"{learner.name}: the same recordings teach something else")
    different = learner.answers(learner.fit(other), unseen)
    assert any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(first, different, strict=True)), f"{learner.name} learns nothing"
    assert_equal(first, learner.answers(one, unseen), f"{learner.name}: another fit changed this one")
    if learner.frames:
        check_subset(learner, one, unseen, first)
    if learner.save is not None and learner.load is not None:
        learner.save(one, folder / "learner")
        assert_equal(first, learner.answers(learner.load(folder / "learner"), unseen), f"{learner.name}: read back it answers differently")
    with pytest.raises(AsterismError, match=r"; "):
        learner.fit([])


def check_unfitted(learner: Learner) -> None:
    """There is no unfitted learner: without what was learned it cannot be made, so no answer comes from nothing."""
    with pytest.raises(TypeError, match="missing"):
        learner.kind()


def check_subset(learner: Learner, fitted: Any, unseen: Recording, whole: Sequence[np.ndarray]) -> None:
    """A frame's answer depends on that frame alone: some of the frames are answered as in the whole, also none."""
    for some in (slice(3, 11), slice(0, 1), slice(0, 0)):
        part = learner.answers(fitted, unseen.frames(some))
        assert_equal(part, [answer[some] for answer in whole], f"{learner.name}: frames {some} are answered differently alone")


def assert_equal(one: Sequence[np.ndarray], two: Sequence[np.ndarray], message: str) -> None:
    """All arrays equal, bit for bit."""
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=message)
