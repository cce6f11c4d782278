"""The verdict on a recording: ordinary people fit, others are said, and their labels are less certain."""

from __future__ import annotations

import itertools
import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import trained

import asterism
from asterism import formats
from asterism.cli import main
from asterism.findings import Severity
from asterism.labelling import join_labellings
from asterism.labelling.whole._distance_kernels import frame_scatters
from asterism.labelling.whole.verdict import RigidDistances, RivalCounts, VerdictRules, judge
from asterism.recording import Floats, Labelling, MarkerSet, Recording
from asterism.recording.verdict import FITS, OTHER_BODY, OTHER_MARKERS, OTHER_PERSON, UNKNOWN, Verdict
from asterism.simulation import simulate_gaps_and_ghosts, simulate_standing, simulate_walks

pytestmark = pytest.mark.kernels


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=5, frames=120, seed=4)


@pytest.fixture(scope="module")
def ensemble(walks: list[Recording]) -> asterism.MarkerModel:
    return trained(walks[:4], miner=None)


def placed_elsewhere(recording: Recording) -> Recording:
    """Every marker some centimetres from where this person wore it."""
    aside = np.random.default_rng(0).normal(0.0, 0.04, (1, len(recording.labels), 3))
    return replace(recording, positions=recording.positions + aside)


def loose_points(recording: Recording, spread: float = 0.3) -> Recording:
    """As many points, each on its own way, within about twice `spread` m: no body."""
    rng, shape = np.random.default_rng(0), recording.positions.shape
    places = rng.normal(0.0, spread, (1, *shape[1:])) + np.array([0.0, 0.0, 1.0])
    return replace(recording, positions=places + rng.normal(0.0, 0.005, shape).cumsum(axis=0))


@pytest.mark.parametrize("hidden", [0, 3])
def test_a_person_not_seen_in_training_fits(ensemble: asterism.MarkerModel, walks: list[Recording], hidden: int) -> None:
    clouds, _ = simulate_gaps_and_ghosts(walks[4], hidden, 0, seed=1)
    verdict = ensemble.label(clouds).verdict
    assert verdict is not None and verdict.fits
    assert 0.0 < verdict.scatter <= verdict.limit
    assert verdict.findings("walk.c3d") == []


def test_standing_fits_a_model_of_walks(ensemble: asterism.MarkerModel) -> None:
    labelling = ensemble.label(simulate_standing(subjects=5, seed=4)[4].clouds())
    assert labelling.verdict is not None and labelling.verdict.fits
    assert (labelling.indices == np.arange(15)).mean() > 0.95


def test_markers_placed_elsewhere_are_said_and_no_label_is_certain(ensemble: asterism.MarkerModel, walks: list[Recording]) -> None:
    labelling = ensemble.label(placed_elsewhere(walks[4]).clouds())
    assert labelling.verdict is not None
    assert labelling.verdict.kind == OTHER_PERSON
    assert labelling.confidence.max() < 0.99
    [finding] = labelling.verdict.findings("walk.c3d")
    assert (finding.code, finding.severity, finding.where) == ("label-foreign-recording", Severity.WARNING, "walk.c3d")
    assert "walk.c3d" in finding.sentence


@pytest.mark.parametrize("time", [True, False], ids=["whole", "frame by frame"])
@pytest.mark.parametrize("spread", [0.3, 0.6])
def test_what_is_no_body_is_said_and_gets_no_label(
    ensemble: asterism.MarkerModel, walks: list[Recording], spread: float, time: bool
) -> None:
    """Points as near as markers may pass for another person. Single frames stand alone: there the verdict takes no label back."""
    labelling = (ensemble.label if time else ensemble.label_frames)(loose_points(walks[4], spread).clouds())
    assert labelling.verdict is not None
    assert labelling.verdict.kind == OTHER_BODY or (spread == 0.3 and labelling.verdict.kind == OTHER_PERSON)
    assert labelling.verdict.findings()[0].severity >= Severity.WARNING
    assert not time or (labelling.indices < 0).all()
    assert not time or labelling.verdict.kind != OTHER_BODY or labelling.confidence.max() <= 0.5


