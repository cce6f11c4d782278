"""The audit: damage put into clean recordings is found where it is, clean ones are left in peace, and what is found can be left out."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import twins_audit as twins
from hypothesis import given, settings
from hypothesis import strategies as st
from models import BRIEF, training_with

import asterism
from asterism import AsterismError, MarkerModel, Recording, formats
from asterism.cli import main
from asterism.labelling import audit, check_names, remove_errors
from asterism.labelling.audit import AuditRules
from asterism.labelling.audit import _kernels as kernels
from asterism.labelling.audit.names import _cycles, _least_gain, _named_by
from asterism.labelling.audit.paths import exchanges
from asterism.labelling.body._score_kernels import best_pose, evidence
from asterism.labelling.body._workspace_kernels import make_body_workspace
from asterism.labelling.body.labeller import FrameLabellingSettings
from asterism.labelling.body.model import BodyRules, fit_body
from asterism.simulation import simulate_walks
from asterism.skeleton import virtual_people

pytestmark = pytest.mark.kernels

PEOPLE = ("Ann", "Ben", "Cem", "Dee", "Eva")
FRAMES = 150


@pytest.fixture(scope="module")
def walks():
    return simulate_walks(subjects=5, frames=FRAMES, rate=100.0, seed=6)


@pytest.fixture(scope="module")
def labels(walks):
    return walks[0].labels


def exchanged(recording, first, last, *names):
    """The points of the named markers pass to the next name, the last one's to the first."""
    columns = [recording.labels.index(name) for name in names]
    positions = recording.positions.copy()
    span = slice(first, last + 1)
    positions[span, columns] = recording.positions[span, np.roll(columns, 1)]
    return replace(recording, positions=positions)


def moved(recording, first, last, name, by):
    positions = recording.positions.copy()
    positions[first : last + 1, recording.labels.index(name)] += by
    return replace(recording, positions=positions)


def among(walks, number, damaged):
    return [*walks[:number], damaged, *walks[number + 1 :]]


def told(findings):
    return [(f.recording, f.first_frame, f.last_frame, set(f.markers), f.kind) for f in findings if f.damage]


# --- what is found


def test_clean_recordings_are_left_in_peace(walks):
    assert told(audit(walks, subjects=PEOPLE)) == []


@pytest.mark.parametrize(
    ("pair", "first", "last"),
    [
        (("LTHI", "LKNE"), 40, 40),
        (("LANK", "LHEE"), 40, 42),
        (("LASI", "RTOE"), 1, 3),
        (("LTHI", "LKNE"), 60, 110),
        (("LANK", "LHEE"), 50, FRAMES - 1),
        (("LASI", "RTOE"), 120, FRAMES - 1),
        (("LTHI", "LKNE"), 0, 90),
        (("LANK", "LHEE"), 0, 5),
    ],
    ids=str,
)
def test_two_exchanged_markers_are_found_where_they_are(walks, pair, first, last):
    findings = audit(among(walks, 2, exchanged(walks[2], first, last, *pair)), subjects=PEOPLE)
    assert told(findings) == [(2, first, last, set(pair), "exchanged")]
    assert findings[0].subject == "Cem" and findings[0].gain > 10.0
    assert all(name in findings[0].description for name in (*pair, "exchanged"))


def test_exchanges_in_several_recordings_are_all_found(walks):
    damaged = [exchanged(walks[0], 10, 12, "LTHI", "LKNE"), walks[1], exchanged(walks[2], 100, 130, "RANK", "RTOE"), *walks[3:]]
    damaged[0] = exchanged(damaged[0], 80, 95, "RASI", "SACR")
    found = told(audit(damaged, subjects=PEOPLE))
    assert found == [
        (0, 10, 12, {"LTHI", "LKNE"}, "exchanged"),
        (0, 80, 95, {"RASI", "SACR"}, "exchanged"),
        (2, 100, 130, {"RANK", "RTOE"}, "exchanged"),
    ]


def test_three_markers_that_change_places_are_one_finding(walks):
    damaged = exchanged(walks[1], 70, 80, "LTHI", "LKNE", "LTIB")
    findings = audit(among(walks, 1, damaged), subjects=PEOPLE)
    assert told(findings) == [(1, 70, 80, {"LTHI", "LKNE", "LTIB"}, "exchanged")]
    assert "exchanged among themselves for 11 frames (0.11 s)" in findings[0].description


