"""Linking points to tracklets, against simulated truth, plain twins and hostile clouds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins_links import combine_directions as combine_plainly
from twins_links import expected, is_cut, link_forward, strays
from twins_links import repair_links as repair_plainly

from asterism.formats import read
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Recording
from asterism.simulation import simulate_walks
from asterism.tracking._cut_kernels import count_strays, find_cuts, repair_links
from asterism.tracking._prediction_kernels import predict_tracks
from asterism.tracking.chain_kernels import combine_directions, number_chains, sort_frames
from asterism.tracking.columns import columns_of, pack_tracklets
from asterism.tracking.link_kernels import link_frames, link_step
from asterism.tracking.link_workspace_kernels import Links, make_link_workspace, make_track_ends
from asterism.tracking.linking import LinkRules, Tracklets, _along_numbers, find_tracklets

pytestmark = pytest.mark.kernels

MOVEMENT = (
    "cmu41/01_01_climb.c3d",
    "cmu41/02_05_punch.c3d",
    "cmu41/85_02.c3d",
    "sprint53/run0700cms.trc",
    "optitrack-lower/rizzoli24/jumping_jacks_001.c3d",
    "running42/run300.trc",
)


@cache
def walks(rate: float = 100.0, markers: str = "helen-hayes") -> list[Recording]:
    return simulate_walks(subjects=3, frames=300, rate=rate, seed=5, markers=markers)


def frame_of(clouds: Clouds) -> np.ndarray:
    return np.repeat(np.arange(len(clouds)), clouds.counts)


def links_of(tracklets: Tracklets, clouds: Clouds) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of points that a tracklet joins."""
    order = np.lexsort((frame_of(clouds), tracklets.of_point))
    same = tracklets.of_point[order[:-1]] == tracklets.of_point[order[1:]]
    return order[:-1][same], order[1:][same]


def score(tracklets: Tracklets, clouds: Clouds, truth: np.ndarray) -> tuple[int, int, int]:
    """Wrong links, missing links, links that there are in truth."""
    marker = np.full(len(clouds.xyz), -1)
    frames, markers = np.nonzero(truth >= 0)
    marker[clouds.offsets[frames] + truth[frames, markers]] = markers
    before, after = links_of(tracklets, clouds)
    right = (marker[before] == marker[after]) & (marker[before] >= 0)
    there = int(((truth[1:] >= 0) & (truth[:-1] >= 0)).sum())
    return int((marker[before] != marker[after]).sum()), there - int(right.sum()), there


def check(tracklets: Tracklets, clouds: Clouds) -> None:
    """What every answer must keep."""
    assert tracklets.of_point.shape == (len(clouds.xyz),)
    frames = frame_of(clouds)
    for j in range(len(tracklets)):
        own = np.sort(frames[tracklets.of_point == j])
        assert own.tolist() == list(range(tracklets.first[j], tracklets.last[j] + 1))


def columns(recording: Recording) -> np.ndarray:
    """(T, M) tracklet of every sample, -1 where there is none."""
    clouds = recording.clouds()
    out = np.full(recording.visible.shape, -1)
    out[frame_of(clouds), clouds.columns] = find_tracklets(clouds).of_point
    return out


def cuts(recording: Recording) -> int:
    of = columns(recording)
    return int(((of[1:] >= 0) & (of[:-1] >= 0) & (of[1:] != of[:-1])).sum())


def swapped(recording: Recording, rng: np.random.Generator, length: int | None = None) -> tuple[Recording, int, int, int]:
    """Two neighbouring columns exchanged from a frame on."""
    positions = recording.positions.copy()
    while True:
        t = int(rng.integers(5, len(recording) - 10))
        i = int(rng.integers(positions.shape[1]))
        away = np.linalg.norm(positions[t] - positions[t, i], axis=1)
        j = int(np.argsort(np.where(np.isnan(away), np.inf, away))[1 + rng.integers(2)])
        if not np.isnan(positions[t - 1 : t + 1][:, [i, j]]).any():
            break
    until = len(recording) if length is None else t + length
    positions[t:until, [i, j]] = positions[t:until, [j, i]]
    return replace(recording, positions=positions), i, j, t