def test_a_model_of_many_people_counts_each_distance_by_how_much_it_differs_among_them() -> None:
    """Of 30 people every second marker sits anywhere within 90 mm: so does it on the next person. Labels given at random do not fit."""
    rng = np.random.default_rng(5)
    spread = np.where(np.arange(20) % 2, 0.09, 0.003)[:, None]
    people = np.stack([BODY * rng.uniform(0.8, 1.2) + rng.normal(0.0, 1.0, (20, 3)) * spread for _ in range(32)])
    frames = np.repeat(people, 10, axis=0)
    many = RigidDistances.of_training(frames[:300], np.repeat(np.arange(30), 10), 1.0, VerdictRules())
    few = RigidDistances.of_training(frames[:100], np.repeat(np.arange(10), 10), 1.0, VerdictRules())
    counts, random = np.full(10, 20), rng.permutation(20)
    for person in (30, 31):
        next_one = np.repeat(people[person][None], 10, axis=0)
        assert judge(next_one, counts, many).fits
        assert not judge(next_one[:, random], counts, many).fits
        assert not judge(next_one, counts, few).fits
        distance = np.linalg.norm(next_one[:, many.first] - next_one[:, many.second], axis=2)
        distance[0, 3:] = np.nan
        np.testing.assert_allclose(many.scatters_of(distance), [many.nearest(some)[0] for some in distance])


def test_single_frames_of_markers_placed_elsewhere_are_not_certain(ensemble: asterism.MarkerModel, walks: list[Recording]) -> None:
    """Each frame by what it shows itself: half of the frames get the labels that all of them get."""
    clouds = placed_elsewhere(walks[4]).clouds()
    labelling, half = ensemble.label_frames(clouds), ensemble.label_frames(clouds.frames(np.arange(0, 120, 2)))
    assert labelling.confidence.max() < 0.99
    np.testing.assert_array_equal(labelling.confidence[::2], half.confidence)
    assert (ensemble.label_frames(walks[4].clouds()).confidence >= 0.99).mean() > 0.5


def test_the_scatter_of_a_frame_is_that_of_its_distances_to_the_nearest_person() -> None:
    rng = np.random.default_rng(9)
    bodies = BODY + rng.normal(0.0, 0.03, (3, 20, 3))
    reference = RigidDistances.of_training(np.repeat(bodies, 10, axis=0), np.repeat(np.arange(3), 10), 1.0, VerdictRules())
    frames = np.concatenate([bodies, BODY + rng.normal(0.0, 0.05, (6, 20, 3))])
    frames[rng.random((9, 20)) < 0.2] = np.nan
    frames[8, 3:] = np.nan
    distance = np.linalg.norm(frames[:, reference.first] - frames[:, reference.second], axis=2)
    np.testing.assert_allclose(reference.scatters(frames), [reference.nearest(some)[0] for some in distance])
    assert np.isnan(reference.scatters(frames)).tolist() == [False] * 8 + [True]


def test_labels_of_a_frame_that_does_not_fit_are_not_certain_and_least_so_after_standing_trials() -> None:
    standing = rigid_body()
    assert not standing.moving
    shares = np.array([0.2, 0.9, 1.0, 3.0, np.nan])
    after_walks = replace(standing, moving=True).confidence_limits(standing.limit * shares)
    after_standing = standing.confidence_limits(standing.limit * shares)
    assert (after_walks[0] > 0.9999) and (after_walks[0] > after_walks[1] > 0.99 > after_walks[2])
    assert after_walks[2] == after_walks[3]
    assert after_standing[0] > 0.9999 and 0.99 > after_standing[1] > after_standing[2] > after_standing[3]
    assert after_walks[4] == after_standing[4] == 1.0


def test_many_markers_not_worn_are_another_marker_set() -> None:
    """Eight of twenty markers fit, and twelve points are something else."""
    positions = np.tile(BODY, (20, 1, 1))
    positions[:, 8:] = np.nan
    verdict = judge(positions, np.full(20, 20), rigid_body())
    assert verdict.kind == OTHER_MARKERS
    assert verdict.labelled == pytest.approx(8 / 20)
    assert verdict.surplus == 12


BODY = np.random.default_rng(3).normal(0.0, 0.2, (20, 3))


def rigid_body() -> RigidDistances:
    """The training distances of one rigid body of 20 markers."""
    return RigidDistances.of_training(np.tile(BODY, (20, 1, 1)), np.zeros(20, dtype=np.int64), 1.0, VerdictRules())


def test_the_scatter_leaves_out_the_size_of_the_body() -> None:
    verdict = judge(np.tile(1.3 * BODY, (20, 1, 1)), np.full(20, 20), rigid_body())
    assert verdict.kind == FITS
    assert verdict.scatter == pytest.approx(0.0, abs=1e-9)
    assert verdict.size == pytest.approx(1.3)


def test_the_scatter_does_not_depend_on_where_the_body_is_or_how_it_lies() -> None:
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    aside = BODY + np.random.default_rng(6).normal(0.0, 0.02, BODY.shape)
    there, moved = (judge(np.tile(body, (20, 1, 1)), np.full(20, 20), rigid_body()) for body in (aside, aside @ turn.T + np.ones(3)))
    assert moved.scatter == pytest.approx(there.scatter)
    assert there.scatter > 0.01


