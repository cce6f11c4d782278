"""Whether a marker set can be labelled: a good one, one that cannot be, and the words for it."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from asterism import AsterismError, Labelling, MarkerSet, Recording
from asterism.labelling import CapturabilityRules, capturability, evaluate
from asterism.labelling.partial.solver_search import SearchSettings
from asterism.simulation import simulate_walks

WALKS = simulate_walks(subjects=2, frames=100, seed=3)


QUICK = CapturabilityRules(
    search=SearchSettings(screening_frames=60, evaluation_frames=200, validation_frames=250, beam_width=15, max_markers=5, max_solvers=20),
    change_frames=60,
    hardest=1,
)
FEW = ("RASI", "LASI", "SACR", "RKNE", "RANK", "RHEE", "RTOE", "LTOE")


@pytest.fixture(scope="module")
def good():
    told = []
    return capturability(WALKS, seed=0, rules=QUICK, progress=lambda fraction, doing: told.append(fraction)), told


def test_a_good_set(good):
    result, _ = good
    assert result.markers == WALKS[0].labels
    assert (result.hit_rates > 0.9).all()
    assert "can be labelled" in result.verdict
    assert np.allclose(result.confusion.sum(axis=1), 1.0)
    assert (np.diagonal(result.confusion) > 0.3).all()


def test_hit_rate_falls_with_what_is_hidden(good):
    hidden, rates, per_marker = zip(*good[0].by_occlusions, strict=True)
    assert hidden == (0, 1, 2, 3, 4, 5)
    assert rates[5] < rates[0]
    assert all(own.shape == (15,) for own in per_marker)


def test_changes_name_every_marker_and_the_best_comes_first(good):
    changes = good[0].changes
    assert {change.marker for change in changes if change.action == "drop"} == set(WALKS[0].labels)
    assert {change.action for change in changes} == {"drop", "move", "add"}
    gains = [change.hit_rate_after - change.hit_rate_before for change in changes]
    assert gains == sorted(gains, reverse=True)


def test_progress_rises(good):
    told = good[1]
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_json(good):
    table = json.loads(json.dumps(good[0].to_dict()))
    assert table["markers"] == list(WALKS[0].labels)
    own = {"by_target", "first_classifiers", "solver_sizes", "judged"}
    assert set(table) == {"markers", "hit_rates", "confusion", "by_occlusions", "changes", "verdict"} | own


def test_the_thesis_tables_of_a_marker_set(good):
    """Table 5.1: scores fall; figure 5.1: accuracy rises; figure 5.2: higher targets, fewer wrong labels and more missing ones."""
    result = good[0]
    scores = [chosen.score for chosen in result.first_classifiers]
    assert len(scores) == 9 and scores[0] == max(scores) and min(scores) >= 0.0
    assert 0.9 < sum(scores) <= 1.0
    assert all("(" in chosen.description for chosen in result.first_classifiers)
    accuracies = [size.accuracy for size in result.solver_sizes]
    assert accuracies == sorted(accuracies)
    assert accuracies[-1] > 0.999
    assert accuracies[result.solver_sizes.index(next(s for s in result.solver_sizes if s.classifiers == 9))] == pytest.approx(sum(scores))
    rates = {(one.target, one.hidden): one for one in result.by_target}
    assert set(rates) == {(target, hidden) for target in QUICK.targets for hidden in range(1, 6)}
    lax, strict = ([rates[target, hidden] for hidden in range(1, 6)] for target in (0.99, 0.99999))
    assert sum(one.false_occlusions for one in lax) <= sum(one.false_occlusions for one in strict)
    assert all(0.0 <= one.false_assignments < 0.2 for one in result.by_target)


def test_two_markers_that_cannot_be_told_apart_are_found():
    """Two labels of a foot that swap places at random: neither is ever sure."""
    rng = np.random.default_rng(0)
    a, b = FEW.index("RHEE"), FEW.index("RTOE")
    mixed = []
    for walk in (walk.select(FEW) for walk in WALKS):
        positions = walk.positions.copy()
        flip = rng.random(len(walk)) < 0.5
        positions[flip, a], positions[flip, b] = walk.positions[flip, b], walk.positions[flip, a]
        mixed.append(replace(walk, positions=positions))
    result = capturability(mixed, seed=0, rules=QUICK)
    assert result.hit_rates[a] < 0.5
    assert result.confusion[a, b] > 0.2
    assert b in result.confusion[a].argsort()[-2:]


def test_what_cannot_be_asked():
    with pytest.raises(AsterismError, match="too few"):
        capturability([WALKS[0].select(WALKS[0].labels[:3])])
    gappy = WALKS[0].positions.copy()
    gappy[::2, 0], gappy[1::2, 1] = np.nan, np.nan
    with pytest.raises(AsterismError, match="no frame shows all markers"):
        capturability([replace(WALKS[0], positions=gappy)])


def test_its_figures_are_those_of_evaluate_for_the_same_solvers(monkeypatch):
    """Both judge single frames by partial solvers here: shares of one definition, on other draws of what is hidden."""
    examined = import_module("asterism.labelling.partial.capturability")
    label, halves, kept = examined.label_by_matrix, examined._halves, {}

    def labelled(clouds, solvers, **options):
        # the last call without options is of the solvers that by_occlusions is about
        if not options:
            kept.setdefault("solvers", solvers)
        return label(clouds, solvers, **options)

    def halved(*given):
        kept["frames"] = halves(*given)[1][0]
        return halves(*given)

    monkeypatch.setattr(examined, "label_by_matrix", labelled)
    monkeypatch.setattr(examined, "_halves", halved)
    walks = [walk.select(FEW) for walk in WALKS]
    told = capturability(walks, seed=0, rules=QUICK)

    class Solvers:
        marker_set = MarkerSet(FEW)

        def label_frames_with_cost(self, clouds, method):
            votes = label(clouds, kept["solvers"])
            return Labelling(votes.indices, votes.votes, FEW), votes.evaluations

    again = Recording(kept["frames"], FEW, 100.0)
    hidden = [entry[0] for entry in told.by_occlusions]
    measured = evaluate(Solvers(), [again], occlusions=hidden, rules="partial-solvers", seed=5)
    for (count, rate, _), condition in zip(told.by_occlusions, measured.conditions, strict=True):
        assert condition.occlusions == count
        # draws of hidden markers differ: three standard errors of a share over the frames, whose markers are not independent
        allowed = 3 * np.sqrt(2 * max(rate * (1 - rate), 0.01) / len(again)) if count else 1e-12
        assert abs(condition.right - rate) <= allowed, f"{count} hidden: {condition.right:.4f}, capturability says {rate:.4f}"
    assert "single frames" in told.judged and told.to_dict()["judged"] == told.judged
