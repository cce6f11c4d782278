"""Characters of other proportions move as a person does: feet stay where they stand, above the floor, whatever the skeleton is like."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from asterism.cli import main
from asterism.errors import AsterismError
from asterism.formats import read_skeleton, write_skeleton
from asterism.recording import Event, SkeletonMotion
from asterism.skeleton.retargeting import body_parts, find_contacts, retarget
from asterism.skeleton.retargeting.contacts import stretches
from asterism.skeleton.retargeting.legs import bend, smooth_hull, smooth_offsets, within_reach
from tests.characters import character, stepping_person, virtual_person

UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def walker() -> SkeletonMotion:
    return virtual_person("walk")


def upright(motion: SkeletonMotion) -> SkeletonMotion:
    return motion.in_axes(UP, AHEAD)


def renamed(motion: SkeletonMotion, names: dict[str, str]) -> SkeletonMotion:
    return replace(motion, names=tuple(names.get(name, name) for name in motion.names))


def joint(motion: SkeletonMotion, name: str) -> np.ndarray:
    return upright(motion).joints[:, motion.names.index(name)]


def test_contacts_are_found_when_feet_stand_to_a_few_frames() -> None:
    person = stepping_person()
    found = find_contacts(person, body_parts(person))
    time = np.arange(len(person)) / person.rate
    for side, begin in (("left", 0.0), ("right", 0.6)):
        phase = ((time + begin) / 1.2) % 1.0
        for p in range(2):
            wrong = found.standing[side][:, p] != (phase < 0.6)
            # feet leave and touch without speed in this person, so that ends are soft
            assert wrong.mean() < 0.12, f"{side} {p}: {wrong.sum()} frames of {len(time)}"
            assert not (wrong & (np.abs(phase - 0.3) < 0.2)).any(), "none within a stance"


@pytest.mark.parametrize(("legs", "arms"), [(0.7, 1.4), (1.0, 1.0), (1.4, 0.7)])
@pytest.mark.parametrize("movement", ["step", "walk", "stairs", "squat"])
def test_feet_neither_slip_nor_sink_whatever_the_proportions(movement: str, legs: float, arms: float) -> None:
    person = stepping_person() if movement == "step" else virtual_person(movement)
    result = retarget(person, character(legs, arms))
    assert result.before.slip > 0.001, "m: a copy slips"
    assert result.after.slip < 0.001 and result.after.deepest < 0.001, "m, asked 5 mm"
    # by joints, which the measure knows nothing of: while heel and ball both stand, ankle and toes stay, and are above the floor
    motion = upright(result.motion)
    still = 0
    for side, name in (("left", "Left"), ("right", "Right")):
        for a, b in stretches(result.contacts.standing[side].all(axis=1)):
            for part in ("Foot", "ToeBase"):
                path = joint(result.motion, name + part)[a:b]
                assert np.ptp(path, axis=0).max() < 0.001, f"{name}{part} moves, m"
            still += b - a
    assert still > 5, "frames"
    assert motion.joints[:, :, 2].min() > -1e-6 and np.nanmin(motion.tips[:, :, 2]) > -1e-6, "m, all bones"
    # nothing jumps: from frame to frame no joint is faster than its copy by more than a step of 1 m in 0.1 s
    faster = np.abs(np.diff(motion.joints, axis=0)).max() - np.abs(np.diff(upright(result.copied).joints, axis=0)).max()
    assert faster < 0.1 * person.rate**-1 * 100, "m"


def test_a_straight_knee_that_has_to_bend_a_little_does_not_jump() -> None:
    """A leg that hyperextends by 3 degrees and wobbles by 1 to the side, while its foot has to come up by 12 mm."""
    time = np.arange(200) / 100
    flexion, side = np.radians(3 * np.sin(4 * time)), np.radians(np.sin(23 * time))
    zero = np.zeros(200)
    hip = np.stack([zero, zero, zero + 0.9], axis=1)
    knee = hip + 0.45 * np.stack([zero, zero, zero - 1], axis=1)
    ankle = knee + 0.45 * np.stack([-np.sin(flexion), np.sin(side), -np.cos(flexion) * np.cos(side)], axis=1)
    upper, _ = bend(hip, knee, ankle, ankle + np.array([0.0, 0.0, 0.012]), np.tile([0.0, 1.0, 0.0], (200, 1)))
    path = hip + np.einsum("tij,tj->ti", upper, knee - hip)
    assert (path[:, 0] > 0.05).all(), "m: it always bends ahead"
    assert np.linalg.norm(np.diff(path, 2, axis=0), axis=1).max() * 1e4 < 30, "m/s2"


def test_a_leg_comes_straight_slowly() -> None:
    hip, knee, ankle = np.zeros((100, 3)), np.tile([0.0, 0.0, -0.45], (100, 1)), np.tile([0.01, 0.0, -0.9], (100, 1))
    far = np.stack([np.zeros(100), np.zeros(100), -np.linspace(0.85, 0.95, 100)], axis=1)
    still, moving = np.ones(100, dtype=bool), np.zeros(100, dtype=bool)
    near = [within_reach(hip, far, 0.9, stands, 100.0) for stands in (moving, still)]
    inside = np.linalg.norm(far, axis=1) < 0.8955
    assert np.abs(near[1] - far)[inside].max() < 0.0004 < np.abs(near[0] - far)[inside].max() < 0.004, "m"
    assert max(np.linalg.norm(one, axis=1).max() for one in near) < 0.9
    speeds = [
        np.linalg.norm(
            np.diff(np.einsum("tij,tj->ti", bend(hip, knee, ankle, one, np.tile([0.0, 1.0, 0.0], (100, 1)))[0], knee), axis=0), axis=1
        )
        for one in (near[0], far)
    ]
    assert speeds[0].max() < 0.5 * speeds[1].max(), "the knee is slower than if the ankle was stopped at once"


def test_without_holding_feet_the_copy_is_what_comes_out(walker: SkeletonMotion) -> None:
    result = retarget(walker, character(0.7), feet=False)
    assert result.after.slip == result.before.slip > 0.003
    assert np.array_equal(result.motion.rotations, result.copied.rotations)


def test_a_person_mapped_to_their_own_bones_moves_as_before(walker: SkeletonMotion) -> None:
    result = retarget(walker, walker, feet=False)
    assert result.scale == pytest.approx(1.0)
    assert np.allclose(result.motion.rotations, walker.rotations, atol=1e-9)
    apart = result.motion.root - walker.root
    assert np.abs(apart - apart[0]).max() < 0.02, "m: the floor is laid level"
    held = retarget(walker, walker).motion
    assert np.abs(held.joints - result.motion.joints)[:, :3].max() < 0.03, "m: the trunk hardly moves when feet are held"


@pytest.mark.parametrize("down", [0.0, 45.0, 80.0])
def test_arms_point_where_the_persons_do_from_any_rest_pose(walker: SkeletonMotion, down: float) -> None:
    motion = upright(retarget(walker, character(down=down)).motion)
    for side in ("left", "right"):
        name = side.capitalize()
        for upper, lower, ours, theirs in (("Arm", "ForeArm", "upper arm", "forearm"), ("ForeArm", "Hand", "forearm", "hand")):
            bone = joint(motion, name + lower) - joint(motion, name + upper)
            person = joint(walker, f"{side} {theirs}") - joint(walker, f"{side} {ours}")
            cosine = (bone * person).sum(axis=1) / np.linalg.norm(bone, axis=1) / np.linalg.norm(person, axis=1)
            assert cosine.min() > 1 - 1e-9, f"{name}{upper}"


@pytest.mark.parametrize("spine", [1, 3, 6])
def test_a_trunk_is_shared_out_over_any_number_of_bones(walker: SkeletonMotion, spine: int) -> None:
    motion = upright(retarget(walker, character(spine=spine)).motion)
    names = ["Hips", "Spine", *(f"Spine{i}" for i in range(1, spine))]
    turned = [motion.turned[:, motion.names.index(name)] for name in names]
    assert np.allclose(turned[-1], upright(walker).turned[:, 1], atol=1e-9), "the last one as the thorax"
    steps = [Rotation.from_matrix(a.swapaxes(1, 2) @ b).magnitude() for a, b in pairwise(turned)]
    assert np.ptp(steps, axis=0).max() < 1e-6, "rad: each a like share"


def test_hands_go_where_the_persons_are_in_the_characters_size(walker: SkeletonMotion) -> None:
    short = character(arms=1.15)
    placed, plain = (retarget(walker, short, hands=hands) for hands in (True, False))
    floor = find_contacts(walker, body_parts(walker)).floor
    for side in ("left", "right"):
        wrist = joint(walker, f"{side} hand")
        wanted = placed.scale * (wrist - (floor[0] + wrist[:, :2] @ floor[1:])[:, None] * UP)
        off = [np.linalg.norm(joint(one.motion, f"{side.capitalize()}Hand") - wanted, axis=1).max() for one in (placed, plain)]
        assert off[0] < 1e-6 < 0.02 < off[1], "m"
    assert placed.after.slip < 0.001
    assert np.allclose(joint(placed.motion, "LeftToeBase"), joint(plain.motion, "LeftToeBase"))


LACKING = [("toe",), ("hand",), ("clavicle",), ("neck",), ("neck", "head"), ("toe", "hand", "clavicle", "neck")]


@pytest.mark.parametrize("without", LACKING, ids="+".join)
def test_a_character_without_some_parts_stands_as_well(walker: SkeletonMotion, without: tuple[str, ...]) -> None:
    result = retarget(walker, character(0.8, without=without))
    assert result.after.slip < 0.001 and result.after.deepest < 0.001
    missing = [finding.sentence for finding in result.findings if finding.code == "retarget-parts-missing"]
    assert bool(missing) == bool({"hand", "head"} & set(without))


def with_more_bones(motion: SkeletonMotion) -> SkeletonMotion:
    """The same with fingers, twist bones, bones of no length, a root on the floor, and bones for steering."""
    more = [
        ("LeftHandIndex1", "LeftHand"),
        ("LeftHandIndex2", "LeftHandIndex1"),
        ("RightForeArmTwist", "RightForeArm"),
        ("LeftLegZero", "LeftLeg"),
    ]
    names, parents, offsets, ends = (
        ["root", *motion.names],
        [-1, *(p + 1 for p in motion.parents)],
        [np.zeros(3), *motion.offsets],
        [np.full(3, np.nan), *motion.ends],
    )
    offsets[1] = np.array([0.0, 0.99, 0.0])
    parents[1] = 0
    for name, parent in [*more, ("ik_foot_l", "root")]:
        names.append(name)
        parents.append(names.index(parent))
        offsets.append(np.zeros(3) if name in ("LeftLegZero", "ik_foot_l") else np.array([0.04, 0.0, 0.0]))
        ends.append(np.zeros(3))
    rotations = np.tile(np.eye(3), (1, len(names), 1, 1))
    return SkeletonMotion(
        tuple(names), tuple(parents), np.array(offsets), np.array(ends), rotations, np.zeros((1, 3)), 30.0, motion.vertical, motion.forward
    )


def test_bones_that_are_none_of_a_body_go_along(walker: SkeletonMotion) -> None:
    plain, more = retarget(walker, character(0.8)), retarget(walker, with_more_bones(character(0.8)))
    for name in ("Hips", "Head", "LeftHand", "RightToeBase"):
        assert np.allclose(joint(more.motion, name), joint(plain.motion, name), atol=1e-6), name
    assert {"root", "LeftHandIndex1", "RightForeArmTwist", "ik_foot_l"} <= set(more.free)
    assert np.allclose(more.motion.turned[:, 0], np.eye(3)), "a root under the hips stays upright"


@pytest.mark.parametrize("factor", [0.0254, 1.0, 100.0])
def test_a_character_of_any_size_is_moved_alike(walker: SkeletonMotion, factor: float) -> None:
    # as a file of metres read as inches or the like would be
    plain, other = retarget(walker, character(0.9)), retarget(walker, character(0.9, size=factor))
    assert other.scale == pytest.approx(plain.scale * factor)
    assert np.allclose(other.motion.joints / factor, plain.motion.joints, atol=2e-3), "m"


def test_a_character_with_z_up_and_facing_elsewhere_is_moved_alike(walker: SkeletonMotion) -> None:
    turned = character(0.9).in_axes(UP, np.array([0.0, -1.0, 0.0]))
    other = retarget(walker, turned).motion
    assert other.vertical.tolist() == [0, 0, 1] and np.allclose(other.forward, [0, -1, 0])
    assert np.allclose(upright(other).joints, upright(retarget(walker, character(0.9)).motion).joints, atol=1e-9)


UNREAL = {"Hips": "pelvis", "Spine": "spine_01", "Spine1": "spine_02", "Spine2": "spine_03", "Neck": "neck_01", "Head": "head"} | {
    f"{name}{old}": f"{new}_{name[0].lower()}"
    for name in ("Left", "Right")
    for old, new in (
        ("Shoulder", "clavicle"), ("Arm", "upperarm"), ("ForeArm", "lowerarm"), ("Hand", "hand"),
        ("UpLeg", "thigh"), ("Leg", "calf"), ("Foot", "foot"), ("ToeBase", "ball"),
    )
}  # fmt: skip


def test_bones_are_found_by_where_they_hang_where_names_say_nothing(walker: SkeletonMotion) -> None:
    plain = retarget(walker, character(0.8))
    known = retarget(walker, renamed(character(0.8), UNREAL))
    assert np.allclose(known.motion.joints, plain.motion.joints) and not known.findings
    figure = character(0.8)
    nameless = renamed(figure, {name: f"bone{i:02d}" for i, name in enumerate(figure.names)})
    # files say nothing of left and right then: the reader's guess of ahead is z
    found = retarget(walker, nameless)
    assert [finding.code for finding in found.findings] == ["retarget-by-tree"]
    assert np.allclose(upright(found.motion).joints[:, 0], upright(plain.motion).joints[:, 0], atol=0.02)
    assert np.allclose(found.motion.joints[:, 8:], plain.motion.joints[:, 8:], atol=0.05), "m: clavicles may go as upper arms"
    assert found.after.slip < 0.001


def test_a_file_of_bones_decides(walker: SkeletonMotion, tmp_path: Path) -> None:
    misled = renamed(character(0.8), {"LeftUpLeg": "RightUpLeg2", "RightUpLeg": "LeftUpLeg", "RightUpLeg2": "x"})
    given = {"character": {"left thigh": "RightUpLeg2", "right thigh": "LeftUpLeg"}}
    assert np.allclose(retarget(walker, misled, bones=given).motion.joints, retarget(walker, character(0.8)).motion.joints)
    with pytest.raises(AsterismError, match="not one leg"):
        retarget(walker, misled)
    with pytest.raises(AsterismError, match="'Tail' that is given for left thigh is not there; the character has Hips"):
        retarget(walker, character(), bones={"character": {"left thigh": "Tail"}})


def dog() -> SkeletonMotion:
    """Its trunk lies level, and its hands stand beside its feet."""
    names = ["Hips", "Spine", "Neck", "Head"]
    parents, offsets = [-1, 0, 1, 2], [(0, 0, 0), (0, 0.02, 0.5), (0, 0.1, 0.2), (0, 0.1, 0.1)]
    for side, x in (("Left", 0.1), ("Right", -0.1)):
        for limb, above, z in (("UpLeg Leg Foot", 0, 0.0), ("Arm ForeArm Hand", 1, 0.0)):
            for i, part in enumerate(limb.split()):
                parents.append(above if not i else len(names) - 1)
                names.append(side + part)
                offsets.append((x if not i else 0.0, -0.05 if not i else -0.28, z))
    count = len(names)
    eye = np.tile(np.eye(3), (1, count, 1, 1))
    ends = np.where(np.isin(np.arange(count), parents)[:, None], np.nan, np.array([0.0, 0.0, 0.05]))
    return SkeletonMotion(
        tuple(names),
        tuple(parents),
        np.array(offsets, float),
        ends,
        eye,
        np.array([[0, 0.6, 0]]),
        30.0,
        np.array([0.0, 1, 0]),
        np.array([0.0, 0, 1]),
    )


def test_four_legs_and_no_legs_are_refused_in_a_sentence(walker: SkeletonMotion) -> None:
    with pytest.raises(AsterismError, match="four legs"):
        retarget(walker, dog())
    with pytest.raises(AsterismError, match=r"no bone for left thigh.*TOML"):
        retarget(
            walker,
            SkeletonMotion(("a", "b"), (-1, 0), np.eye(3)[:2], np.eye(3)[:2], np.tile(np.eye(3), (1, 2, 1, 1)), np.zeros((1, 3)), 1.0),
        )
    gap = replace(walker, root=np.where(np.arange(len(walker))[:, None] == 5, np.nan, walker.root))
    with pytest.raises(AsterismError, match="missing in some frames"):
        retarget(gap, character())


def resting_oddly(motion: SkeletonMotion) -> SkeletonMotion:
    """The same joints over time from a rest pose that is none, as libraries of motions have it: bones lie anyhow."""
    odd = Rotation.random(len(motion.names), random_state=1).as_matrix()
    turned, above = motion.turned @ odd, [max(p, 0) for p in motion.parents]
    rotations = turned[:, above].swapaxes(2, 3) @ turned
    rotations[:, 0] = turned[:, 0]
    offsets, ends = np.einsum("bji,bj->bi", odd[above], motion.offsets), np.einsum("bji,bj->bi", odd, motion.ends)
    return replace(motion, rotations=rotations, offsets=offsets, ends=ends, forward=np.array([0.3, -0.5, 0.1]))


def test_a_rest_pose_that_is_none_is_replaced_by_a_frame_that_stands(walker: SkeletonMotion) -> None:
    strange, plain = resting_oddly(walker), retarget(walker, character(0.8))
    assert np.allclose(strange.joints, walker.joints)
    as_person, as_character = retarget(strange, character(0.8)), retarget(walker, strange)
    for result, expected in ((as_person, plain), (as_character, retarget(walker, walker))):
        assert "retarget-rest-pose" in [finding.code for finding in result.findings]
        assert result.after.slip < 0.001
        # heading is free, because such a rest pose faces nowhere: lengths between joints are not
        ours, theirs = upright(result.motion).joints, upright(expected.motion).joints
        names = [name.casefold() for name in expected.motion.names]
        ends = [next(i for i, name in enumerate(names) if "left" in name and name.endswith(part)) for part in ("hand", "foot")] + [
            names.index("head"),
            0,
        ]
        for i in ends:
            for j in ends:
                apart = np.linalg.norm(ours[:, i] - ours[:, j], axis=1) - np.linalg.norm(theirs[:, i] - theirs[:, j], axis=1)
                assert np.abs(apart).max() < 0.12, f"{names[i]} to {names[j]}, m"
    with pytest.raises(AsterismError, match="neither the rest pose of the character nor any of its frames stands upright"):
        retarget(walker, replace(resting_oddly(walker), rotations=np.tile(np.eye(3), (len(walker), len(walker.names), 1, 1))))


def test_feet_on_a_treadmill_go_with_the_belt_and_do_not_slip_on_it() -> None:
    walker, belt = stepping_person(0.8), np.array([-0.8, 0.0, 0.0])
    travelled = np.arange(len(walker))[:, None] / walker.rate * belt
    result = retarget(replace(walker, root=walker.root + travelled), character(0.7))
    assert "retarget-treadmill" in [finding.code for finding in result.findings]
    assert np.allclose(result.contacts.belt, result.scale * belt, atol=0.01), "m/s"
    assert result.after.slip < 0.001
    motion = upright(result.motion)
    assert np.ptp(motion.root[:, 0]) < 0.1, "m: the body stays"
    on_floor = replace(motion, root=motion.root - result.scale * travelled)
    for a, b in stretches(result.contacts.standing["left"].all(axis=1)):
        assert np.ptp(joint(on_floor, "LeftFoot")[a:b], axis=0).max() < 0.005, "m, on the true belt"


def test_events_say_when_a_foot_stands_and_the_movement_says_it_elsewhere(walker: SkeletonMotion) -> None:
    parts = body_parts(walker)
    free = find_contacts(walker, parts)
    a, b = stretches(free.standing["left"].any(axis=1))[1]
    events = [Event("Foot Strike", (a + 4) / walker.rate, "Left"), Event("Foot Off", (b - 4) / walker.rate, "L")]
    told = find_contacts(walker, parts, events)
    assert told.source == "events" and free.source == "movement"
    assert np.array_equal(told.standing["right"], free.standing["right"])
    # before the strike and behind the off nothing is told: the movement decides; between them, all of it stands
    assert told.standing["left"][a + 4 : b - 4].any(axis=1).all()
    swing = [Event("Foot Off", a / walker.rate, "Left"), Event("Foot Strike", b / walker.rate, "Left")]
    assert not find_contacts(walker, parts, swing).standing["left"][a + 1 : b - 1].any()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_a_bent_limb_reaches_its_target_with_its_own_lengths_and_turns_no_more_than_it_must(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root, middle, end = rng.normal(size=(3, 6, 3))
    lengths = np.linalg.norm(middle - root, axis=1), np.linalg.norm(end - middle, axis=1)
    direction = rng.normal(size=(6, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    far = rng.uniform(np.abs(lengths[0] - lengths[1]) * 1.01, sum(lengths) * 0.99)
    target = root + far[:, None] * direction
    upper, lower = bend(root, middle, end, target, rng.normal(size=(6, 3)))
    knee = root + np.einsum("tij,tj->ti", upper, middle - root)
    assert np.allclose(knee + np.einsum("tij,tj->ti", lower, end - middle), target, atol=1e-6)
    for turn in (upper, lower):
        assert np.allclose(turn @ turn.swapaxes(1, 2), np.eye(3), atol=1e-9) and np.allclose(np.linalg.det(turn), 1)
    flexed = np.linalg.norm(np.cross(middle - root, end - middle), axis=1) / lengths[0] / lengths[1] > 0.6
    same, also = bend(root, middle, end, end, rng.normal(size=(6, 3)))
    assert np.allclose(same[flexed], np.eye(3), atol=1e-4) and np.allclose(also[flexed], np.eye(3), atol=1e-4)
    away = bend(root, middle, end, root + 100 * direction, rng.normal(size=(6, 3)))
    tip = np.einsum("tij,tj->ti", away[0], middle - root) + np.einsum("tij,tj->ti", away[1], end - middle)
    assert np.allclose(np.linalg.norm(tip, axis=1), sum(lengths), rtol=1e-3), "a target out of reach straightens it"


def test_limbs_without_a_plane_or_a_length_stay_limbs() -> None:
    root, middle, end = np.array([[0.0, 0, 0.9]]), np.array([[0.0, 0, 0.45]]), np.array([[0.0, 0, 0.0]])
    for along in (end, middle, root, np.array([[0.0, 0.0, 2.0]])):
        for elbow in (middle, root):
            for turn in bend(root, elbow, end, along, np.array([[0.0, 0.0, 1.0]])):
                assert np.isfinite(turn).all() and np.allclose(turn @ turn.swapaxes(1, 2), np.eye(3), atol=1e-9)


@pytest.mark.parametrize("frames", [1, 2, 3, 8])
@pytest.mark.parametrize("hands", [False, True])
def test_a_few_frames_are_enough(frames: int, hands: bool) -> None:
    person = stepping_person(seconds=0.1)
    result = retarget(replace(person, rotations=person.rotations[:frames], root=person.root[:frames]), character(0.7), hands=hands)
    assert len(result.motion) == frames and result.after.slip < 0.001 and result.after.deepest < 0.001


def test_a_knee_that_is_straight_bends_ahead_of_the_shank(walker: SkeletonMotion) -> None:
    hip, knee, ankle = np.array([[0.0, 0, 0.9]]), np.array([[0.0, 0, 0.45]]), np.array([[0.0, 0, 0.0]])
    upper, _ = bend(hip, knee, ankle, np.array([[0.0, 0.0, 0.1]]), np.array([[0.0, 1.0, 0.0]]))
    assert (hip + np.einsum("tij,tj->ti", upper, knee - hip))[0, 0] > 0.1, "m: the knee goes ahead"


def test_corrections_come_and_go_smoothly_and_are_whole_where_they_count() -> None:
    weight, wanted = np.zeros((300, 1)), np.zeros((300, 1, 1))
    weight[100:150], wanted[100:150] = 1.0, 0.05
    curve = smooth_offsets(wanted, weight, 100.0)[:, 0]
    assert np.abs(curve[100:150] - 0.05).max() < 1e-4, "m"
    assert np.abs(curve[:60]).max() < 1e-3 and np.abs(curve[190:]).max() < 1e-3 and curve.min() > -1e-4, (
        "gone within 0.4 s, without overshoot"
    )
    # 50 mm that come in 0.12 s: at most 13 m/s2
    assert np.abs(np.diff(curve, 2)).max() * 1e4 < 40, "m/s2"
    free = smooth_offsets(wanted + np.linspace(0, 0.01, 300)[:, None, None], weight, 100.0, [(0, 100, 150)])[:, 0]
    assert np.ptp(free[100:150] - np.linspace(0, 0.01, 300)[100:150]) < 1e-4 and np.abs(free).max() < 0.01, "a constant is free"
    hull = smooth_hull(np.maximum(np.sin(np.arange(300) / 15), 0), 100.0)
    assert (hull >= np.maximum(np.sin(np.arange(300) / 15), 0)).all() and hull.max() <= 1.0


def test_the_command_moves_a_character_in_both_formats_and_says_what_it_did(
    walker: SkeletonMotion, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_skeleton("walk.bvh", walker, unit="m")
    for name in ("troll.bvh", "troll.glb"):
        write_skeleton(name, character(0.7, 1.4))
        suffix = Path(name).suffix
        assert main(["retarget", "walk.bvh", "-c", name, "-o", f"out{suffix}", "--json", f"{suffix[1:]}.json"]) == 0
        out = capsys.readouterr().out
        assert "LeftUpLeg" in out and "They slip by up to 0.0 mm (bones only copied: " in out
        told = json.loads(Path(f"{suffix[1:]}.json").read_text())
        assert told["feet"]["slip_mm"] < 1 < told["feet_copied"]["slip_mm"] and told["bones"][0]["bone"] == "Hips"
        found = read_skeleton(f"out{suffix}").motion
        assert len(found) == len(walker) and found.names == read_skeleton(name).motion.names and found.rate == 100.0
    text, old = (Path(name).read_text().split("MOTION")[0] for name in ("out.bvh", "troll.bvh"))
    assert text == old
    # a character in BVH can become a body in glTF
    assert main(["retarget", "walk.bvh", "-c", "troll.bvh", "-o", "other.glb"]) == 0
    assert np.allclose(read_skeleton("other.glb").motion.joints[5], read_skeleton("out.bvh").motion.joints[5], atol=1e-4)
    assert main(["retarget", "walk.bvh", "-c", "troll.glb", "-o", "nowhere/other.glb"]) == 2, "a folder that is not there"
    capsys.readouterr()
    Path("bones.toml").write_text('[character]\n"left knee" = "LeftLeg"\n')
    assert main(["retarget", "walk.bvh", "-c", "troll.bvh", "-o", "n.bvh", "--bones", "bones.toml"]) == 2
    assert "'left knee' = 'LeftLeg' is no part" in capsys.readouterr().err
    assert main(["retarget", "walk.bvh", "-c", "walk.c3d", "-o", "n.bvh"]) == 2
    assert main(["retarget", "walk.bvh", "-c", "troll.bvh", "-o", "troll.bvh", "--overwrite"]) == 2, "an input is not replaced"
    assert not Path("n.bvh").exists()


def test_a_recording_of_markers_becomes_bones_in_both_formats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from asterism.formats import write
    from asterism.simulation import simulate_walks

    monkeypatch.chdir(tmp_path)
    write("walk.c3d", simulate_walks(1, frames=60, seed=0)[0])
    assert main(["convert", "walk.c3d", "walk.bvh", "--unit", "m", "--euler", "xyz"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "the axes of the room: its x, y, z became z, x, y" in told and "blanks in the names of bones, which became _" in told
    assert "Xrotation Yrotation Zrotation" in Path("walk.bvh").read_text()
    found = read_skeleton("walk.bvh", unit="m").motion
    assert len(found) == 60 and found.vertical.tolist() == [0, 1, 0]
    foot = found.joints[:, found.names.index("left_foot"), 1]
    assert 0.0 < foot.min() < 0.2, "m, the ankle over the floor"
    assert main(["convert", "walk.bvh", "walk.glb", "--unit", "m"]) == 0
    assert np.allclose(read_skeleton("walk.glb").motion.joints, found.joints, atol=1e-5)
    assert main(["convert", "walk.c3d", "n.glb", "--fill", "auto"]) == 2
    assert "holds bones and no markers; leave out --for, --fill and --filter" in " ".join(capsys.readouterr().err.split())
    assert main(["convert", "walk.bvh", "walk.trc"]) == 2
    assert main(["convert", "walk.c3d", "n.bvh", "--euler", "xxz"]) == 2


def test_a_missing_leg_is_told_of_the_skeleton_that_lacks_it(walker: SkeletonMotion) -> None:
    lame = {"left foot": ""}
    with pytest.raises(AsterismError, match="the recording has no bone for left foot"):
        retarget(walker, walker, bones={"person": lame})
    with pytest.raises(AsterismError, match="the character has no bone for left foot"):
        retarget(walker, walker, bones={"character": lame})
