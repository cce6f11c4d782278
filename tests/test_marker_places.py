"""Where markers sit on the body: read from a marker set's file, mirrored, kept, and refused where it is no place."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from asterism.errors import AsterismError
from asterism.labelling import join_labellings
from asterism.labelling.training.state_file import _marker_set, _plain_marker_set
from asterism.recording import Labelling, MarkerSet, Place, canonical, landmarks, shipped_marker_sets
from asterism.recording._marker_set_file import fields_of
from asterism.recording.place import SEGMENTS
from asterism.skeleton import BuildRules, WearRules, virtual_people
from asterism.skeleton.build import BONES, random_build
from asterism.skeleton.worn import put_on

LEGS = """
markers = ["LTHI", "LKNE", "RTHI", "RKNE", "RBAK", "SACR"]
pairs = [["LTHI", "RTHI"], ["LKNE", "RKNE"]]
[places]
LTHI = { segment = "thigh", place = [0.02, 0.085, -0.55], spread = 0.015, wand = true, plate = "thigh" }
RTHI = { segment = "thigh", place = [0.03, -0.090, -0.40] }
LKNE = "lateral epicondyle of femur"
RBAK = { landmark = "right shoulder blade", spread = 0.02 }
SACR = { segment = "pelvis", place = [-0.1, 0, 0] }
"""


def test_the_left_of_a_pair_stands_for_both_unless_the_right_has_its_own():
    places = MarkerSet.from_toml(LEGS, "legs").places
    assert list(places) == ["LTHI", "LKNE", "RTHI", "RKNE", "RBAK", "SACR"]
    assert places["LTHI"] == Place("left thigh", (0.02, 0.085, -0.55), 0.015, True, "left thigh")
    assert places["RTHI"] == Place("right thigh", (0.03, -0.090, -0.40))
    known = landmarks()["lateral epicondyle of femur"]
    assert (places["LKNE"].segment, places["LKNE"].at) == ("left thigh", known.at)
    assert places["RKNE"] == places["LKNE"].mirrored()
    assert places["RBAK"].at[1] == -landmarks()["shoulder blade"].at[1]
    assert places["RBAK"].spread == 0.02


def test_a_place_mirrored_twice_is_itself():
    place = Place("left foot", (0.1, 0.03, -0.05), 0.01, False, "left plate")
    assert place.mirrored() == Place("right foot", (0.1, -0.03, -0.05), 0.01, False, "right plate")
    assert place.mirrored().mirrored() == place


def test_names_that_differ_in_their_side_are_pairs_where_the_file_has_none():
    places = MarkerSet.from_toml('markers = ["LKNE", "RKNE"]\n[places]\nLKNE = "lateral epicondyle of femur"', "two").places
    assert places["RKNE"] == places["LKNE"].mirrored()


DIAMETER = 0.012
"""m, of the smallest usual marker for whole bodies; on hands and feet it is half of that."""


@pytest.mark.parametrize("name", shipped_marker_sets())
def test_every_marker_of_a_shipped_set_has_a_place_and_none_sits_on_another(name):
    marker_set = MarkerSet.load(name)
    assert list(marker_set.places) == list(marker_set.names)
    for segment in {place.segment for place in marker_set.places.values()}:
        on = [(marker, place) for marker, place in marker_set.places.items() if place.segment == segment]
        # A limb of a body of 1.70 m is 0.25 m or longer.
        at = np.array([place.at for _, place in on]) * [1.0, 1.0, 0.25 if on[0][1].limb else 1.0]
        apart = np.linalg.norm(at[:, None] - at, axis=2) + np.eye(len(at))
        i, j = np.unravel_index(np.argmin(apart), apart.shape)
        assert apart[i, j] > DIAMETER, f"{on[i][0]} and {on[j][0]} are {1000 * apart[i, j]:.0f} mm apart"


@pytest.mark.parametrize("name", shipped_marker_sets())
def test_pairs_sit_on_both_sides_of_one_place(name):
    """The same segment, mirrored."""
    marker_set = MarkerSet.load(name)
    for left, right in marker_set.pairs:
        one, other = marker_set.places[left], marker_set.places[right].mirrored()
        assert (one.segment, one.spread, one.wand, one.plate) == (other.segment, other.spread, other.wand, other.plate)
        # Two published sets number the loose markers of their limbs otherwise on either side.
        assert name in ("opencap-lab", "landmarks-73") or np.allclose(one.at, other.at), (left, right)


def test_a_plate_lies_on_one_segment():
    for name in shipped_marker_sets():
        on: dict[str, set[str]] = {}
        for place in MarkerSet.load(name).places.values():
            if place.plate:
                on.setdefault(place.plate, set()).add(place.segment)
        assert all(len(segments) == 1 for segments in on.values()), (name, on)


HEAD = 'markers = ["LTHI", "RTHI", "C7"]\npairs = [["LTHI", "RTHI"]]\n[places]\n'


@pytest.mark.parametrize(
    "entry, what",
    [
        ('LTHI = { segment = "tigh", place = [0, 0, 0] }', "places.LTHI: 'tigh' is no segment of a body"),
        ('LKNE = "C7"', "'LKNE' is not among the markers; list it there"),
        ('LTHI = { segment = "thigh", place = [0, 0] }', "a list of 2, not three numbers"),
        ('LTHI = { segment = "thigh", place = [0, "a", 0] }', "a text where a number belongs"),
        ('LTHI = { segment = "thigh", place = [nan, 0, 0] }', "three finite numbers"),
        ('LTHI = { segment = "thigh", place = [0, 85, -0.5] }', "give metres"),
        ('LTHI = { segment = "thigh", place = [0, 0.085, -230] }', "give a share of the bone's length"),
        ('LTHI = { segment = "thigh", place = [0, 0, 0], spread = -1 }', "a spread of -1 is not between 0 and 0.1 m"),
        ('LTHI = { segment = "thigh", place = [0, 0, 0], spread = 8 }', "a spread of 8 is not between"),
        ('LTHI = { segment = "thigh", place = [0, 0, 0], wand = 1 }', "write true or false"),
        ('LTHI = { segment = "thigh", place = [0, 0, 0], plate = 1 }', "`plate` is not the short name"),
        ('LTHI = { segment = "thigh", place = [0, 0, 0], wnad = true }', "'wnad' says nothing"),
        ('LTHI = { segment = "right thigh", place = [0, 0, 0] }', "the left one of a pair and sits on the right thigh"),
        ('C7 = { segment = "thigh", place = [0, 0, 0] }', "write 'left thigh' or 'right thigh'"),
        ('LTHI = "side of tigh"', "near it: side of thigh"),
        ('LTHI = { landmark = "C7", segment = "thigh" }', "keep one of the two"),
        ("LTHI = 3", "it is a number"),
        ("LTHI = {}", "`segment` is missing"),
    ],
)
def test_what_is_no_place_is_refused_with_file_and_marker(entry, what):
    with pytest.raises(AsterismError) as caught:
        MarkerSet.from_toml(HEAD + entry, "my-set.toml")
    text = str(caught.value)
    assert text.startswith("my-set.toml, places.")
    assert what in text
    assert text.endswith(".")


def test_places_of_no_table_are_refused():
    with pytest.raises(AsterismError, match="`places` is a list, not a table of places"):
        MarkerSet.from_toml('markers = ["C7"]\nplaces = []', "my-set.toml")


def test_places_stay_with_the_set_in_a_model_file():
    marker_set = MarkerSet.load("plug-in-gait")
    plain = json.loads(json.dumps(_plain_marker_set(marker_set)))
    assert _marker_set(plain) == marker_set
    # Models of an earlier Asterism say nothing of places.
    del plain["places"]
    assert _marker_set(plain).places == {}


def test_bodies_beside_each_other_keep_their_places():
    marker_set = MarkerSet.load("helen-hayes")
    labelling = Labelling(np.full((2, 15), -1), np.zeros((2, 15)), marker_set.names)
    _, both = join_labellings([labelling] * 2, [marker_set] * 2, subjects=["Ann", "Ben"])
    assert both.places["Ben:LTHI"] == marker_set.places["LTHI"]
    assert len(both.places) == 30


NAMES = st.lists(st.text(min_size=1, max_size=8), min_size=1, max_size=8, unique_by=canonical).filter(
    lambda names: all(map(canonical, names))
)
PLACES = st.builds(
    lambda segment, ahead, left, up, spread, wand, plate: Place(segment, (ahead, left, up), spread, wand, plate),
    st.sampled_from(SEGMENTS),
    *[st.floats(-0.6, 0.6)] * 3,
    st.floats(0.0, 0.1),
    st.booleans(),
    st.just(""),
)


@st.composite
def marker_sets(draw: st.DrawFn) -> MarkerSet:
    """A set of any names with places; the first two are a pair where there are two, on either side of what bodies have two of."""
    names = draw(NAMES)
    places = {name: draw(PLACES) for name in names if draw(st.booleans())}
    pairs = ()
    if len(names) > 1:
        pairs = ((names[0], names[1]),)
        for name, side in zip(names[:2], ("left", "right"), strict=True):
            if name in places and places[name].side not in ("", side):
                places[name] = places[name].mirrored()
        # A file in which the left one alone has a place says the right one, too.
        if names[0] in places and names[1] not in places:
            places[names[1]] = places[names[0]].mirrored()
    return MarkerSet(
        tuple(names), draw(st.text(max_size=20)), {}, pairs, {"part": tuple(names)}, {n: places[n] for n in names if n in places}
    )


@given(marker_sets())
def test_a_set_is_read_back_from_its_text(marker_set: MarkerSet):
    assert MarkerSet.from_toml(marker_set.to_toml(), "set") == marker_set


@pytest.mark.parametrize("name", shipped_marker_sets())
def test_shipped_sets_are_read_back_from_their_text(name: str):
    marker_set = MarkerSet.load(name)
    assert MarkerSet.from_toml(marker_set.to_toml(), "set") == marker_set


ANYTHING = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=6)
    | st.sampled_from(["thigh", "left thigh", "C7", "pelvis"]),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["segment", "place", "spread", "wand", "plate", "landmark", "x"]), inner, max_size=5)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.sampled_from(["LTHI", "RTHI", "C7", "none"]), ANYTHING, max_size=4) | ANYTHING)
def test_whatever_stands_there_is_a_place_or_one_sentence(table: object):
    try:
        fields = fields_of({"markers": ["LTHI", "RTHI", "C7"], "pairs": [["LTHI", "RTHI"]], "places": table}, "my.toml")
    except (AsterismError, ValueError) as problem:
        assert "\n" not in str(problem) or any("\n" in str(part) for part in (table if isinstance(table, dict) else [table]))
    else:
        assert all(isinstance(place, Place) for place in fields["places"].values())


@cache
def worn_by(name: str, plate_shape: float = 0.008) -> np.ndarray:
    """(people, M, 3) m, each marker in its segment's axes, on five virtual people of 1.2 to 2.0 m."""
    marker_set, rules = MarkerSet.load(name), BuildRules()
    rng = np.random.default_rng(1)
    return np.array(
        [
            put_on(rng, random_build(rng, height, rules), marker_set, WearRules(plate_shape=plate_shape)).at
            for height in np.linspace(1.2, 2.0, 5)
        ]
    )