def test_a_recording_exchanged_throughout_is_told_by_the_others_bodies(walks):
    """A person's only recording, in which nothing ever leaps; then one of two, of which the other is right."""
    damaged = exchanged(walks[3], 0, FRAMES - 1, "LKNE", "LANK")
    found = told(audit(among(walks, 3, damaged), subjects=PEOPLE))
    assert found == [(3, 0, FRAMES - 1, {"LKNE", "LANK"}, "consistently exchanged against the others")]
    found = told(audit([*walks, damaged], subjects=[*PEOPLE, "Dee"]))
    assert found == [(5, 0, FRAMES - 1, {"LKNE", "LANK"}, "exchanged")]


def test_what_other_people_wear_does_not_tell_how_a_person_always_wears_it(walks):
    """Ben is left out together with Dee: only a recording of Dee could say that this one of her is an exception."""
    damaged = exchanged(walks[3], 0, FRAMES - 1, "LKNE", "LANK")
    found = told(audit(among(walks, 3, damaged), subjects=PEOPLE, rules=AuditRules(folds=2)))
    assert found == [(3, 0, FRAMES - 1, {"LKNE", "LANK"}, "consistently exchanged against the others")]


def test_an_exchange_across_a_gap_is_found_by_the_body(walks):
    """Both markers vanish for half a second and come back with each other's names: no leap tells."""
    damaged = exchanged(walks[4], 100, FRAMES - 1, "RKNE", "RTIB")
    for name in ("RKNE", "RTIB"):
        damaged.positions[50:100, damaged.labels.index(name)] = np.nan
    assert told(audit(among(walks, 4, damaged), subjects=PEOPLE)) == [(4, 100, FRAMES - 1, {"RKNE", "RTIB"}, "exchanged")]


@pytest.mark.parametrize(("first", "last"), [(30, 30), (30, 36), (90, 140)])
def test_a_label_that_leaps_away_and_back_is_found(walks, first, last):
    damaged = moved(walks[1], first, last, "RKNE", [0.08, -0.05, 0.02])
    findings = audit(among(walks, 1, damaged), subjects=PEOPLE)
    assert told(findings) == [(1, first, last, {"RKNE"}, "jump")]
    assert "RKNE leaves its path" in findings[0].description


def test_a_marker_worn_elsewhere_is_a_hint_that_leaves_its_frames_in(walks):
    """A shank marker 15 cm forward, moving with the body: nobody's label is wrong."""
    forward = np.nanmean(walks[0].positions[-1] - walks[0].positions[0], axis=0)
    damaged = moved(walks[0], 0, FRAMES - 1, "LTIB", 0.25 * forward / np.linalg.norm(forward))
    given_ = among(walks, 0, damaged)
    findings = audit(given_, subjects=PEOPLE)
    assert told(findings) == []
    assert ("LTIB",) in [f.markers for f in findings if f.kind == "misplaced" and f.recording == 0]
    np.testing.assert_array_equal(remove_errors(given_, findings)[0].positions, damaged.positions)


# --- with less to go by


def test_one_recording_is_judged_by_its_paths(walks):
    damaged = exchanged(walks[0], 70, 72, "LTHI", "LKNE")
    assert told(audit([damaged])) == [(0, 70, 72, {"LTHI", "LKNE"}, "exchanged")]
    late = exchanged(walks[0], 100, FRAMES - 1, "LTHI", "LKNE")
    assert told(audit([late])) == [(0, 100, FRAMES - 1, {"LTHI", "LKNE"}, "exchanged")], "the shorter side is called wrong"
    assert told(audit([walks[0]])) == []


def test_recordings_of_one_person_are_judged_by_each_other(walks):
    parts = [walks[0].frames(slice(start, start + 75)) for start in (0, 75)] + [simulate_walks(5, 75, 100.0, seed=6)[0]]
    damaged = exchanged(parts[1], 20, 74, "RKNE", "RTIB")
    assert told(audit([parts[0], damaged, parts[2]], subjects=["Ann"] * 3)) == [(1, 20, 74, {"RKNE", "RTIB"}, "exchanged")]


