"""No body turned round: standing people by a model of walkers, in frames, whole recordings and streams; and what a body's twins are."""

from __future__ import annotations

import numpy as np
import pytest
from models import trained
from standing import MARKER_SET, standing_clouds

import asterism
from asterism.labelling.body.twins import twins_of
from asterism.recording import Clouds, Labelling
from asterism.simulation import simulate_walks

NAMES = MARKER_SET.names


@pytest.fixture(scope="module")
def walkers() -> asterism.MarkerModel:
    """A model of six simulated walkers, who never stand with their feet apart."""
    return trained(simulate_walks(subjects=6, frames=120, seed=100))


def in_stream(model: asterism.MarkerModel, clouds: Clouds) -> Labelling:
    stream = model.stream(rate=clouds.rate)
    found = [stream.push(clouds.xyz[clouds.offsets[t] : clouds.offsets[t + 1]]) for t in range(len(clouds))]
    given = [labels for labels in found if labels is not None]
    return Labelling(np.array([labels.indices for labels in given]), np.array([labels.confidence for labels in given]), NAMES)


@pytest.mark.parametrize("how", ["whole", "frames", "stream"])
@pytest.mark.parametrize("seed", [1, 7, 33, 48])
def test_a_person_who_stands_with_the_feet_apart_is_not_labelled_turned_round(walkers: asterism.MarkerModel, seed: int, how: str) -> None:
    """Each of them was, in one of the three ways at least, with every marker in view; what is labelled is right, and most is."""
    clouds, order = standing_clouds(seed)
    found = in_stream(walkers, clouds) if how == "stream" else (walkers.label(clouds) if how == "whole" else walkers.label_frames(clouds))
    frame, marker = np.nonzero(found.indices >= 0)
    right = order[frame, found.indices[frame, marker]] == marker
    assert right.all(), f"{(~right).sum()} of {len(right)} labels wrong, as {sorted({NAMES[m] for m in marker[~right]})}"
    assert right.sum() >= (0.7 if how == "whole" else 0.2) * order.size


def named(twin: np.ndarray) -> dict[str, str]:
    """Whose point each marker that moves has in a twin; "-" where the other labels tell."""
    return {NAMES[m]: NAMES[other] if other >= 0 else "-" for m, other in enumerate(twin) if other != m}


def test_the_twins_of_a_body_are_turned_and_mirrored_as_a_whole_and_in_part(walkers: asterism.MarkerModel) -> None:
    found = [named(twin) for twin in twins_of(walkers.state.body)]
    sides = {name: other + name[1:] for name in NAMES for side, other in ("LR", "RL") if name[0] == side and other + name[1:] in NAMES}
    assert found[0] == sides, "mirrored"
    legs = {name: other for name, other in sides.items() if name[1:] != "ASI"}
    assert legs in found, "the legs mirrored"
    feet = {"LHEE": "RTOE", "RHEE": "LTOE", "LTOE": "RHEE", "RTOE": "LHEE"}
    assert {**sides, **feet} in found, "turned, with the pelvis mirrored"
    turned = [twin for twin in found if feet.items() <= twin.items()]
    assert any(twin["LASI"] == "-" for twin in turned), "turned, with the pelvis left open"
    thirds = [{"RASI": "LASI", "LASI": "SACR", "SACR": "RASI"}, {"RASI": "SACR", "SACR": "LASI", "LASI": "RASI"}]
    assert all(third in found for third in thirds), "the pelvis turned by a third"


def test_a_twin_gives_no_point_twice(walkers: asterism.MarkerModel) -> None:
    for twin in twins_of(walkers.state.body):
        given = twin[twin >= 0]
        assert len(np.unique(given)) == len(given)
        assert (twin != np.arange(len(NAMES))).sum() >= 3