@pytest.mark.parametrize("rate", [50.0, 100.0, 240.0])
@pytest.mark.parametrize(("hidden", "ghosts"), [(0, 0), (3, 0), (5, 0), (3, 3)])
def test_motion_links_walkers_without_a_wrong_link(rate: float, hidden: int, ghosts: int) -> None:
    wrong, missing, there = 0, 0, 0
    for i, walk in enumerate(walks(rate)):
        clouds, truth = simulate_gaps_and_ghosts(walk, hidden, ghosts, i, number_tracks=False)
        tracklets = find_tracklets(clouds)
        check(tracklets, clouds)
        parts = score(tracklets, clouds, truth)
        wrong, missing, there = wrong + parts[0], missing + parts[1], there + parts[2]
    assert wrong == 0, f"{wrong} of {there} links are wrong"
    assert missing <= 0.005 * there, f"{missing} of {there} links are missing"


def test_a_link_where_nothing_can_be_known_is_not_made() -> None:
    """Two points that cross within a millimetre of each other: whichever way they went, no tracklet passes the place."""
    t = np.arange(41)[:, None] / 100.0
    one = np.concatenate([t, 0.0 * t, 0.0 * t], axis=1)
    other = np.concatenate([t, 0.0 * t + 0.0005, 0.0 * t], axis=1)
    clouds = Clouds.from_points(np.stack([one, other], axis=1), rate=100.0)
    assert len(links_of(find_tracklets(clouds), clouds)[0]) == 0
    apart = Clouds.from_points(np.stack([one, other + np.array([0, 0.05, 0]), one + np.array([0, 0, 0.1])], axis=1), rate=100.0)
    assert len(find_tracklets(apart)) == 3


def test_numbered_gaps_are_followed_and_cut() -> None:
    for i, walk in enumerate(walks()):
        clouds, truth = simulate_gaps_and_ghosts(walk, 3, 3, i)
        tracklets = find_tracklets(clouds)
        check(tracklets, clouds)
        assert score(tracklets, clouds, truth)[:2] == (0, 0)
        before, after = links_of(tracklets, clouds)
        assert clouds.tracks is not None
        assert (clouds.tracks[before] == clouds.tracks[after]).all()


@pytest.mark.parametrize("length", [None, 1, 2, 20])
def test_swaps_are_cut_where_they_are_and_joined_again_across_columns(length: int | None) -> None:
    rng = np.random.default_rng(3)
    tried, cut, joined = 0, 0, 0
    for walk in walks():
        for _ in range(20):
            recording, i, j, t = swapped(walk, rng, length)
            of = columns(recording)
            tried += 1
            cut += of[t - 1, i] != of[t, i] and of[t - 1, j] != of[t, j]
            joined += of[t - 1, i] == of[t, j] and of[t - 1, j] == of[t, i]
    assert cut == tried, f"{cut} of {tried} swaps cut"
    assert joined >= (0.9 * tried if length != 1 else 0), f"{joined} of {tried} joined"


def test_a_jump_onto_a_ghost_is_cut_and_a_kick_is_not() -> None:
    walk = walks()[0]
    jumped = walk.positions.copy()
    jumped[150:, 4] += [0.04, 0.03, 0.05]
    of = columns(replace(walk, positions=jumped))
    assert of[149, 4] != of[150, 4]
    assert cuts(replace(walk, positions=jumped)) == 1
    kicked = walk.positions.copy()
    kicked[150:, 4] += np.arange(150)[:, None] * np.array([0.04, 0.03, 0.05])
    assert cuts(replace(walk, positions=kicked)) == 0


def test_clean_columns_are_whole() -> None:
    for rate in (50.0, 100.0, 240.0):
        assert sum(cuts(walk) for walk in walks(rate)) == 0