def test_gaps_are_no_damage(walks):
    rng = np.random.default_rng(0)
    holed = []
    for walk in walks:
        positions = walk.positions.copy()
        for _ in range(12):
            start, m = rng.integers(FRAMES), rng.integers(positions.shape[1])
            positions[start : start + rng.integers(1, 40), m] = np.nan
        holed.append(replace(walk, positions=positions))
    assert told(audit(holed, subjects=PEOPLE)) == []
    damaged = exchanged(holed[1], 60, 64, "LTHI", "LKNE")
    found = told(audit(among(holed, 1, damaged), subjects=PEOPLE))
    assert all(markers == {"LTHI", "LKNE"} and 60 <= first <= last <= 64 for _, first, last, markers, _ in found)


def test_recordings_may_wear_different_markers(walks, labels):
    some = [walks[0], walks[1].select(labels[::-1]), walks[2].select(labels[:10]), walks[3], walks[4]]
    some[1] = exchanged(some[1], 20, 22, labels[0], labels[3])
    assert told(audit(some, subjects=PEOPLE)) == [(1, 20, 22, {labels[0], labels[3]}, "exchanged")]


@pytest.mark.parametrize("frames", [0, 1, 2, 5])
def test_next_to_nothing_holds_no_findings(walks, frames):
    assert audit([walk.frames(slice(0, frames)) for walk in walks], subjects=PEOPLE) == []


def test_an_empty_recording_among_others_holds_no_findings(walks):
    assert audit([walks[0].frames(slice(0, 0)), *walks[1:]], subjects=PEOPLE) == []


def test_odd_recordings_hold_no_findings(walks):
    empty = replace(walks[0], positions=np.full_like(walks[0].positions, np.nan))
    point = Recording(np.zeros((20, 1, 3)), ("one",), 100.0)
    heap = Recording(np.zeros((20, 6, 3)), tuple("abcdef"), 100.0)
    assert audit([empty]) == audit([point]) == audit([heap]) == audit([Recording(np.zeros((20, 0, 3)), (), 100.0)]) == []


def test_a_cut_in_the_recording_is_nobodys_label(walks):
    """From one frame to the next the whole body is elsewhere, and comes back."""
    positions = walks[0].positions.copy()
    positions[60:70] += [1.0, 0.5, 0.0]
    assert told(audit([replace(walks[0], positions=positions)])) == []


def test_an_audit_of_nothing_is_refused(walks):
    with pytest.raises(AsterismError, match="no recording to audit"):
        audit([])
    with pytest.raises(AsterismError, match="1 subjects for 2 recordings"):
        audit(walks[:2], subjects=["Ann"])


def test_the_vertical_and_the_place_do_not_matter(walks):
    damaged = among(walks, 2, exchanged(walks[2], 40, 60, "LTHI", "LKNE"))
    turned = [replace(r, positions=r.positions[:, :, [1, 2, 0]] + [5.0, 0.0, -3.0], vertical=np.array([0.0, 1.0, 0.0])) for r in damaged]
    assert told(audit(turned, subjects=PEOPLE)) == told(audit(damaged, subjects=PEOPLE)) != []


def test_progress_rises_to_one(walks):
    fractions = []
    audit(walks, subjects=PEOPLE, progress=lambda fraction, what: fractions.append(fraction))
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 1.0


# --- one person's recordings laid on each other

UPPER = ("LFHD", "RFHD", "LBHD", "RBHD", "C7", "CLAV", "STRN", "T10", "LSHO", "RSHO", "LELB", "RELB", "LASI", "RASI", "SACR")


@pytest.fixture(scope="module")
def trials():
    """Three walks of one person with a head of four markers, which nearly is a rectangle, as heads are."""
    return simulate_walks(subjects=1, frames=120, rate=100.0, seed=4, markers=UPPER, trials=3)


def test_a_head_turned_round_in_one_of_three_trials_is_told_there(trials):
    damaged = exchanged(exchanged(trials[1], 0, 119, "LFHD", "LBHD"), 0, 119, "RFHD", "RBHD")
    found = told(audit(among(trials, 1, damaged), subjects=["Ann"] * 3))
    pairs = [{"LFHD", "LBHD"}, {"RFHD", "RBHD"}]
    assert [(where, first, last, kind) for where, first, last, _, kind in found] == [(1, 0, 119, "exchanged")] * 2
    assert sorted(map(sorted, (markers for *_, markers, _ in found))) == sorted(map(sorted, pairs))
    assert told(audit(trials, subjects=["Ann"] * 3)) == []


