"""A recording that a live session wrote, labelled afterwards: the same as the anonymous recording that it was made of."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism.live import LiveRecorder, LiveSession, Replay, make_labeller, recording_of
from asterism.recording import Recording, labelled_live
from asterism.session import FileLabeller, LabelledFile, LabellingOptions
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks


def original_and_live(folder: Path, walk: Recording, markers: str, condition: tuple[int, int], *, found: bool = False) -> tuple[Path, Path]:
    """A walk without names and tracks, and what a live session that played it recorded."""
    clouds, _ = simulate_gaps_and_ghosts(walk, *condition, seed=1)
    original, live = folder / "original.c3d", folder / "live.c3d"
    asterism.write(original, Recording.from_clouds(replace(clouds, tracks=None)))
    chosen = "" if found else markers
    recorder = LiveRecorder(folder / "walk.live", "lab", walk.vertical, markers=chosen)
    # Labels of the session say nothing here; one session has the process of studies that the command begins before the set is known.
    make = make_labeller(None, chosen or None, 0, "process" if found else "none")
    LiveSession(Replay(original, speed=float("inf")), make, recorder=recorder, waits=True).run()
    recorder.close()
    asterism.write(live, recording_of(folder / "walk.live").recording())
    return original, live


def labels_at_points(path: Path, options: LabellingOptions) -> tuple[np.ndarray, np.ndarray, LabelledFile]:
    """(T, M, 3) m where each marker was found, (T, M) how sure that is, and the file."""
    file = FileLabeller([], options).label(path)
    labelling, clouds = file.labelling, file.clouds
    frames, markers = np.nonzero(labelling.indices >= 0)
    places = np.full((*labelling.indices.shape, 3), np.nan)
    places[frames, markers] = clouds.xyz[clouds.offsets[frames] + labelling.indices[frames, markers]]
    return places, labelling.confidence, file


def assert_same(original: Path, live: Path, markers: str) -> None:
    options = LabellingOptions(markers=[markers])
    (places, confidence, file), (again, sure, other) = (labels_at_points(path, options) for path in (original, live))
    np.testing.assert_array_equal(again, places)
    np.testing.assert_array_equal(sure, confidence)
    # What reading an anonymous file shows of its axes is said by the live recording itself.
    codes = [[finding.code for finding in one.findings if not finding.code.startswith("format-")] for one in (file, other)]
    assert codes[1] == codes[0] and (other.readiness.error, other.readiness.look_at) == (file.readiness.error, file.readiness.look_at)


def test_a_live_recording_gets_the_labels_of_its_original(tmp_path: Path) -> None:
    [walk] = simulate_walks(1, frames=120, markers="helen-hayes", seed=3)
    original, live = original_and_live(tmp_path, walk, "helen-hayes", (3, 3))
    recording = asterism.read(live)
    assert {"SACR", "LHEE"} <= set(recording.labels), "it has the names that were given live"
    assert recording.clouds().tracks is None and asterism.read(original).clouds().tracks is not None
    assert_same(original, live, "helen-hayes")


def test_a_set_that_was_chosen_live_is_known_afterwards_and_one_that_was_found_is_found_again(tmp_path: Path) -> None:
    [walk] = simulate_walks(1, frames=60, markers="helen-hayes", seed=3)
    for found, by in ((False, "names"), (True, "points")):
        folder = tmp_path / by
        folder.mkdir()
        _, live = original_and_live(folder, walk, "helen-hayes", (0, 0), found=found)
        _, _, file = labels_at_points(live, LabellingOptions())
        assert [(one.name, one.by) for one in file.worn] == [("helen-hayes", by)]
        # What `asterism label` has labelled was not labelled live any more.
        assert labelled_live(file.recording.log) is None and file.recording.clouds().tracks is not None


@pytest.mark.parametrize("condition", [pytest.param((0, 0), marks=pytest.mark.slow), (3, 3)], ids=["as recorded", "3 hidden + 3 ghosts"])
@pytest.mark.skipif("ASTERISM_DATA" not in os.environ, reason="needs ASTERISM_DATA")
def test_a_real_live_recording_gets_the_labels_of_its_original(tmp_path: Path, condition: tuple[int, int]) -> None:
    path = Path(os.environ["ASTERISM_DATA"]) / "movement" / "pig39" / "test_movement.c3d"
    walk = asterism.read(path, markers="plug-in-gait").frames(slice(100))
    assert_same(*original_and_live(tmp_path, walk, "plug-in-gait", condition), "plug-in-gait")