@pytest.mark.parametrize("name", shipped_marker_sets())
def test_virtual_people_wear_every_shipped_set(name: str):
    """Each marker is seen in every frame, and no two of them lie within a marker's diameter of each other on most people."""
    recordings = virtual_people(name, people=2, frames=20, seed=1)
    assert {recording.labels for recording in recordings} == {MarkerSet.load(name).names}
    assert all(np.isfinite(recording.positions).all() for recording in recordings)
    segments = np.array([place.segment for place in MarkerSet.load(name).places.values()])
    apart = np.median(np.linalg.norm(worn_by(name)[:, :, None] - worn_by(name)[:, None], axis=3), axis=0)
    apart[segments[:, None] != segments] = 1.0
    np.fill_diagonal(apart, 1.0)
    assert apart.min() > DIAMETER


@pytest.mark.parametrize("name", [name for name in shipped_marker_sets() if any(p.plate for p in MarkerSet.load(name).places.values())])
def test_a_plate_keeps_its_shape_on_everybody(name: str):
    """On a child as on a tall adult its markers are as far from each other as in the table, whichever way it is strapped on."""
    places = MarkerSet.load(name).places
    for plate in {place.plate for place in places.values() if place.plate}:
        on = [i for i, place in enumerate(places.values()) if place.plate == plate]
        table = np.array(
            [np.multiply(p.at, (1.0, 1.0, BONES[p.plain_segment] if p.limb else 1.0)) for p in places.values() if p.plate == plate]
        )
        meant = np.linalg.norm(table[:, None] - table, axis=2)
        for person in worn_by(name, 0.0):
            assert np.allclose(np.linalg.norm(person[on][:, None] - person[on], axis=2), meant)