def test_three_names_that_go_round_on_a_stiff_part_are_one_finding(trials):
    damaged = exchanged(trials[2], 0, 119, "LFHD", "RFHD", "RBHD")
    assert told(audit(among(trials, 2, damaged), subjects=["Ann"] * 3)) == [(2, 0, 119, {"LFHD", "RFHD", "RBHD"}, "exchanged")]


def test_of_two_trials_that_contradict_each_other_both_are_hints_that_nothing_removes(trials):
    given_ = [trials[0], exchanged(trials[1], 0, 119, "LFHD", "RBHD")]
    found = audit(given_, subjects=["Ann"] * 2)
    assert [(error.recording, set(error.markers), error.damage) for error in found] == [
        (0, {"LFHD", "RBHD"}, False),
        (1, {"LFHD", "RBHD"}, False),
    ]
    assert {error.finding.code for error in found} == {"audit-different"} and "here or in another recording of Ann" in found[0].description
    np.testing.assert_array_equal(remove_errors(given_, found)[1].positions, given_[1].positions)


def test_shapes_laid_on_each_other_misfit_as_by_least_squares():
    from scipy.spatial.transform import Rotation

    from asterism.labelling.audit.stiff import compared

    rng = np.random.default_rng(3)
    shape = rng.normal(0.0, 0.08, (4, 3))
    poses = Rotation.random(60, random_state=rng).as_matrix()
    one, other = shape @ poses[:30].transpose(0, 2, 1), shape[[2, 1, 0, 3]] @ poses[30:].transpose(0, 2, 1) + [1.0, 2.0, 0.0]
    [found] = compared(one, other)
    assert found.moved == {0, 2} and found.cycles() == [(0, 2)] and found.exchanged < 1e-9
    middle, mixed = shape - shape.mean(axis=0), shape[[2, 1, 0, 3]] - shape.mean(axis=0)
    assert found.named == pytest.approx(Rotation.align_vectors(middle, mixed)[1] / 2.0)
    mirrored = (shape * [-1.0, 1.0, 1.0]) @ poses[30:].transpose(0, 2, 1)
    assert all(not said.moved or said.exchanged > 1e-3 for said in compared(one, mirrored)), "a mirror image is another shape"


def test_markers_that_nobody_wears_there_are_one_hint_where_they_are_many(walks):
    positions = walks[0].positions.copy()
    legs = [column for column, label in enumerate(walks[0].labels) if label[1:] in ("KNE", "TIB", "ANK")]
    positions[:, legs] += [0.0, 0.0, 0.3]
    hints = [error for error in audit(among(walks, 0, replace(walks[0], positions=positions)), subjects=PEOPLE) if error.recording == 0]
    assert [error.kind for error in hints if error.kind == "misplaced"] == ["misplaced"]


# --- leaving it out


def test_what_is_found_can_be_left_out(walks, labels):
    damaged = among(walks, 2, exchanged(walks[2], 40, 60, "LTHI", "LKNE"))
    before = damaged[2].positions.copy()
    kept = remove_errors(damaged, audit(damaged, subjects=PEOPLE))
    gone = np.isnan(kept[2].positions[:, :, 0])
    wanted = np.zeros_like(gone)
    wanted[40:61, [labels.index("LTHI"), labels.index("LKNE")]] = True
    np.testing.assert_array_equal(gone, wanted)
    np.testing.assert_array_equal(damaged[2].positions, before)
    for i in (0, 1, 3, 4):
        np.testing.assert_array_equal(kept[i].positions, walks[i].positions)


# --- kernels and twins


@given(seed=st.integers(0, 2**31), n=st.integers(0, 8))
@settings(max_examples=60, deadline=None, derandomize=True)
def test_the_best_path_is_the_best_of_all(seed, n):
    rng = np.random.default_rng(seed)
    paths = rng.normal(0.0, 0.05, (n, 2, 3)).cumsum(axis=0)
    times = np.cumsum(rng.integers(1, 4, n)).astype(np.float64)
    scales, emission, switch = rng.uniform(0.01, 0.1, 2), rng.normal(0.0, 4.0, n), rng.uniform(0.0, 5.0)
    states = np.zeros(n, dtype=np.int64)
    gain = kernels.exchange_path(paths, times, scales, emission, switch, states)
    if n < 3:
        assert gain == 0.0 and not states.any()
        return
    best, most = twins.exchange_path(paths, times, scales, emission, switch)
    assert gain == pytest.approx(most, abs=1e-9)
    np.testing.assert_array_equal(states, best)
    score = kernels.path_score(paths, times, scales, emission, switch, states)
    assert score == pytest.approx(twins.path_score(paths, times, scales, emission, switch, states), abs=1e-9)