def test_points_without_a_number_join_those_with_one() -> None:
    """Every second half second of one column lost its number."""
    clouds = walks()[0].clouds()
    assert clouds.tracks is not None
    lost = (clouds.columns == 3) & (frame_of(clouds) // 50 % 2 == 1)
    tracklets = find_tracklets(replace(clouds, tracks=np.where(lost, -1, clouds.tracks)))
    check(tracklets, clouds)
    assert len(tracklets) == 15


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_the_order_of_points_plays_no_part(seed: int, numbered: bool) -> None:
    rng = np.random.default_rng(seed)
    clouds, _ = simulate_gaps_and_ghosts(walks()[seed % 3].frames(np.arange(60)), 2, 2, rng, number_tracks=numbered)
    order = np.lexsort((rng.random(len(clouds.xyz)), frame_of(clouds)))
    shuffled = replace(clouds, xyz=clouds.xyz[order], tracks=None if clouds.tracks is None else clouds.tracks[order])
    one, other = find_tracklets(clouds), find_tracklets(shuffled)
    np.testing.assert_array_equal(one.of_point[order], other.of_point)
    np.testing.assert_array_equal(one.first, other.first)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_backwards_and_moved_rigidly_it_is_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clouds, _ = simulate_gaps_and_ghosts(walks()[seed % 3].frames(np.arange(80)), 2, 2, rng, number_tracks=False)
    links = set(zip(*links_of(find_tracklets(clouds), clouds), strict=True))
    last = len(clouds.xyz) - 1
    backwards = replace(clouds, xyz=np.ascontiguousarray(clouds.xyz[::-1]), offsets=len(clouds.xyz) - clouds.offsets[::-1])
    mirrored = {(last - b, last - a) for a, b in zip(*links_of(find_tracklets(backwards), backwards), strict=True)}
    assert links == mirrored
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    moved = replace(clouds, xyz=np.ascontiguousarray(clouds.xyz @ turn.T + rng.normal(size=3)))
    assert len(links ^ set(zip(*links_of(find_tracklets(moved), moved), strict=True))) <= 2


def test_the_kernel_equals_its_twin() -> None:
    limits = LinkRules().limits(100.0)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        clouds, _ = simulate_gaps_and_ghosts(walks()[seed].frames(np.arange(40)), 3, 3, rng, number_tracks=False)
        frames = [np.array(sorted(map(tuple, frame))) for frame in clouds]
        xyz, got = np.concatenate(frames), np.empty(len(clouds.xyz), dtype=np.int64)
        link_frames(xyz, clouds.offsets, limits, False, got)
        wanted = link_forward(frames, limits)
        for t in range(1, len(frames)):
            own = got[clouds.offsets[t] : clouds.offsets[t + 1]]
            np.testing.assert_array_equal(np.where(own >= 0, own - clouds.offsets[t - 1], -1), wanted[t])


def test_the_cuts_equal_their_twin() -> None:
    limits = LinkRules().limits(100.0)
    rng = np.random.default_rng(0)
    for seed in range(8):
        recording = swapped(swapped(walks()[seed % 3].frames(np.arange(40)), rng)[0], rng, 3)[0]
        positions = recording.positions + rng.normal(scale=0.004 * (seed % 2), size=recording.positions.shape)
        for t in rng.integers(5, 35, 10):  # a point beside the path, in a column of its own that has nothing else there
            column, other = rng.permutation(positions.shape[1])[:2]
            positions[[t - 1, t + 1], other] = np.nan
            positions[t, other] = positions[t, column] + rng.normal(scale=0.002, size=3)
            positions[t, column] += rng.normal(scale=0.012, size=3)
        for _ in range(3):  # jumps without a rival
            positions[rng.integers(5, 35) :, rng.integers(positions.shape[1])] += rng.normal(scale=0.05, size=3)
        positions[rng.random(positions.shape[:2]) < 0.02] = np.nan
        clouds = replace(recording, positions=positions).clouds()
        links = _along_numbers(clouds.columns, frame_of(clouds))
        got = np.zeros(len(clouds.xyz), dtype=np.bool_)
        find_cuts(clouds.xyz, clouds.offsets, links, limits, got)
        wanted = [
            links.previous[p] >= 0 and is_cut(positions, t, m, limits)
            for p, (t, m) in enumerate(zip(frame_of(clouds), clouds.columns, strict=True))
        ]
        np.testing.assert_array_equal(got, wanted)
        assert got.any()


def test_tracks_are_expected_where_the_twin_expects_them() -> None:
    """Six smooth tracks a metre apart, of which two begin late: prediction, gate and recent errors in every frame."""
    limits = LinkRules().limits(100.0)
    rng = np.random.default_rng(0)
    start, velocity = np.arange(6)[:, None] * [1.0, 0.2, 0.1], rng.normal(scale=0.01, size=(6, 3))
    ends, following, workspace = make_track_ends(6), make_track_ends(6), make_link_workspace(6)
    paths: list[list[np.ndarray]] = []
    errors: list[float] = []
    predicted, gate = np.empty((6, 3)), np.empty(6)
    for t in range(9):
        count = len(paths)
        predict_tracks(ends, count, limits, predicted, gate)
        wanted = expected(paths, errors, limits)
        for a, (place, reach) in enumerate(wanted):
            np.testing.assert_allclose(predicted[a], place, atol=1e-12)
            assert gate[a] == pytest.approx(min(reach, limits.noise + limits.max_change) if len(paths[a]) > 2 else reach)
        points = (start + t * velocity + rng.normal(scale=0.001, size=(6, 3)))[: 4 if t < 4 else 6]
        previous = np.empty(len(points), dtype=np.int64)
        link_step(ends, count, points, limits, workspace, previous, following)
        ends, following = following, ends
        assert previous.tolist() == [a if a < count else -1 for a in range(len(points))]
        for a, point in enumerate(points):
            if a >= count:
                paths.append([point])
                errors.append(0.0)
                continue
            paths[a].append(point)
            if len(paths[a]) == 3:
                errors[a] = float(np.linalg.norm(paths[a][2] - 2 * paths[a][1] + paths[a][0]))
            elif len(paths[a]) > 3:
                errors[a] = max(0.8 * errors[a], float(np.linalg.norm(point - wanted[a][0])))
        np.testing.assert_allclose(ends.recent_error[: len(paths)], errors, atol=1e-12)


def test_ties_and_coincident_points_are_linked_as_the_twin_links_them() -> None:
    """Points on a grid of 1 cm, in frames of 0 to 6 points: many distances are equal."""
    limits = LinkRules().limits(100.0)
    linked = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        points = np.round(rng.normal(scale=0.05, size=(6, 3)), 2)
        frames = []
        for _ in range(10):
            points = points + np.round(rng.normal(scale=0.002, size=3), 2)
            shown = points[rng.random(6) < rng.choice([0.0, 0.9, 0.9])]
            frames.append(np.array(sorted(map(tuple, shown))).reshape(-1, 3))
        offsets = np.concatenate([[0], np.cumsum([len(frame) for frame in frames])])
        got = np.empty(offsets[-1], dtype=np.int64)
        link_frames(np.concatenate(frames), offsets, limits, False, got)
        wanted = link_forward(frames, limits)
        for t in range(1, len(frames)):
            own = got[offsets[t] : offsets[t + 1]]
            np.testing.assert_array_equal(np.where(own >= 0, own - offsets[t - 1], -1), wanted[t])
            linked += int((own >= 0).sum())
    assert linked > 20


def random_links(rng: np.random.Generator, counts: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Links between the points of neighbouring frames, each point in one at most: previous, following (P,)."""
    offsets = np.concatenate([[0], np.cumsum(counts)])
    previous, following = np.full(offsets[-1], -1), np.full(offsets[-1], -1)
    for t in range(1, len(counts)):
        n = min(counts[t - 1], counts[t])
        one, other = offsets[t - 1] + rng.permutation(counts[t - 1])[:n], offsets[t] + rng.permutation(counts[t])[:n]
        kept = rng.random(n) < share
        following[one[kept]], previous[other[kept]] = other[kept], one[kept]
    return previous, following


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.integers(0, 2**31))
def test_both_directions_are_combined_as_the_twin_combines_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0 if seed % 3 else 2, 4, 7)
    forward, following = random_links(rng, counts, 0.9)
    _, backward = random_links(rng, counts, 0.7)
    if rng.random() < 0.8:  # mostly the same links, some of them missing in one direction
        backward = np.where(rng.random(len(following)) < 0.2, -1, following)
        forward = np.where(rng.random(len(forward)) < 0.2, -1, forward)
    got = [np.empty(len(forward), dtype=np.int64) for _ in range(2)]
    combine_directions(forward, backward, *got)
    links = combine_plainly(forward, backward)
    assert {(int(p), q) for q, p in enumerate(got[0]) if p >= 0} == links
    assert {(p, int(q)) for p, q in enumerate(got[1]) if q >= 0} == links


def test_ends_and_beginnings_are_joined_as_the_twin_joins_them() -> None:
    limits = LinkRules().limits(100.0)
    joined = refused = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        noise = rng.choice([0.0, 0.0005, 0.002])
        positions = np.repeat(walks()[seed % 3].positions[:12, :4], 2, axis=1)
        positions[:, ::2] += rng.choice([0.002, 0.005, 0.2])  # pairs of points that move alike
        positions += rng.normal(scale=noise, size=positions.shape)
        positions[6:, 2] = np.nan  # two ends compete for one beginning: the third track ends where the fourth is broken
        clouds = Recording(positions, tuple("abcdefgh"), 100.0).clouds()
        frame, columns = frame_of(clouds), clouds.columns
        whole = _along_numbers(columns, frame)
        previous, following = whole.previous.copy(), whole.following.copy()
        broken = np.nonzero((previous >= 0) & ((rng.random(len(previous)) < 0.2) | ((frame == 6) & (columns == 3))))[0]
        following[previous[broken]] = -1
        previous[broken] = -1
        forbidden = np.full(len(previous), -1)
        forbidden[broken[::4]] = whole.previous[broken[::4]]
        wanted = repair_plainly(clouds.xyz, frame, previous, following, forbidden, limits)
        links = Links(previous, following)
        repair_links(clouds.xyz, clouds.offsets, links, forbidden, limits)
        np.testing.assert_array_equal(links.previous, wanted[0])
        np.testing.assert_array_equal(links.following, wanted[1])
        joined, refused = joined + int((previous[broken] >= 0).sum()), refused + int((previous[broken] < 0).sum())
    assert joined > 20 and refused > 20


@pytest.mark.parametrize("largest", [12, 40_000, 2**40], ids=["few numbers", "more than 16 bits", "more than points"])
def test_links_along_numbers_join_neighbouring_frames_only(largest: int) -> None:
    rng = np.random.default_rng(largest)
    linked = 0
    for _ in range(20):
        known = rng.choice(min(largest, 100_000), 6, replace=False) * (largest // min(largest, 100_000))
        counts = rng.integers(0, 6, 12)
        frame = np.repeat(np.arange(12), counts)
        numbers = np.concatenate([np.where(rng.random(n) < 0.2, -1, rng.permutation(known)[:n]) for n in counts]).astype(np.int64)
        wanted = [
            next((q for q in range(p) if numbers[p] >= 0 and numbers[q] == numbers[p] and frame[q] == frame[p] - 1), -1)
            for p in range(len(numbers))
        ]
        links = _along_numbers(numbers, frame)
        np.testing.assert_array_equal(links.previous, wanted)
        following = np.full(len(numbers), -1)
        following[links.previous[links.previous >= 0]] = np.nonzero(links.previous >= 0)[0]
        np.testing.assert_array_equal(links.following, following)
        linked += int((links.previous >= 0).sum())
    assert linked > 100


def test_points_are_sorted_and_chains_numbered() -> None:
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 6, 12)
    frame, offsets = np.repeat(np.arange(12), counts), np.concatenate([[0], np.cumsum(counts)])
    xyz = np.round(rng.normal(size=(len(frame), 3)))
    order = np.arange(len(frame))
    sort_frames(xyz, offsets, order, (0, 1, 2), 1.0)
    np.testing.assert_array_equal(order, np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0], frame)))
    from_above = np.arange(len(frame))
    sort_frames(xyz, offsets, from_above, (2, 0, 1), -1.0)
    np.testing.assert_array_equal(from_above, np.lexsort((xyz[:, 1], xyz[:, 0], -xyz[:, 2], frame)))
    previous, _ = random_links(rng, counts, 0.7)
    of_point = np.empty(len(frame), dtype=np.int64)
    count = number_chains(previous, of_point)
    assert sorted(set(of_point.tolist())) == list(range(count))
    assert count == (previous < 0).sum()
    for p, before in enumerate(previous):
        assert of_point[p] == (of_point[before] if before >= 0 else of_point[:p].max(initial=-1) + 1)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 2**31), st.integers(0, 12))
def test_tracklets_are_packed_into_as_few_columns_as_possible(seed: int, rest: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.integers(0, 40, rng.integers(0, 12))
    last = first + rng.integers(0, 15, len(first))
    tracklet = np.repeat(np.arange(len(first)), last - first + 1)
    column = pack_tracklets(Tracklets(tracklet, first, last), rest)
    assert all(len(set(column[tracklet == j].tolist())) == 1 for j in range(len(first)))
    of_tracklet = np.array([column[tracklet == j][0] for j in range(len(first))], dtype=np.int64)
    for i in range(len(first)):
        for j in range(i):
            if of_tracklet[i] == of_tracklet[j]:
                assert first[i] > last[j] + rest or first[j] > last[i] + rest
    busy = [((first <= t) & (t <= last + rest)).sum() for t in range(80)]
    assert len(set(of_tracklet.tolist())) == max(busy)


@pytest.mark.parametrize(("rate", "noise"), [(50.0, 0.0015), (100.0, 0.0005), (240.0, 0.0015)])
def test_a_reconstructed_walker_keeps_its_columns(rate: float, noise: float) -> None:
    """Points with millimetres of noise, in any order, a hundredth of them missing, and a ghost in every other frame."""
    rng = np.random.default_rng(1)
    walk = walks(rate)[0].positions
    noisy = walk + rng.normal(scale=noise, size=walk.shape)
    noisy[rng.random(walk.shape[:2]) < 0.01] = np.nan
    low, high = walk.min(axis=(0, 1)), walk.max(axis=(0, 1))
    frames = [np.concatenate([frame[~np.isnan(frame[:, 0])], rng.uniform(low, high, (rng.integers(2), 3))]) for frame in noisy]
    orders = [rng.permutation(len(frame)) for frame in frames]
    clouds = Clouds.from_points([frame[order] for frame, order in zip(frames, orders, strict=True)], rate=rate)
    column = np.full(walk.shape[:2], -1)
    of_point = columns_of(clouds)
    for t, order in enumerate(orders):
        shown = np.nonzero(~np.isnan(noisy[t, :, 0]))[0]
        column[t, shown] = of_point[clouds.offsets[t] : clouds.offsets[t + 1]][np.argsort(order)[: len(shown)]]
    links = (column[1:] >= 0) & (column[:-1] >= 0)
    broken = (links & (column[1:] != column[:-1])).sum()
    assert broken <= 2, f"{broken} of {links.sum()} links change the column"
    for t in range(1, len(column)):
        here, before = (
            dict(zip(row[row >= 0].tolist(), np.nonzero(row >= 0)[0].tolist(), strict=True)) for row in (column[t], column[t - 1])
        )
        assert all(before.get(one, marker) == marker for one, marker in here.items()), (
            f"frame {t}: a column goes from one marker to another"
        )


def test_the_strays_equal_their_twin() -> None:
    rng = np.random.default_rng(0)
    for share in (0.0, 0.1, 1.0):
        positions = walks()[0].positions[:40].copy()
        for t in np.nonzero(rng.random(len(positions)) < share)[0]:
            positions[t] = positions[t][rng.permutation(positions.shape[1])]
        positions[rng.random(positions.shape[:2]) < 0.1] = np.nan
        clouds = Recording(positions, walks()[0].labels, 100.0).clouds()
        following = _along_numbers(clouds.columns, frame_of(clouds)).following
        assert count_strays(clouds.xyz, clouds.offsets, following, 3.0, 0.03) == strays(positions, 3.0, 0.03)


@pytest.mark.parametrize("ghosts", [0, 3])
def test_columns_that_only_count_the_points_of_a_frame_are_not_followed(ghosts: int) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walks()[1], 3, ghosts, 0, number_tracks=False)
    file = Recording.from_clouds(clouds).clouds()  # its columns are places in an order that changes with every frame
    assert file.tracks is not None
    tracklets = find_tracklets(file)
    np.testing.assert_array_equal(tracklets.of_point, find_tracklets(clouds).of_point)
    wrong, missing, there = score(tracklets, file, truth)
    assert wrong == 0
    assert missing < 0.01 * there


def test_numbers_that_change_too_often_give_way_to_motion() -> None:
    """Each point takes a new number with a chance of one half: true tracks, but of two frames."""
    clouds, truth = simulate_gaps_and_ghosts(walks()[1], 3, 0, 0)
    assert clouds.tracks is not None
    new = np.random.default_rng(0).random(len(clouds.xyz)) < 0.5
    by_track = np.lexsort((clouds.frame_of, clouds.tracks))
    numbers = np.empty_like(clouds.tracks)
    numbers[by_track] = clouds.tracks[by_track] * len(clouds.xyz) + np.cumsum(new[by_track])
    wrong, missing, there = score(find_tracklets(replace(clouds, tracks=numbers)), clouds, truth)
    assert wrong == 0
    assert missing < 0.01 * there


@pytest.mark.parametrize("tracks", [False, True])
@pytest.mark.parametrize("counts", [[], [0], [0, 0, 0], [1], [1, 1], [0, 3, 0], [2, 0, 2, 5, 0]])
def test_small_and_empty_clouds(counts: list[int], tracks: bool) -> None:
    rng = np.random.default_rng(0)
    clouds = Clouds.from_points([rng.random((n, 3)) for n in counts], rate=100.0, tracks=[np.arange(n) for n in counts] if tracks else None)
    check(find_tracklets(clouds), clouds)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.integers(0, 8), max_size=12), st.integers(0, 10**6), st.sampled_from([0.0, 0.001, 0.05, 100.0]))
def test_any_cloud_gets_tracklets(counts: list[int], seed: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    frames = [np.round(rng.normal(size=(n, 3)), 1) * size for n in counts]
    check(find_tracklets(clouds := Clouds.from_points(frames, rate=100.0)), clouds)
    numbers = [rng.permutation(10)[:n] - (rng.random(n) < 0.2) * 20 for n in counts]
    numbers = [np.maximum(frame, -1) for frame in numbers]
    check(find_tracklets(clouds := Clouds.from_points(frames, rate=100.0, tracks=numbers)), clouds)


def test_real_gait_is_never_cut_and_its_swaps_always_are(data) -> None:
    rng = np.random.default_rng(1)
    false, tried, found = 0, 0, 0
    for subject in ("HC002", "HC030", "HC044", "HC055"):
        for path in sorted((data / "gait" / subject).glob("*.c3d")):
            recording = read(path, markers="helen-hayes")
            false += cuts(recording)
            for _ in range(5):
                broken, i, j, t = swapped(recording, rng)
                of = columns(broken)
                tried, found = tried + 1, found + (of[t - 3, i] != of[t + 3, i] and of[t - 3, j] != of[t + 3, j])
    assert false == 0, f"{false} false cuts"
    assert found >= 0.95 * tried, f"{found} of {tried} swaps cut"


@pytest.mark.parametrize("file", MOVEMENT)
def test_real_fast_movement_is_not_cut(data, file: str) -> None:
    assert cuts(read(data / "movement" / file)) == 0


def test_real_gait_is_linked_from_raw_clouds(data) -> None:
    for i, subject in enumerate(("HC002", "HC044")):
        recording = read(data / "gait" / subject / "turn.c3d", markers="helen-hayes")
        for hidden, ghosts in ((0, 0), (3, 0), (3, 3)):
            clouds, truth = simulate_gaps_and_ghosts(recording, hidden, ghosts, i, number_tracks=False)
            wrong, missing, there = score(find_tracklets(clouds), clouds, truth)
            assert wrong == 0
            assert missing <= 0.001 * there
