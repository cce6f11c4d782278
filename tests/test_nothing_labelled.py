"""A recording that shows nothing of the model's body is never ready; one that shows the body for a while is."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from correcting import model, walks

import asterism
from asterism.findings import exit_status
from asterism.labelling.correction.readiness import DO_NOT_USE, LOOK, READY
from asterism.recording import Clouds, Floats
from asterism.recording.verdict import CERTAIN, FITS, UNKNOWN
from asterism.session import LabelledFile, LabellingOptions, label_file

FRAMES = 100
Frames = list[Floats]


def labelled(folder: Path, frames: Frames, frame_wise: bool = False) -> LabelledFile:
    """What `asterism label` finds of points (n, 3) m in each frame, z up."""
    from asterism.session import LabellingSettings

    asterism.write(folder / "points.npz", Clouds.from_points(frames, rate=100.0, vertical="z"))
    return label_file(folder / "points.npz", model(), LabellingOptions(settings=LabellingSettings(frame_wise=frame_wise)))


def walker() -> Floats:
    return walks()[4].positions[:FRAMES]


def somewhere(points: int, moving: bool = True) -> Floats:
    """Points (FRAMES, points, 3) in a room, in each frame anywhere or always at the same places."""
    rng = np.random.default_rng(points)
    return np.broadcast_to(
        rng.uniform([-2.0, -2.0, 0.0], [2.0, 2.0, 2.0], (FRAMES if moving else 1, points, 3)), (FRAMES, points, 3)
    ).copy()


def carried(points: int, size: float) -> Floats:
    """A rigid object that is turned and carried."""
    shape = np.random.default_rng(points).normal(0.0, size, (points, 3))
    angle, along = np.linspace(0.0, 1.5, FRAMES), np.linspace(0.0, 1.5, FRAMES)
    turn = np.zeros((FRAMES, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angle)
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = -np.sin(angle), np.sin(angle), 1.0
    return np.einsum("fij,nj->fni", turn, shape) + np.stack([along, 0.0 * along, 1.0 + 0.0 * along], axis=1)[:, None]


def together(*parts: Floats) -> Frames:
    return list(np.concatenate(parts, axis=1))


NOTHING: dict[str, Callable[[], Frames]] = {
    "30 random points": lambda: list(np.random.default_rng(0).normal(size=(FRAMES, 30, 3))),
    "as many points as markers": lambda: list(somewhere(15)),
    "one still point": lambda: list(np.tile([0.5, 0.5, 1.0], (FRAMES, 1, 1))),
    "two still points": lambda: list(somewhere(2, moving=False)),
    "still points": lambda: list(somewhere(30, moving=False)),
    "all points in one place": lambda: list(np.tile([0.0, 0.0, 1.0], (FRAMES, 15, 1))),
    "each marker twice": lambda: together(walker(), walker()),
    "each marker twice, nearly": lambda: together(walker(), walker() + 0.0005),
    "a third of a person's size": lambda: list(0.33 * walker()),
}


@pytest.mark.parametrize("case", [pytest.param(name, marks=pytest.mark.slow) if "nearly" in name else name for name in NOTHING])
def test_a_recording_without_a_label_is_not_to_be_used(case: str, tmp_path: Path) -> None:
    found = labelled(tmp_path, NOTHING[case]()[:50])
    assert not (found.labelling.indices >= 0).any()
    assert found.readiness.kind == DO_NOT_USE and "no label was given" in found.readiness.sentence
    assert found.verdict is not None and not found.verdict.fits
    assert "label-nothing" in {finding.code for finding in found.findings}


@pytest.mark.parametrize(
    ("points", "size"),
    [(4, 0.05), pytest.param(6, 0.3, marks=pytest.mark.slow), (8, 0.3), (15, 0.3), pytest.param(40, 0.3, marks=pytest.mark.slow)],
)
def test_a_prop_is_no_body_that_fits(points: int, size: float, tmp_path: Path) -> None:
    """Some of its points may lie as markers do; nothing says that they are these."""
    found = labelled(tmp_path, list(carried(points, size)[::2]))
    assert found.readiness.kind != READY
    assert found.verdict is not None and not found.verdict.fits
    assert found.labelling.confidence[found.labelling.indices >= 0].max(initial=0.0) <= CERTAIN
    assert exit_status(found.findings) == 1


def test_points_without_order_about_a_body_get_no_label(tmp_path: Path) -> None:
    """In each frame a frame-wise labeller finds some posture; over time these are no body."""
    rng, walk = np.random.default_rng(4), walker()
    frames = [rng.normal(size=(15, 3)) * frame.std(axis=0) + frame.mean(axis=0) for frame in walk]
    found = labelled(tmp_path, frames[:40])
    assert not (found.labelling.confidence[found.labelling.indices >= 0] >= 0.99).any()
    assert found.readiness.kind == DO_NOT_USE
    # each frame by itself: the labels stay, and what is said of them does not deny them
    framewise = labelled(tmp_path, frames[:20], frame_wise=True)
    said = [finding.sentence for finding in framewise.findings]
    assert (framewise.labelling.indices >= 0).any() and not any("no label was given" in sentence for sentence in said)


@pytest.mark.parametrize("beside", ["nothing", "flickering points"])
def test_a_person_who_enters_late_is_ready(beside: str, tmp_path: Path) -> None:
    noise = {"nothing": somewhere(0), "flickering points": somewhere(5)}[beside]
    frames = [np.concatenate([body, other]) if t >= 70 else other for t, (body, other) in enumerate(zip(walker(), noise, strict=True))]
    found = labelled(tmp_path, frames)
    given = found.labelling.indices >= 0
    assert given[70:].mean() > 0.8 and not given[:70].any()
    assert (found.labelling.indices == np.arange(15))[given].all()
    assert found.verdict is not None and found.verdict.kind == FITS
    assert found.readiness.kind == READY


def test_a_single_frame_with_points_is_said_and_not_sure(tmp_path: Path) -> None:
    found = labelled(tmp_path, [np.zeros((0, 3))] * (FRAMES - 1) + [walker()[0]])
    assert "label-few-frames" in {finding.code for finding in found.findings}
    assert (found.labelling.confidence < 0.99).all()
    assert found.readiness.kind == LOOK
    assert found.verdict is not None and found.verdict.kind == UNKNOWN


@pytest.mark.parametrize("leaves", [False, True])
def test_two_people_and_one_model_are_not_ready(leaves: bool, tmp_path: Path) -> None:
    other = walks()[3].positions[:FRAMES] + np.array([0.0, 1.5, 0.0])
    frames = [np.concatenate([one, two]) if t < 60 or not leaves else one for t, (one, two) in enumerate(zip(walker(), other, strict=True))]
    found = labelled(tmp_path, frames)
    assert found.readiness.kind == LOOK and "second person" in found.readiness.sentence