def test_a_body_that_moves_against_the_training_is_another() -> None:
    loose = BODY + np.random.default_rng(7).normal(0.0, 0.1, (60, 20, 3))
    assert judge(loose, np.full(60, 20), rigid_body()).kind == OTHER_BODY


def test_one_person_gives_the_smallest_limit_and_other_people_widen_it() -> None:
    rng, rules = np.random.default_rng(8), VerdictRules()
    bodies = BODY + rng.normal(0.0, 0.03, (5, 20, 3))
    frames, people = np.repeat(bodies, 10, axis=0), np.repeat(np.arange(5), 10)
    assert rigid_body().limit == rules.min_limit
    assert rules.min_limit < RigidDistances.of_training(frames, people, 1.0, rules).limit <= rules.max_limit


def test_no_points_are_nothing_to_judge() -> None:
    verdict = judge(np.full((10, 20, 3), np.nan), np.zeros(10, dtype=np.int64), rigid_body())
    assert verdict.kind == UNKNOWN
    assert np.isnan(verdict.scatter)


def test_markers_too_few_to_compare_do_not_fit() -> None:
    """Three of twenty markers, all that are in view: three distances, which any three points have about as well."""
    positions = np.tile(BODY, (20, 1, 1))
    positions[:, 3:] = np.nan
    verdict = judge(positions, np.full(20, 3), rigid_body())
    assert verdict.kind == UNKNOWN and verdict.max_confidence < 0.99
    positions[:, 3:10] = BODY[3:10]
    assert judge(positions, np.full(20, 10), rigid_body()).kind == UNKNOWN, "a quarter of the distances that one person has shown"
    positions[:, 10:15] = BODY[10:15]
    assert judge(positions, np.full(20, 15), rigid_body()).kind == FITS


def test_a_person_who_enters_late_is_judged_where_they_are() -> None:
    """Fifteen still points, and the body in a tenth of the frames: the same verdict as of these frames alone."""
    positions, counts = np.full((200, 20, 3), np.nan), np.full(200, 15)
    positions[180:], counts[180:] = BODY, 35
    verdict = judge(positions, counts, rigid_body())
    assert verdict == judge(positions[180:], counts[180:], rigid_body())
    assert verdict.labelled == 1.0


def test_points_without_a_label_are_other_markers_where_they_cannot_be_the_models() -> None:
    """Five labels of another person are taken back, as points are added: the reason stays until these are more than the markers."""
    stranger = BODY + np.random.default_rng(8).normal(0.0, 0.03, BODY.shape)
    kinds = []
    for added in range(12):
        positions = np.tile(stranger, (20, 1, 1))
        positions[:, : 5 if added else 0] = np.nan
        verdict = judge(positions, np.full(20, 20 + added), rigid_body())
        assert verdict.scatter > verdict.limit and verdict.surplus == added + (5 if added else 0)
        kinds.append(verdict.kind)
    assert kinds == [OTHER_PERSON] * 5 + [OTHER_MARKERS] * 7


def falls_of_verdict(people: int, known_share: float) -> tuple[int, int, int]:
    """How often the verdict falls when markers of strangers are added one by one, of how many steps, and how many fit in the end.

    Four walkers under their true labels: as they are, and with feet and ankles higher and lower than anybody's.
    """
    walks = simulate_walks(subjects=people + 4, frames=40, markers="helen-hayes", seed=12)
    frames, of_whom = np.concatenate([walk.positions for walk in walks[:people]]), np.repeat(np.arange(people), 40)
    reference = RigidDistances.of_training(frames, of_whom, 1.0, VerdictRules(known_share=known_share))
    low = [m for m, name in enumerate(walks[0].labels) if name[1:] in ("TOE", "HEE", "ANK")]
    ranks = {OTHER_BODY: 0, OTHER_MARKERS: 1, OTHER_PERSON: 2, UNKNOWN: 2, FITS: 3}
    rng, falls, steps, fitting = np.random.default_rng(people), 0, 0, 0
    for stretch, walk, _ in itertools.product((1.0, 1.3, 0.7), walks[people:], range(3)):
        positions, order, ranked = walk.positions.copy(), rng.permutation(15), list[int]()
        positions[:, low, 2] *= stretch
        for shown in range(4, 16):
            part = np.full((40, 15, 3), np.nan)
            part[:, order[:shown]] = positions[:, order[:shown]]
            ranked.append(ranks[judge(part, np.full(40, shown), reference).kind])
        falls, steps, fitting = falls + int((np.diff(ranked) < 0).sum()), steps + len(ranked) - 1, fitting + (ranked[-1] == ranks[FITS])
    return falls, steps, fitting


