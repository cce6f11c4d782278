"""Points of which many are no marker of the set asked for: a larger set explains them, and only the markers asked for are told."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logit

from asterism import AsterismError, formats
from asterism.labelling import virtual_model
from asterism.labelling.correction import Name, Right, Swap
from asterism.labelling.recording_labeller import LabellingSettings, RecordingLabeller, WiderModel
from asterism.recording import Clouds, Labelling, MarkerSet, Place, Recording
from asterism.recording.verdict import CERTAIN, FITS, Verdict
from asterism.session import LabellingOptions, LiveLabeller, label_file
from asterism.session.wider import WiderRules, wider_model
from asterism.simulation import simulate_gaps_and_ghosts
from asterism.skeleton import counterparts, virtual_people, with_markers_of

ASKED, WORN = "plug-in-gait-lower", "plug-in-gait"


@cache
def person() -> Recording:
    """Somebody whom no model has seen, with twice as many markers as are asked for."""
    return max(virtual_people(WORN, people=1, frames=200, seed=4711), key=len).frames(slice(0, 80))


def asked_columns() -> np.ndarray:
    return MarkerSet.load(ASKED).columns_of(person().labels)


def test_a_larger_set_explains_the_other_points() -> None:
    clouds, truth = simulate_gaps_and_ghosts(person(), 0, 0, seed=1)
    model = virtual_model(ASKED)
    wider = wider_model(model, clouds, WiderRules(frames=30))
    assert wider is not None
    labelling = RecordingLabeller(model, wider=wider).label(clouds)
    assert labelling.names == model.marker_set.names
    assert (labelling.indices == truth[:, asked_columns()]).mean() > 0.98
    alone = model.label(clouds)
    assert (labelling.confidence >= 0.99).mean() > (alone.confidence >= 0.99).mean() + 0.2


def test_no_other_set_is_looked_for_where_few_points_are_left_over() -> None:
    own = person().positions[:, asked_columns()]
    recording = replace(person(), positions=own, labels=MarkerSet.load(ASKED).names)
    clouds, _ = simulate_gaps_and_ghosts(recording, 0, 3, seed=1)
    assert wider_model(virtual_model(ASKED), clouds) is None
    # and a model that does not say where its markers sit has no counterparts
    model = virtual_model(ASKED)
    nowhere = type(model)(replace(model.state, marker_set=replace(model.marker_set, places={})))
    assert wider_model(nowhere, simulate_gaps_and_ghosts(person(), 0, 0, seed=1)[0]) is None


def test_a_set_that_is_sure_of_too_few_points_is_not_taken() -> None:
    clouds, _ = simulate_gaps_and_ghosts(person(), 0, 0, seed=1)
    assert wider_model(virtual_model(ASKED), clouds, WiderRules(frames=5, explained=1.1)) is None


def test_a_stream_is_labelled_by_the_larger_set_once_a_second_shows_that_it_is_worn(monkeypatch: pytest.MonkeyPatch) -> None:
    # The labels of this set are many without it, too.
    monkeypatch.setattr("asterism.session.live._LABELLED", 1.1)
    clouds, truth = simulate_gaps_and_ghosts(person(), 0, 0, seed=1)
    live = LiveLabeller(50.0, delay=2, markers=ASKED, vertical=clouds.vertical, studies="none")
    found = [labels for frame in range(len(clouds)) if (labels := live.push(clouds[frame])) is not None] + live.flush()
    assert [labels.frame for labels in found] == list(range(len(clouds)))
    later = [(labels.indices, truth[labels.frame, asked_columns()]) for labels in found[50:]]
    assert np.mean([own == true for own, true in later]) > 0.95
    (note,) = live.findings()
    assert note.code == "label-wider-set" and WORN in note.mend and live.marker_set == MarkerSet.load(ASKED)


def test_while_few_points_are_seen_no_frame_costs_as_much_as_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    worked_out = []

    class Counting:
        """NumPy as this one module sees it."""

        def __getattr__(self, name: str) -> object:
            worked_out.extend([name] if name == "median" else [])
            return getattr(np, name)

    live = LiveLabeller(20.0, markers=ASKED, studies="none")
    monkeypatch.setattr("asterism.session.live.np", Counting())
    # Half of the frames of a second show somebody, the others were lost.
    for number in range(60):
        live.push(person().positions[number] if number % 2 else np.empty((0, 3)))
    assert not worked_out
    for number in range(60, 80):
        live.push(person().positions[number])
    assert worked_out == ["median"]


def test_a_file_is_labelled_by_the_larger_set(tmp_path: Path) -> None:
    labels = tuple(f"*{m + 1}" for m in range(len(person().labels)))
    path = tmp_path / "walk.trc"
    formats.write(path, replace(person(), labels=labels, metadata={}))
    labelled = label_file(path, options=LabellingOptions(markers=(ASKED,)))
    assert (labelled.labelling.indices == asked_columns()).mean() > 0.98
    assert labelled.labelling.names == MarkerSet.load(ASKED).names
    (note,) = [finding for finding in labelled.findings if finding.code == "label-wider-set"]
    assert WORN in note.sentence and ASKED in note.sentence and WORN in note.mend


def small(names: tuple[str, ...], at: dict[str, tuple[float, float, float]], title: str = "") -> MarkerSet:
    return MarkerSet(names, title or "small", places={name: Place("left thigh", at[name]) for name in names})


def test_counterparts_have_one_name_or_one_place() -> None:
    asked = small(("A", "B", "C", "D"), {"A": (0, 0, -0.1), "B": (0.1, 0, -0.5), "C": (0, 0, -0.9), "D": (0.3, 0, -0.5)})
    other = small(("X", "A", "Y"), {"X": (0.12, 0, -0.5), "A": (0, 0.05, -0.1), "Y": (0, 0, -0.8)})
    # C and Y are 0.1 of a thigh apart, 42 mm
    assert counterparts(asked, other).tolist() == [1, 0, -1, -1]
    both, columns = with_markers_of(other, asked, counterparts(asked, other))
    assert both.names == ("X", "A", "Y", "C", "D")
    assert columns.tolist() == [1, 0, 3, 4]
    assert both.places["D"] == asked.places["D"]


def test_each_marker_is_the_counterpart_of_one() -> None:
    asked = small(("A", "B"), {"A": (0, 0, -0.5), "B": (0.01, 0, -0.5)})
    other = small(("X",), {"X": (0.012, 0, -0.5)})
    assert counterparts(asked, other).tolist() == [-1, 0]


def test_one_name_on_another_segment_is_another_marker() -> None:
    asked = small(("A",), {"A": (0, 0, -0.5)}, "asked")
    other = MarkerSet(("A", "B"), "other", places={"A": Place("left shank", (0, 0, -0.5)), "B": Place("pelvis", (0, 0, 0))})
    found = counterparts(asked, other)
    assert found.tolist() == [-1]
    both, columns = with_markers_of(other, asked, found)
    assert both.names == ("A", "B", "A of asked") and columns.tolist() == [2]


def test_counterparts_need_places() -> None:
    with pytest.raises(AsterismError, match="does not say where"):
        counterparts(MarkerSet(("A",)), MarkerSet(("B",)))


class Known:
    """A model whose labels are known: markers X, Y and Z have points 0, 1 and 2."""

    def label_one_body(self, clouds: Clouds, progress: object, *, settings: LabellingSettings) -> Labelling:
        frames = len(clouds)
        verdict = Verdict(FITS, 0.1, 0.2, 1.0, 1.0, 0.0, (("X", "Z"), ("X", "Y")))
        indices = np.tile([0, 1, 2], (frames, 1))
        return Labelling(indices, np.full((frames, 3), 0.999), ("X", "Y", "Z"), np.full((frames, 3), -1), verdict)


def test_only_the_markers_asked_for_are_told() -> None:
    clouds = Clouds.from_points([np.zeros((3, 3))] * 2, rate=100.0)
    wider = WiderModel("known", Known(), np.array([2, -1, 0]), np.array([True, True, False]))
    asked, others = wider.label(clouds, None, LabellingSettings(), ("KNE", "ANK", "HEE"))
    assert asked.names == ("KNE", "ANK", "HEE") and asked.indices.tolist() == [[2, -1, 0]] * 2
    # a marker of another name in the same place is never sure
    assert asked.confidence[0].tolist() == [0.999, 0.0, CERTAIN]
    assert others.names == ("Y",) and others.indices.tolist() == [[1]] * 2
    assert asked.verdict is not None and asked.verdict.exchangeable == (("HEE", "KNE"),)


def test_labels_among_many_points_lose_certainty() -> None:
    own = asked_columns()
    # half as many other points as markers: with more, one person may pass for two
    some = np.append(own, np.setdiff1d(np.arange(39), own)[:8])
    points = replace(person(), positions=person().positions[:, some], labels=tuple(person().labels[m] for m in some)).frames(slice(0, 20))
    clouds, _ = simulate_gaps_and_ghosts(points, 0, 0, seed=1)
    model = virtual_model(ASKED)
    distances = model.state.distances
    assert distances is not None
    doubtless = replace(distances, rules=replace(distances.rules, crowd_doubt=0.0))
    before = type(model)(replace(model.state, distances=doubtless)).label_one_body(clouds)
    after = model.label_one_body(clouds)
    both = (before.indices >= 0) & (after.indices >= 0)
    assert both.any()
    lost = logit(before.confidence[both]) - logit(after.confidence[both])
    assert lost == pytest.approx(distances.rules.crowd_doubt * np.log(24 / 16))
    # its own markers are no crowd
    alone, _ = simulate_gaps_and_ghosts(replace(points, positions=points.positions[:, :16], labels=points.labels[:16]), 0, 0, seed=1)
    assert model.label_one_body(alone) == type(model)(replace(model.state, distances=doubtless)).label_one_body(alone)


def test_what_the_larger_set_labelled_can_be_corrected(tmp_path: Path) -> None:
    """The model of the markers asked for labels again where a person says something, with the points of the others left out."""
    path = tmp_path / "walk.trc"
    # T10 is no marker of the set asked for, and LTIB is out of view at times
    positions = person().positions.copy()
    positions[20:40, person().labels.index("LTIB")] = np.nan
    formats.write(path, replace(person(), positions=positions, labels=tuple(f"*{m + 1}" for m in range(39)), metadata={}))
    labelled = label_file(path, options=LabellingOptions(markers=(ASKED,), in_memory=True))
    first, correction = labelled.labelling, labelled.correction()
    assert "label-wider-set" in {finding.code for finding in labelled.findings}
    assert correction.labelling == first
    names = list(correction.names)

    def piece_of(label: str) -> int:
        (point,) = np.nonzero(correction.clouds.columns[: correction.clouds.counts[0]] == person().labels.index(label))[0]
        return int(correction.pieces.id[correction.pieces.of_point[point]])

    # a right label that is confirmed changes nothing
    correction.apply(Right(piece_of("LKNE")))
    assert (correction.labelling.indices == first.indices).all()
    # a point that only the larger set knows becomes a marker, and the marker's own point loses it
    change = correction.apply(Name(piece_of("T10"), "LANK"))
    assert {part.piece for part in change.pieces} >= {piece_of("T10"), piece_of("LANK")}
    rest = np.array([name != "LANK" for name in names])
    assert (correction.labelling.indices[:, rest] == first.indices[:, rest]).mean() > 0.98
    correction.undo()
    # two that a person exchanges are exchanged
    correction.apply(Swap(piece_of("LASI"), piece_of("RASI")))
    left, right = names.index("LASI"), names.index("RASI")
    assert (correction.labelling.indices[:, [left, right]] == first.indices[:, [right, left]]).all()
    correction.undo()
    correction.undo()
    assert correction.labelling == first
