"""Virtual people: what every body, posture and movement of theirs must hold."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism import AsterismError
from asterism.recording import MarkerSet
from asterism.recording.place import other_side
from asterism.skeleton import MOVEMENTS, BuildRules, VirtualRules, WearRules, virtual_people
from asterism.skeleton.angles import ANGLES, ANKLE_DEG, COLUMN, LIMITS_DEG, mirrored, shank_tilt
from asterism.skeleton.build import random_build
from asterism.skeleton.kinematics import markers, pose
from asterism.skeleton.postures import like_a_recorded_one, recorded_postures
from asterism.skeleton.worn import Worn


def test_same_seed_same_people_whoever_else_there_is() -> None:
    one, other = virtual_people("helen-hayes", 3, 60, seed=5), virtual_people("helen-hayes", 3, 60, seed=5)
    assert all(np.array_equal(a.positions, b.positions) for a, b in zip(one, other, strict=True))
    different = virtual_people("helen-hayes", 3, 60, seed=6)
    assert not any(np.array_equal(a.positions, b.positions) for a, b in zip(one, different, strict=True))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32), name=st.sampled_from(sorted(MOVEMENTS)))
def test_joints_stay_within_their_limits_and_move_smoothly(seed: int, name: str) -> None:
    time = np.arange(60) / 50.0
    motion = MOVEMENTS[name](time, np.random.default_rng(seed))
    degrees = np.degrees(motion.angles)
    for column, angle in enumerate(ANGLES):
        if angle.endswith("pitch"):
            continue
        low, high = LIMITS_DEG[angle.split()[-1]]
        assert low - 1e-9 <= degrees[:, column].min()
        assert degrees[:, column].max() <= high + 1e-9
    for side in ("left", "right"):
        ankle = degrees[:, COLUMN[f"{side} pitch"]] + np.degrees(shank_tilt(motion.angles, side))
        assert ANKLE_DEG[0] - 1e-9 <= ankle.min()
        assert ankle.max() <= ANKLE_DEG[1] + 1e-9
    # 40 rad/s is more than any joint does outside of a pitcher's shoulder
    assert np.abs(np.diff(degrees, axis=0)).max() < np.degrees(40.0) / 50.0
    assert motion.above.min() >= 0.0


@pytest.mark.parametrize("name", sorted(MOVEMENTS))
def test_people_are_on_the_floor_and_no_marker_jumps(name: str) -> None:
    """Whatever touches it: a marker sinks in by what skin and hands move it at most, and someone is never far above, but in a jump."""
    rules = VirtualRules(share=((name, 1.0),))
    for recording in virtual_people("plug-in-gait", 2, 60, rate=100.0, seed=2, rules=rules):
        lowest = recording.positions[:, :, 2].min(axis=1)
        assert lowest.min() > -0.06
        assert lowest.max() < (0.5 if "jump" in name else 0.25)
        # 20 m/s is a pitcher's hand
        assert np.abs(np.diff(recording.positions, axis=0)).max() < 0.20


def test_who_lies_is_flat_and_who_jumps_is_off_the_floor() -> None:
    heights = {}
    for name in ("stand", "lie", "jump"):
        rules = VirtualRules(share=((name, 1.0),), take=((name, 300),))
        recordings = virtual_people("plug-in-gait", 3, 300, seed=1, rules=rules)
        heights[name] = np.array([np.ptp(recording.positions[:, :, 2], axis=1).min() for recording in recordings])
        if name == "jump":
            assert all(recording.positions[:, :, 2].min(axis=1).max() > 0.2 for recording in recordings)
    assert (heights["lie"] < 0.5).all()
    assert (heights["stand"] > 1.0).all()


def test_a_forearm_turns_gradually_from_the_elbow_to_the_wrist() -> None:
    """Half a turn of the palm: markers at the wrist go round wholly, one in the middle by half of that, none at the elbow."""
    build = random_build(np.random.default_rng(0), 1.7, BuildRules(proportion=0.0, asymmetry=0.0, short_limb=0.0))
    along = np.array([0.0, 0.5, 1.0])
    at = np.stack([np.zeros(3), np.full(3, 0.04), -along * build.bones["left forearm"]], axis=1)
    worn = Worn(("left forearm",) * 3, at, np.zeros((3, 3, len(ANGLES))), along, np.zeros(3))
    angles = np.zeros((2, len(ANGLES)))
    angles[1, COLUMN["left palm"]] = np.radians(90.0)
    positions = markers(worn, pose(build, angles), angles)
    moved = np.linalg.norm(positions[1] - positions[0], axis=1)
    # chords of a circle of 40 mm
    assert moved == pytest.approx(2 * 0.04 * np.sin(np.radians([0.0, 22.5, 45.0])), abs=1e-9)


def test_left_and_right_mirror_each_other_among_many() -> None:
    marker_set = MarkerSet.load("helen-hayes")
    quiet = VirtualRules(share=(("stand", 1.0),))
    widths = []
    for recording in virtual_people(marker_set, 60, 12, seed=3, rules=quiet):
        left, right, back = (recording.positions[:, marker_set.names.index(name)] for name in ("LKNE", "RKNE", "SACR"))
        widths.append((np.linalg.norm(left - back, axis=1).mean(), np.linalg.norm(right - back, axis=1).mean()))
    left, right = np.mean(widths, axis=0)
    # 60 people whose knees differ by 2 cm: the mean of differences is within 4 standard errors
    assert abs(left - right) < 4 * np.std(np.diff(widths, axis=1)) / np.sqrt(60) + 1e-9


def test_markers_of_one_plate_move_as_one() -> None:
    marker_set = MarkerSet.load("cast")
    plates = {place.plate for place in marker_set.places.values() if place.plate}
    assert plates
    for recording in virtual_people(marker_set, 2, 60, seed=4, rules=VirtualRules(noise=0.0)):
        for plate in plates:
            own = [m for m, name in enumerate(marker_set.names) if marker_set.places[name].plate == plate]
            first = recording.positions[:, own[0]]
            for m in own[1:]:
                assert np.ptp(np.linalg.norm(recording.positions[:, m] - first, axis=1)) < 1e-9


def test_a_plate_is_as_large_on_a_child_as_on_a_tall_adult() -> None:
    marker_set = MarkerSet.load("cast")
    plate = next(place.plate for place in marker_set.places.values() if place.plate)
    first, last = [m for m, name in enumerate(marker_set.names) if marker_set.places[name].plate == plate][::3]

    def sizes(wear: WearRules) -> tuple[list[float], list[float]]:
        people = virtual_people(marker_set, 3, 20, rules=VirtualRules(noise=0.0, wear=wear))
        lengths = [float(np.linalg.norm(person.positions[0, first] - person.positions[0, last])) for person in people]
        return [float(person.metadata["height"]) for person in people], lengths

    heights, lengths = sizes(WearRules(plate_shape=0.0))
    assert max(heights) - min(heights) > 0.2
    assert np.ptp(lengths) < 1e-6
    assert 0.001 < np.ptp(sizes(WearRules())[1]) < 0.06, "but laboratories make plates of their own"


def test_rods_swing_while_they_move_and_other_markers_do_not() -> None:
    still, swinging = (
        virtual_people("helen-hayes", 1, 60, rules=VirtualRules(wear=WearRules(swing=swing), share=(("run", 1.0),), noise=0.0))[0]
        for swing in (0.0, 0.003)
    )
    moved = np.abs(swinging.positions - still.positions).max(axis=(0, 2))
    rods = [place.wand for place in MarkerSet.load("helen-hayes").places.values()]
    assert (moved[rods] > 0.001).all()
    assert (moved[rods] < 0.03).all()


def test_a_posture_in_the_mirror_is_the_posture_of_the_mirrored_body() -> None:
    build = random_build(np.random.default_rng(1), 1.7, BuildRules(asymmetry=0.0, short_limb=0.0))
    angles = like_a_recorded_one(np.random.default_rng(2), ())[None]
    seen, other = pose(build, angles), pose(build, mirrored(angles))
    for segment in seen.origin:
        assert other.origin[other_side(segment)] == pytest.approx(seen.origin[segment] * (1.0, -1.0, 1.0), abs=1e-9)


def test_recorded_postures_are_within_limits_and_can_be_left_out() -> None:
    recorded = recorded_postures()
    for rows in recorded.values():
        assert rows.shape[1] == len(ANGLES)
    all_of_them, without = (
        virtual_people("helen-hayes", 1, 200, rules=VirtualRules(share=(("move", 1.0),), without=left_out))[0]
        for left_out in ((), tuple(recorded)[:-1])
    )
    assert not np.array_equal(all_of_them.positions, without.positions)
    with pytest.raises(AsterismError, match="no recorded postures of nobody"):
        VirtualRules(without=("nobody",))


@pytest.mark.parametrize("arguments", [{"people": 0}, {"frames": 2}, {"rate": 0.0}, {"rate": float("nan")}])
def test_numbers_that_make_no_people_are_refused(arguments: dict[str, float]) -> None:
    with pytest.raises(AsterismError, match="cannot be made"):
        virtual_people("helen-hayes", **arguments)  # type: ignore[arg-type]


def test_a_set_without_places_is_refused_by_the_marker_that_lacks_one() -> None:
    with pytest.raises(AsterismError, match="where LASI sits"):
        virtual_people(MarkerSet(("LASI", "RASI")))


def test_movements_that_nobody_knows_are_refused() -> None:
    with pytest.raises(AsterismError, match="do not know how to fly"):
        VirtualRules(share=(("fly", 1.0),))
