"""Training files as they come: of several people, and of people who do not wear the same markers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from asterism import MarkerModel, Recording
from asterism.labelling import TrainingRules
from asterism.labelling.training.people import one_person_each, prefixes_of_people
from asterism.labelling.training.trials import TrainingTrial
from asterism.simulation import simulate_walks

BRIEF = TrainingRules(
    virtual_people=0, folds=2, trial_frames=8, trials=(TrainingTrial(), TrainingTrial(0.2, 3)), stretches=1, stretch_frames=30
)

ASIDE = np.array([0.0, 2.0, 0.0])


@pytest.fixture(scope="module")
def walks() -> list[Recording]:
    return simulate_walks(subjects=4, frames=60, rate=50.0, seed=5)


def both(one: Recording, other: Recording) -> Recording:
    """Two people in one volume, 2 m apart, and an object."""
    labels = (*(f"Ann:{name}" for name in one.labels), *(f"Bob:{name}" for name in other.labels), "Box:1", "Box:2", "Box:3", "Box:4")
    beside = other.positions + ASIDE
    box = np.tile(np.array([[3.0, 3.0, 0.1 * i] for i in range(4)]), (len(one), 1, 1))
    return Recording(np.concatenate([one.positions, beside, box], axis=1), labels, one.rate, one.vertical, metadata={"subject": "duo"})


def test_two_people_in_one_file_are_two_people(walks: list[Recording]) -> None:
    found, names = one_person_each([both(walks[0], walks[1]), walks[2]], None)
    assert names[:2] == ["duo Ann", "duo Bob"] and len(found) == 3
    assert found[0].labels == found[1].labels == walks[0].labels and found[2] is walks[2]
    np.testing.assert_allclose(found[0].positions, walks[0].positions)


def test_prefixes_of_sides_and_of_parts_of_a_body_are_no_people() -> None:
    sides = [f"{side}:{name}" for side in ("Chair", "Arm") for name in ("1", "2", "3")]
    assert prefixes_of_people(sides) == []
    rigid_bodies = [f"{part}:Marker{number}" for part in ("Chair", "Arm", "Forearm") for number in range(1, 5)]
    assert prefixes_of_people([*rigid_bodies, "Body:C7", "Body:Forehead", "Body:HandL", "Body:EarL"]) == []
    numbered = [f"{person}:M{number}" for person in ("Ann", "Bob") for number in range(1, 13)]
    assert prefixes_of_people(numbered) == ["Ann", "Bob"]
    assert prefixes_of_people([f"Ann:{name}" for name in "ABCDEF"]) == []
    assert prefixes_of_people([*(f"Ann:{name}" for name in "ABCDEF"), *(f"Bob:{name}" for name in "CDEFGH")]) == ["Ann", "Bob"]


def test_a_model_of_a_duo_is_the_model_of_the_two(walks: list[Recording]) -> None:
    apart = [walks[0], replace(walks[1], positions=walks[1].positions + ASIDE)]
    together = MarkerModel.fit([both(walks[0], walks[1])], training=BRIEF)
    alone = MarkerModel.fit(apart, subjects=["duo Ann", "duo Bob"], training=BRIEF)
    assert together.marker_set.names == walks[0].labels and together.about["subjects"] == ["duo Ann", "duo Bob"]
    clouds = walks[2].clouds()
    assert together.label_frames(clouds) == alone.label_frames(clouds)


def test_a_marker_that_one_person_lacks_is_learned_from_the_others(walks: list[Recording]) -> None:
    """It is labelled on a person who wears it, and not invented on one who does not."""
    names = walks[0].labels
    lacking = [name for name in names if name != "LKNE"]
    model = MarkerModel.fit([walks[0], walks[1].select(lacking), walks[2], walks[3]], training=BRIEF)
    assert set(model.marker_set.names) == set(names) and not model.about["left_out_markers"]
    knee = model.marker_set.names.index("LKNE")
    with_it = model.label(walks[1])
    places = walks[1].clouds().columns.reshape(len(walks[1]), -1)
    truth = (places == names.index("LKNE")).argmax(axis=1)
    assert (with_it.indices[:, knee] == truth).mean() > 0.9
    assert (model.label(walks[1].select(lacking)).indices[:, knee] == -1).all()


def test_nouns_are_equal_where_they_show_the_same(walks: list[Recording]) -> None:
    """A missing sample equals a missing sample; another sample, name or rate does not."""
    one, other = walks[0], replace(walks[0], metadata={})
    assert one == other and one.clouds() == other.clouds() and one != one.clouds()
    gap = one.positions.copy()
    gap[3, 2] = np.nan
    assert replace(one, positions=gap) == replace(one, positions=gap.copy()) != one
    assert replace(one, rate=25.0) != one and replace(one, labels=one.labels[::-1]) != one
    assert replace(one.clouds(), tracks=None) != one.clouds()