@given(seed=st.integers(0, 2**31), frames=st.integers(0, 8))
@settings(max_examples=30, deadline=None, derandomize=True)
def test_all_pairs_gain_what_each_gains_over_its_frames(seed, frames):
    rng = np.random.default_rng(seed)
    positions = rng.normal(0.0, 0.05, (frames, 3, 3)).cumsum(axis=0)
    positions[rng.random((frames, 3)) < 0.15] = np.nan
    pairs = np.array([(0, 1), (0, 2), (1, 2)])
    scales, emission, switch = rng.uniform(0.01, 0.1, 3), rng.normal(0.0, 4.0, (3, frames)), rng.uniform(0.0, 5.0)
    gains = np.full(3, np.nan)
    kernels.all_exchanges(positions, scales, emission, switch, pairs, gains)
    np.testing.assert_allclose(gains, twins.all_exchanges(positions, scales, emission, switch, pairs), atol=1e-9)


def test_exchanges_too_small_to_count_do_not_hide_another_pair():
    """Markers at one place, so that only the body tells: A and B gain 20 nats twice, C and D 25 nats once, and 22 are needed."""
    emission = np.full((6, 100), -1.0)
    emission[0, 20:30] = emission[0, 60:70] = 3.0
    emission[5, 40:50] = 3.5
    runs, corrected = exchanges(np.zeros((100, 4, 3)), emission, switch=5.0, least=22.0)
    assert [(run.first, run.last, run.markers) for run in runs] == [(40, 49, (2, 3))]
    assert runs[0].gain == pytest.approx(25.0)
    assert not corrected.any()


def test_an_exchange_gains_what_its_evidence_gains(walks):
    """Against whole labellings scored in full, where the kernel says it computed exactly; and what it skips is far behind."""
    frames = np.concatenate([walk.positions for walk in walks[:4]])
    body = fit_body(frames, np.repeat(np.arange(4), FRAMES), BodyRules(), 0).arrays()
    tried = exchanged(walks[4], 0, FRAMES - 1, "LTHI", "LKNE").positions[::30].copy()
    tried[1, 3] = np.nan
    pairs = np.array([(a, b) for a in range(15) for b in range(a + 1, 15)])
    gains, scores = np.zeros((len(pairs), len(tried))), np.zeros((len(tried), 15))
    rules = FrameLabellingSettings().with_usual_score(0.0)
    kernels.exchange_gains(tried, body, rules, pairs, 30.0, 50.0, gains, scores)

    def explain(points, rows):
        workspace = make_body_workspace(len(points), 15, body.load.shape[3])
        k, _ = best_pose(body, points, rows, rules, workspace)
        return lambda other: evidence(body, k, points, other, rules, workspace)

    wanted = twins.exchange_gains(tried, explain, pairs, 50.0)
    exact = gains > -50.0
    assert exact.mean() > 0.05 and (gains[:, 1] == 0.0).sum() == 14
    np.testing.assert_allclose(gains[exact], wanted[exact], atol=1e-6)
    assert (wanted[~exact] < 0.0).all()
    labels = list(walks[0].labels)
    swap = pairs.tolist().index(sorted((labels.index("LTHI"), labels.index("LKNE"))))
    assert gains[swap].min() > 10.0
    assert np.isnan(scores[1, 3]) and np.isfinite(np.delete(scores, 1, axis=0)).any()


# --- names exchanged throughout a person's only recording


@pytest.mark.parametrize(
    "cycles",
    [
        [("LKNE", "RKNE")],
        [("LASI", "RASI")],
        [("LTOE", "LHEE")],
        [("RTHI", "LANK", "SACR")],
        [("LTIB", "RTOE", "LASI", "RKNE", "RHEE")],
        [("L" + name, "R" + name) for name in ("ASI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")],
    ],
    ids=lambda cycles: " ".join(map("-".join, cycles)),
)
def test_names_exchanged_in_the_only_recording_are_told_by_virtual_people(walks, cycles):
    damaged = walks[0]
    for cycle in cycles:
        damaged = exchanged(damaged, 0, FRAMES - 1, *cycle)
    [error] = check_names([damaged]).errors
    assert set(error.markers) == {name for cycle in cycles for name in cycle}
    assert (error.first_frame, error.last_frame, error.damage, error.finding.code) == (0, FRAMES - 1, False, "audit-names-differ")
    # a false alarm must cost no sample of a training
    assert remove_errors([damaged], [error])[0] == damaged


