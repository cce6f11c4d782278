"""The scripts of docs/gallery run, say what is true, and stand on their page with their pictures."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from models import examining_briefly, trained

from asterism.labelling import MarkerModel
from asterism.recording import Recording

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

GALLERY = Path(__file__).parent.parent / "docs" / "gallery"
SCRIPTS = sorted(GALLERY.glob("*.py"))


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, GALLERY / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(autouse=True)
def trained_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Training is short, and kept for the next run."""
    original = MarkerModel.__dict__["fit"]

    def fit(recordings: Sequence[Recording], **settings: Any) -> MarkerModel:
        with monkeypatch.context() as patched:
            patched.setattr(MarkerModel, "fit", original)
            return trained(recordings, miner=None, **settings)

    monkeypatch.setattr(MarkerModel, "fit", fit)


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """Where a script draws; it must have drawn something by the end of the test."""
    return tmp_path / "picture.png"


def drawn(picture: Path) -> bool:
    return picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_walk_is_labelled_right(picture: Path) -> None:
    # the stream below is of the same model; three people teach it, so that it judges the fourth to be foreign, and gives fewer labels
    assert script("label_a_walk").main(picture, subjects=4, frames=100) > 0.9
    assert drawn(picture)


@pytest.mark.slow
def test_answers_correct_what_was_wrong_or_missing(picture: Path) -> None:
    remaining = script("review_what_is_uncertain").main(picture, subjects=3, frames=150)
    assert remaining[-1] < remaining[0] and all(after <= before for before, after in pairwise(remaining))
    assert drawn(picture)


@pytest.mark.slow
def test_two_people_are_labelled_right(picture: Path) -> None:
    assert script("two_people").main(picture, subjects=5, frames=120) > 0.99
    assert drawn(picture)


def test_a_stream_labels_most_markers_at_once_and_more_with_a_delay(picture: Path) -> None:
    at_once, later = script("live_stream").main(picture, subjects=4, frames=100, delays=(0, 10))
    assert 0.9 < at_once <= later
    assert drawn(picture)


@pytest.mark.slow
def test_the_verdict_names_the_markers(picture: Path) -> None:
    with examining_briefly():
        assert "marker" in script("capturability_of_a_marker_set").main(picture, subjects=2, frames=60)
    assert drawn(picture)


def test_cameras_are_calibrated_to_millimetres(picture: Path) -> None:
    assert script("calibrate_a_rig").main(picture, cameras=4, frames=300) < 0.005
    assert drawn(picture)


def test_points_are_composed_to_millimetres(picture: Path) -> None:
    assert script("points_with_uncertainty").main(picture, frames=40) < 0.002
    assert drawn(picture)


def test_every_script_is_on_the_page_with_its_text_and_picture() -> None:
    page = (GALLERY / "README.md").read_text(encoding="utf-8")
    for path in SCRIPTS:
        title, text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))).split("\n\n", 1)
        assert f"## {title.rstrip('.')}\n\n{text}\n" in page, f"{path.name}: the page says something else"
        assert f"]({path.name})" in page and f"]({path.stem}.png)" in page and (GALLERY / f"{path.stem}.png").is_file()
        assert (GALLERY / f"{path.stem}.png").stat().st_size < 200_000


def test_scripts_are_short_and_as_long_as_they_promise() -> None:
    assert len(SCRIPTS) >= 6
    for path in SCRIPTS:
        assert 20 <= len(path.read_text(encoding="utf-8").splitlines()) <= 55, path.name
