"""`asterism label` writes a long C3D file by ranges of frames as it writes it whole, and needs little memory for it."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from models import trained

import asterism
from asterism.cli import main
from asterism.formats.c3d import _long
from asterism.formats.c3d._file import C3DFile
from asterism.labelling import recording_labeller, stretches
from asterism.recording import Event, Floats, Recording
from asterism.session import sources
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks

FRAMES = 1500


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("long") / "walk.model"
    walks = simulate_walks(4, 300, seed=5)
    trained(walks[1:], subjects=["a", "b", "c"]).save(path)
    return path


@pytest.fixture(scope="module")
def walk() -> Recording:
    (walk,) = simulate_walks(1, 300, seed=5)
    there_and_back = np.concatenate([walk.positions, walk.positions[::-1]])
    positions = np.tile(there_and_back, (3, 1, 1))[:FRAMES]
    return Recording(positions, walk.labels, 100.0, walk.vertical, events=(Event("Foot Strike", 2.5, "Left"),))


@pytest.fixture
def short_stretches(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything is long, divided into stretches of some 600 frames, and converted by fewer frames than any file here has."""
    monkeypatch.setattr("asterism.formats.c3d._file._FRAMES_AT_ONCE", 130)
    monkeypatch.setattr(recording_labeller, "StretchRules", partial(stretches.StretchRules, whole=100, points=9000, overlap=1.0))


def label(model: Path, source: Path, folder: Path, *options: str) -> tuple[bytes, dict[str, object]]:
    """The labelled file and its row."""
    assert main(["label", str(source), "--model", str(model), "-o", str(folder), "--json", str(folder) + ".json", *options]) in (0, 1)
    report = json.loads(Path(str(folder) + ".json").read_text())
    (row,) = report["files"]
    row = {name: value for name, value in row.items() if name not in ("output", "frames_per_second")}
    findings = json.dumps(report["findings"]).replace(str(folder), "")
    return (folder / source.name).read_bytes(), {**row, "findings": json.loads(findings)}


def anonymous(walk: Recording) -> Recording:
    clouds, _ = simulate_gaps_and_ghosts(walk, 2, 1, seed=3)
    recording = Recording.from_clouds(clouds)
    return Recording(recording.positions, recording.labels, 100.0, walk.vertical, events=walk.events, first_frame=37)


def partly_named(walk: Recording) -> Recording:
    positions = walk.positions.copy()
    positions[100:120, 3] = np.nan
    positions[700:900, 5] = np.nan
    names = [f"*{m}" if m % 3 == 0 else name for m, name in enumerate(walk.labels)]
    names[1], names[4] = names[4], names[1]
    return Recording(positions, tuple(names), 100.0, walk.vertical, events=walk.events)