def test_names_dealt_out_at_random_are_told(walks):
    names = list(np.random.default_rng(3).permutation(walks[0].labels))
    [error] = check_names([replace(walks[0], labels=tuple(names))]).errors
    # by no fewer than are wrong: which points a name has follows from its place among the others
    assert set(error.markers) == {was for was, now in zip(walks[0].labels, names, strict=True) if was != now}


def test_right_names_are_left_in_peace_by_virtual_people(walks, labels):
    people = virtual_people("helen-hayes", people=6, frames=48, seed=12)
    assert check_names([*walks, *people]).errors == ()
    # one leg, gaps, another axis up: fewer markers are no other names
    leg = walks[0].select([name for name in labels if name[0] != "R"])
    gaps = replace(
        walks[1], positions=np.where(np.random.default_rng(0).random((FRAMES, len(labels), 1)) < 0.3, np.nan, walks[1].positions)
    )
    y_up = Recording(walks[2].positions[:, :, [1, 2, 0]], labels, walks[2].rate, "y")
    assert check_names([leg, gaps, y_up], asterism.MarkerSet.load("helen-hayes")).errors == ()


def test_what_real_people_have_told_is_not_told_again(walks):
    damaged = among(walks, 3, exchanged(walks[3], 0, FRAMES - 1, "LHEE", "LTOE"))
    known = audit(damaged, subjects=PEOPLE)
    assert [error.recording for error in check_names(damaged).errors] == [3]
    assert check_names(damaged, known=known).errors == ()


@pytest.mark.parametrize("names", [("a", "b", "c", "d", "e"), ("LKNE", "RKNE", "LANK")], ids=["unknown", "few"])
def test_virtual_people_say_why_they_are_not_asked(names):
    still = Recording(np.zeros((9, len(names), 3)), names, 100.0)
    asked = check_names([still], asterism.MarkerSet(names))
    assert asked.errors == () and asked.worn is None and "where at least half of its markers sit" in asked.why


def test_an_exchange_must_gain_more_the_more_ways_there_are():
    """By hand: 1 recording in 100, 15 likely pairs, 15^3 rounds of three."""
    assert _least_gain(np.array([0, 1]), {frozenset((0, 1))}, 15) == pytest.approx(np.log(100 * 15))
    assert _least_gain(np.array([0, 2]), {frozenset((0, 1))}, 15) == pytest.approx(np.log(100 * 15**2))
    assert _least_gain(np.array([0, 2, 4]), set(), 15) == pytest.approx(np.log(100 * 15**3))


@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2], [1, 2, 0], [2, 0, 1]], ids=str)
def test_exchanges_undone_one_by_one_are_the_order_that_they_make(order):
    assert _named_by(_cycles(np.array(order)), 3).tolist() == order


@pytest.mark.parametrize("verb", ["audit", "train", "learn"])
def test_the_commands_tell_names_of_the_only_file_and_leave_with_1(verb, walks, tmp_path, capsys):
    file, report = tmp_path / "walk.c3d", tmp_path / "report.json"
    formats.write(file, exchanged(walks[0], 0, FRAMES - 1, "LKNE", "RKNE"))
    with training_with(BRIEF):
        if verb == "learn":
            MarkerModel.fit(walks[1:3], marker_set=asterism.MarkerSet.load("helen-hayes"), training=BRIEF).save(tmp_path / "a.model")
        words = {"audit": [], "train": ["-o", tmp_path / "b.model"], "learn": [tmp_path / "a.model", "-o", tmp_path / "b.model"]}[verb]
        words = [*words[:-2], file, *words[-2:]] if verb == "learn" else [file, *words]
        assert main([verb, *map(str, words), "--json", str(report)]) == 1
    assert "carry each other's names in the whole recording" in " ".join("".join(capsys.readouterr()).split())
    codes = [finding["code"] for finding in json.loads(report.read_text())["findings"]]
    # Training on few people says so, too.
    assert [code for code in codes if code != "train-few-people"] == ["audit-names-differ"]


# --- the command