def test_markers_that_are_added_hardly_lower_the_verdict() -> None:
    """With few people a part of the body says little, and the verdict says so: half of the falls go."""
    falls, steps, fitting = falls_of_verdict(4, VerdictRules().known_share)
    without, _, as_many = falls_of_verdict(4, 0.0)
    assert 2 * falls <= without and falls <= 0.04 * steps, (falls, without, steps)
    assert fitting == as_many >= 12, "who fits with all markers does so either way"
    falls, steps, _ = falls_of_verdict(24, VerdictRules().known_share)
    assert falls <= 0.02 * steps, (falls, steps)


def test_of_several_bodies_the_one_without_a_label_is_named() -> None:
    """Its model gave no label: that is no word on the labels of the other one."""
    labels = Labelling(np.array([[0, 1]] * 9), np.ones((9, 2)), ("A", "B"), verdict=Verdict(FITS, 0.01, 0.06, 1.0, 1.0, 0.0))
    nothing = Labelling(np.full((9, 2), -1), np.zeros((9, 2)), ("A", "B"), verdict=Verdict(OTHER_BODY, 0.4, 0.06, 1.0, 0.1, 9.0))
    both, _ = join_labellings([labels, nothing], [MarkerSet(("A", "B"))] * 2, ["ann", "crate"])
    (finding,) = both.findings("two.c3d")
    assert finding.sentence == "two.c3d, body crate: this is no body that the model knows; no label was given."
    alone = replace(labels, verdict=nothing.verdict)
    assert "the labels given are not to be used" in alone.findings("one.c3d")[0].sentence


def test_exchangeable_markers_are_said_once() -> None:
    verdict = Verdict(FITS, 0.01, 0.06, 1.0, 1.0, 0.0, (("LTHI1", "LTHI3"), ("A", "B", "C")))
    first, second = verdict.findings("run.c3d")
    assert first.code == second.code == "label-exchangeable"
    assert first.sentence == "run.c3d: LTHI1 and LTHI3 may be exchanged throughout."
    assert "A, B and C" in second.sentence


def test_two_markers_that_are_each_others_rivals_throughout_are_exchangeable() -> None:
    """Markers 0 and 1 are doubtful in all 20 frames and each other's rivals; 2 is doubtful, too, but its rival is sure."""
    label, rival = np.tile([0, 1, 2, 3], 20), np.tile([1, 0, 3, -1], 20)
    doubtful = np.tile([0.5, 0.6, 0.5, 0.99], 20)

    def groups(certainty: Floats, frames: int) -> tuple[tuple[int, ...], ...]:
        counts = RivalCounts(5)
        for some in (slice(0, 30), slice(30, None)):
            counts.add(label[some], rival[some], certainty[some], VerdictRules())
        return counts.exchangeable(frames)

    assert groups(doubtful, 20) == ((0, 1),)
    assert groups(np.where(np.arange(80) < 60, 0.99, doubtful), 20) == ()
    assert groups(doubtful, 100) == ()


def test_the_command_line_says_it_and_ends_with_1(
    ensemble: asterism.MarkerModel, walks: list[Recording], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "walks.model"
    ensemble.save(model)
    statuses = {}
    for name, recording in (("own", walks[4]), ("other", placed_elsewhere(walks[4]))):
        formats.write(tmp_path / f"{name}.c3d", recording)
        words = ["label", str(tmp_path / f"{name}.c3d"), "--model", str(model), "-o", str(tmp_path / "out"), "--json", "-"]
        status = main(words)
        told = json.loads(capsys.readouterr().out)
        statuses[name] = (status, [finding["code"] for finding in told["findings"]], told["files"][0]["verdict"])
    assert statuses["own"] == (0, [], FITS)
    assert statuses["other"] == (1, ["label-foreign-recording"], OTHER_PERSON)


def test_points_in_one_place_have_a_distance_whose_log_is_finite() -> None:
    median = np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.11, 0.19, 0.32, 0.41, 0.52, 0.6]])
    first, second = np.triu_indices(4, 1)
    reference = RigidDistances(first, second, median, False, 0.09, 1.0, VerdictRules(min_pairs=4))
    together = np.array([[0.0, 0.0, 0.3, 0.4, 0.5, np.nan], np.zeros(6), median[0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        expected = [reference.nearest(frame)[0] for frame in together]
    out = np.empty(3)
    frame_scatters(together, reference.log_references, reference.softness, reference.rules.min_pairs, out)
    np.testing.assert_allclose(out, expected, rtol=1e-9, atol=1e-12)
    assert np.isfinite(expected).all()