@pytest.mark.parametrize(
    ("recorded", "options"),
    [
        (anonymous, []),
        (partly_named, []),
        (partly_named, ["--known-labels", "ignore"]),
        (partly_named, ["--known-labels", "keep"]),
        (partly_named, ["--drop-computed", "--vertical", "z"]),
    ],
    ids=["anonymous", "names checked", "names ignored", "names kept", "computed points dropped"],
)
@pytest.mark.usefixtures("short_stretches")
def test_a_file_written_by_ranges_is_the_file_written_whole(
    model: Path,
    walk: Recording,
    recorded: Callable[[Recording], Recording],
    options: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = tmp_path / "walk.c3d"
    asterism.write(source, recorded(walk))
    by_ranges, row = label(model, source, tmp_path / "ranges", *options)
    monkeypatch.setattr(sources, "read_long", lambda *_: None)
    whole, row_of_whole = label(model, source, tmp_path / "whole", *options)
    assert by_ranges == whole
    assert row == row_of_whole
    if not options:
        assert label(model, source, tmp_path / "again")[0] == whole


@pytest.mark.parametrize("person", [0, 2], ids=["the person", "another person"])
@pytest.mark.usefixtures("short_stretches")
def test_a_standing_trial_counts_as_for_a_short_file(
    model: Path, walk: Recording, person: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, static = tmp_path / "walk.c3d", tmp_path / "person.c3d"
    asterism.write(source, anonymous(walk))
    asterism.write(static, simulate_walks(3, 300, seed=5)[person].frames(slice(0, 100)))
    by_ranges, row = label(model, source, tmp_path / "ranges", "--subject", str(static))
    monkeypatch.setattr(sources, "read_long", lambda *_: None)
    whole, row_of_whole = label(model, source, tmp_path / "whole", "--subject", str(static))
    assert row["subject"] == row_of_whole["subject"] == (str(static) if person == 0 else None)
    assert by_ranges == whole


@pytest.mark.parametrize("from_frame", [0, 350], ids=["from the beginning", "late"])
@pytest.mark.usefixtures("short_stretches")
def test_two_people_in_a_long_file_are_told_as_in_a_short_one(
    model: Path, walk: Recording, from_frame: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "walk.c3d"
    other = walk.positions[100:550] + np.array([0.8, 0.6, 0.0])
    other[:from_frame] = np.nan
    positions = np.concatenate([walk.positions[:450], other], axis=1)
    nameless = tuple(f"*{number + 1}" for number in range(positions.shape[1]))
    asterism.write(source, Recording(positions, nameless, 100.0, walk.vertical))
    by_ranges, row = label(model, source, tmp_path / "ranges")
    monkeypatch.setattr(sources, "read_long", lambda *_: None)
    whole, row_of_whole = label(model, source, tmp_path / "whole")
    assert "label-two-bodies" in json.dumps(row["findings"])
    assert by_ranges == whole
    assert row == row_of_whole


@pytest.mark.usefixtures("short_stretches")
def test_a_long_file_is_never_in_memory_as_positions(model: Path, walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = tmp_path / "walk.c3d"
    asterism.write(source, anonymous(walk))
    most = 0
    coordinates_of = C3DFile.coordinates_of

    def counted(file: C3DFile, frames: slice) -> Floats:
        nonlocal most
        found = coordinates_of(file, frames)
        most = max(most, len(found))
        return found

    monkeypatch.setattr("asterism.formats.c3d._file._FRAMES_AT_ONCE", 200)
    monkeypatch.setattr(_long, "SAMPLED_FRAMES", 100)
    monkeypatch.setattr("asterism.session.labeller.FRAMES_TO_FIND", 300)
    monkeypatch.setattr(C3DFile, "coordinates_of", counted)
    label(model, source, tmp_path / "ranges")
    assert 200 < most < FRAMES / 2, "a stretch of some 600 frames is the most"


@pytest.mark.usefixtures("short_stretches")
def test_analog_samples_events_and_parameters_stay(
    model: Path, walk: Recording, data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real file with plates, labelled by a model of other markers: what is no point comes out as it went in."""
    source = next((data / "gait-events/plates/NP1003").glob("*.c3d"))
    by_ranges, _ = label(model, source, tmp_path / "ranges", "--no-static")
    monkeypatch.setattr(sources, "read_long", lambda *_: None)
    whole, _ = label(model, source, tmp_path / "whole", "--no-static")
    assert by_ranges == whole
    before, after = asterism.read(source), asterism.read(tmp_path / "ranges" / source.name)
    assert before.events == after.events
    channels = before.source.analog_channels
    np.testing.assert_array_equal(after.source.analog[:, :channels], before.source.analog)


@pytest.mark.usefixtures("short_stretches")
def test_a_run_that_is_stopped_leaves_no_file(model: Path, walk: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, folder = tmp_path / "walk.c3d", tmp_path / "labelled"
    asterism.write(source, anonymous(walk))
    before = source.read_bytes()

    def stopped(*_: object) -> bytes:
        raise KeyboardInterrupt

    monkeypatch.setattr(_long, "tail_of", stopped)  # all frames have been written by then
    assert main(["label", str(source), "--model", str(model), "-o", str(folder)]) == 130
    assert source.read_bytes() == before
    assert not list(folder.glob("*.c3d"))
    assert not list(folder.glob(".*.part"))