@pytest.fixture(scope="module")
def folder(tmp_path_factory, walks):
    place = tmp_path_factory.mktemp("audit")
    for person, walk in zip(PEOPLE, walks, strict=True):
        (place / person).mkdir()
        formats.write(place / person / "walk.c3d", walk)
    formats.write(place / "Ben" / "damaged.c3d", exchanged(walks[1], 70, 72, "LTHI", "LKNE"))
    return place


def files(folder, damaged):
    return [str(folder / person / ("damaged.c3d" if damaged and person == "Ben" else "walk.c3d")) for person in PEOPLE]


def test_the_command_says_where_and_leaves_with_1(folder, capsys):
    assert main(["audit", *files(folder, True)]) == 1
    shown = capsys.readouterr().out
    assert "damaged.c3d" in shown and "LTHI and LKNE exchanged for 3 frames (0.03 s)" in shown
    assert "5 files: 1 error" in shown
    assert main(["audit", *files(folder, True), "--json", "-"]) == 1
    [finding] = json.loads(capsys.readouterr().out)["errors"]
    assert finding["file"].endswith("damaged.c3d")
    assert (finding["first_frame"], finding["last_frame"], finding["markers"]) == (71, 73, ["LTHI", "LKNE"])


def test_errors_come_before_hints_and_the_same_one_here_and_there_once(capsys):
    from pathlib import Path

    from asterism.cli.audit import ranked, show
    from asterism.labelling.audit import LabelError

    def error(first, markers, kind, gain):
        return LabelError(0, "a.c3d", "Ann", first, first + 3, markers, kind, gain, f"{' and '.join(markers)} {kind} for 4 frames")

    some = [
        error(0, ("A",), "misplaced", 900.0),
        error(5, ("B", "C"), "exchanged", 20.0),
        error(9, ("D", "E"), "exchanged", 30.0),
        error(50, ("B", "C"), "exchanged", 25.0),
    ]
    assert [[one.first_frame for one in group] for group in ranked(some)] == [[5, 50], [9], [0]]
    show(some, [Path("a.c3d")])
    assert "1 times more, here and there" in " ".join(capsys.readouterr().out.split())


def test_the_command_leaves_with_0_where_nothing_is_wrong(folder, capsys):
    assert main(["audit", *files(folder, False), "--markers", "helen-hayes"]) == 0
    assert ": no error" in capsys.readouterr().out
    assert main(["audit", str(folder / "nowhere.c3d")]) == 2
    formats.write(folder / "bare.npz", Recording(np.zeros((9, 2, 3)), ("*1", "*2"), 100.0))
    assert main(["audit", str(folder / "bare.npz")]) == 2
    shown = capsys.readouterr()
    assert "bare.npz has no labelled point" in shown.err and "no error" not in shown.out


def test_training_leaves_the_damage_out(folder, tmp_path, capsys):
    """Trained on damaged files with their damage left out: the model that learns what `remove_errors` leaves."""
    words = ["--markers", "helen-hayes", "-o", str(tmp_path / "a.model"), "--json", str(tmp_path / "a.json")]
    with training_with(BRIEF):
        assert main(["train", *files(folder, True), *words]) == 1
    shown = capsys.readouterr()
    assert "damaged.c3d, frames 71 to 73: LTHI and LKNE exchanged" in shown.err and "learns without these samples" in shown.err
    assert len(json.loads((tmp_path / "a.json").read_text())["left_out"]) == 1
    recordings = [asterism.read(file, markers="helen-hayes") for file in files(folder, True)]
    kept = remove_errors(recordings, audit(recordings))
    marker_set = asterism.MarkerSet.load("helen-hayes")
    MarkerModel.fit(kept, miner=None, training=BRIEF, marker_set=marker_set).save(tmp_path / "b.model")
    assert (tmp_path / "a.model").read_bytes()[-500:] == (tmp_path / "b.model").read_bytes()[-500:]


# --- real people


def test_real_recordings(data):
    """Eight people's walks hold no damage; three frames of one exchanged are found."""
    paths = [
        data / "gait" / subject / "straight.c3d" for subject in ("HC002", "HC003", "HC030", "HC031", "HC033", "HC039", "HC040", "HC044")
    ]
    recordings = [asterism.read(path, markers="helen-hayes") for path in paths]
    assert told(audit(recordings)) == []
    recordings[3] = exchanged(recordings[3], 100, 102, "LHEE", "LANK")
    assert told(audit(recordings)) == [(3, 100, 102, {"LHEE", "LANK"}, "exchanged")]
