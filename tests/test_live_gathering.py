"""Images of several cameras as they arrive, late, lost, from clocks that differ: which frames they become, when, and what is told."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from asterism.live.blobs import camera_clock
from asterism.live.blobs._clock_kernels import fit_line
from asterism.live.blobs._follow_kernels import link_blobs
from asterism.live.blobs.camera_clock import CameraClock, compile_fit, same_clock
from asterism.live.blobs.following import FollowedImage, between, follow
from asterism.live.blobs.gathering import LONGEST_WAIT, ByNumber, ByTime, RigFrame
from asterism.live.blobs.gathering.arrivals import REMEMBERED
from asterism.live.camera_frames import LiveBlobs

RATE = 100.0
pytestmark = pytest.mark.kernels


def where(time: float) -> np.ndarray:
    """(3, 2) px: three markers that swing, some 8 px between two images at most, 200 px apart."""
    n = np.arange(3)
    angle = 2 * np.pi * (0.9 + 0.1 * n) * time + n
    return np.column_stack([200 + 200 * n + 120 * np.sin(angle), 300 + 150 * np.cos(angle)])


def image(camera: int, number: int, time: float, arrived: float, at: float | None = None) -> LiveBlobs:
    """time: on the camera's clock; at: when it was taken."""
    xy = where(time if at is None else at)
    return LiveBlobs(f"c{camera}", number, time, arrived, xy, np.full(len(xy), 5.0))


def driven(gather: ByNumber | ByTime, images: Sequence[tuple[int, LiveBlobs]]) -> list[tuple[float, RigFrame]]:
    """(when it came out, frame) of all frames, the time being that of the arrivals and of what is due between them."""
    frames = list[tuple[float, RigFrame]]()
    for camera, blobs in sorted(images, key=lambda each: each[1].arrived):
        while (due := gather.due()) < blobs.arrived:
            before = len(frames)
            frames += [(due, frame) for frame in gather.ready(due)]
            assert len(frames) > before, "what is due comes out"
        gather.push(camera, blobs)
        frames += [(blobs.arrived, frame) for frame in gather.ready(blobs.arrived)]
    while (due := gather.due()) < math.inf:
        frames += [(due, frame) for frame in gather.ready(due)]
    return frames


def arriving(cameras: int, frames: int, late: np.ndarray) -> list[tuple[int, LiveBlobs]]:
    """Images numbered together that arrive `late` (frames, cameras) s after they were taken; NaN for lost ones."""
    taken = np.argwhere(np.isfinite(late[:frames]))
    return [(c, image(c, t, t / RATE, 50.0 + t / RATE + late[t, c])) for t, c in taken.tolist()]


@given(st.integers(0, 10_000), st.integers(2, 4), st.sampled_from([0.0, 0.05, 0.3]))
@settings(max_examples=30, deadline=None)
def test_each_image_is_in_its_frame_or_told(seed: int, cameras: int, lost: float) -> None:
    rng = np.random.default_rng(seed)
    late = 0.001 + rng.exponential(0.003, (80, cameras))
    late[rng.random(late.shape) < lost] = np.nan
    # A camera's images do not overtake each other.
    late = np.maximum.accumulate(np.arange(80)[:, None] / RATE + np.nan_to_num(late), axis=0) - np.arange(80)[:, None] / RATE + 0 * late
    gather = ByNumber(cameras, RATE)
    frames = [frame for _, frame in driven(gather, arriving(cameras, 80, late))]
    numbers = [frame.number for frame in frames]
    assert numbers == sorted(set(numbers))
    assert set(numbers) <= set(np.flatnonzero(np.isfinite(late).any(axis=1)).tolist())
    for c, state in enumerate(gather.cameras):
        sent = int(np.isfinite(late[:, c]).sum())
        inside = sum(c not in frame.missing for frame in frames)
        assert inside + state.late + state.count.late == sent, "an image is used once, or told as late"
        assert inside + state.without == len(frames)
        for frame in frames:
            assert len(frame.xy[c]) == (0 if c in frame.missing else 3), "nothing is used again"


def test_a_late_camera_is_waited_for_as_long_as_it_has_been_late() -> None:
    late = np.full((300, 3), 0.001)
    late[:, 2] = 0.009
    late[200, 2] = np.nan
    # Its next image comes 10 ms later and shows that the one before was lost: the frame waits no longer than that, nor than 1.5 x 8 ms.
    frames = driven(ByNumber(3, RATE), arriving(3, 300, late))
    waits = {frame.number: out - (50.0 + frame.number / RATE) for out, frame in frames}
    assert waits[100] == pytest.approx(0.009), "it is waited for although it is 8 ms behind the others"
    assert frames[200][1].missing == (2,)
    assert waits[200] == pytest.approx(0.001 + 1.5 * 0.008, abs=1e-6)
    assert waits[201] == pytest.approx(0.009)


def test_a_camera_that_is_silent_holds_up_two_frames_and_is_back_at_once() -> None:
    late = np.full((400, 3), 0.001)
    late[:, 1] = np.where(np.arange(400) % 7 == 0, 0.006, 0.002)
    late[100:200, 1] = np.nan
    gather = ByNumber(3, RATE)
    frames = driven(gather, arriving(3, 400, late))
    waits = np.array([out - (50.0 + frame.number / RATE) for out, frame in frames])
    assert (waits[100:102] > 0.005).all() and (waits[103:200] < 0.0011).all()
    assert [frame.number for _, frame in frames if 1 in frame.missing] == list(range(100, 201)), "its first image back is late"
    state = gather.cameras[1]
    assert (state.times_away, state.without, state.count.lost, state.away) == (1, 101, 100, False)


def test_a_camera_later_than_a_tenth_of_a_second_is_told_and_not_waited_for() -> None:
    late = np.full((200, 3), 0.001)
    late[:, 0] = 0.25
    gather = ByNumber(3, RATE)
    frames = driven(gather, arriving(3, 200, late))
    assert max(out - (50.0 + frame.number / RATE) for out, frame in frames) <= LONGEST_WAIT + 0.002
    assert gather.cameras[0].late > 150


def test_numbers_that_begin_anew_are_followed_and_those_of_one_camera_alone_are_not() -> None:
    late = np.full((200, 3), 0.001)
    images = arriving(3, 200, late)
    again = [(c, image(c, b.number, b.time, b.arrived + 10.0)) for c, b in images]
    gather = ByNumber(3, RATE)
    frames = [frame for _, frame in driven(gather, images + again)]
    whole = [frame.number for frame in frames if not frame.missing]
    assert whole.count(150) == 2 and len(whole) >= 390
    alone = [(c, b if c or b.number < 100 else image(c, b.number + 5000, b.time, b.arrived)) for c, b in images]
    gather = ByNumber(3, RATE)
    frames = [frame for _, frame in driven(gather, alone)]
    assert [frame.number for frame in frames] == list(range(200)), "the others' numbers go on"
    assert gather.cameras[0].late > 90


@given(st.integers(0, 10_000), st.integers(0, 8), st.integers(0, 8))
@settings(max_examples=60, deadline=None)
def test_links_are_those_of_the_plain_twin(seed: int, before: int, now: int) -> None:
    rng = np.random.default_rng(seed)
    # Whole pixels, so that distances are equal now and then.
    ways, xy = rng.integers(0, 30, (before, 2)).astype(float), rng.integers(0, 30, (now, 2)).astype(float)
    found = np.full(now, 7)
    link_blobs(ways, xy, 0.5, 4.0, 8.0, found)
    apart = np.array([[math.dist(way, place) for place in xy] for way in ways]).reshape(before, now)
    expected = np.full(now, -1)
    for j in range(now if before else 0):
        i = int(np.argmin(apart[:, j]))
        nearest = sorted(apart[i])
        if int(np.argmin(apart[i])) == j and (now == 1 or nearest[0] < 0.5 * nearest[1]):
            expected[j] = i
    misses = [apart[i, j] for j, i in enumerate(expected) if i >= 0]
    expected = [i if i >= 0 and apart[i, j] <= 4.0 + 8.0 * np.median(misses) else -1 for j, i in enumerate(expected)]
    assert found.tolist() == expected


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_a_clock_is_known_as_well_as_it_says(seed: int) -> None:
    rng = np.random.default_rng(seed)
    zero, ppm, scatter = rng.uniform(-1e6, 1e6), rng.uniform(-80, 80), rng.choice([2e-4, 1e-3, 5e-3])
    clock = CameraClock()
    for n in range(4000):
        taken = n / RATE
        clock.observe(zero + taken * (1 - 1e-6 * ppm), taken + 0.003 + rng.exponential(scatter))
    true = (n / RATE + 0.003) - clock.last_time
    # The fastest of each half second was scatter / 50 late on average, which a one-way stream cannot tell.
    assert abs(clock.offset(clock.last_time) - true - scatter / 50) < 5 * clock.offset_sd(clock.last_time) + scatter / 50
    assert clock.offset_sd(clock.last_time) < scatter
    assert abs(clock.drift_ppm - ppm) < 5 * clock.drift_sd_ppm
    assert clock.drift_sd_ppm < 15 and clock.jumps == 0


def test_a_clock_compiles_nothing_while_images_come(monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel is compiled anew for each kind of arrays, for a second in which no image is taken."""
    kinds, fit = list[object](), camera_clock.fit_line
    monkeypatch.setattr(camera_clock, "fit_line", lambda *given: kinds.append([numba.typeof(each) for each in given]) or fit(*given))
    compile_fit()
    clock = CameraClock()
    for at in np.arange(0.0, 3.0, 0.1):
        clock.observe(at, at)
    assert len(kinds) > 4 and kinds == [kinds[0]] * len(kinds)


@pytest.mark.kernels
@given(st.integers(0, 10_000), st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_the_line_through_two_clocks_is_that_of_its_twin(seed: int, many: int) -> None:
    """The twin goes by matrices."""
    rng = np.random.default_rng(seed)
    since, scatter, quartz = np.sort(rng.uniform(-20, 0, many)), 1e-3, 1e-4
    least = 50.0 + 3e-5 * since + rng.exponential(1e-3, many) + 0.2 * (rng.random(many) < 0.2)
    variance = np.empty((2, 2))
    found = fit_line(since, least, scatter, quartz, variance)
    line, spread, expected = np.array([least.min(), 0.0]), scatter, np.empty((2, 2))
    columns = np.column_stack([np.ones(many), since])
    for _ in range(4):
        rest = least - columns @ line
        usual = 1.4826 * np.median(np.abs(rest - np.median(rest)))
        spread = math.sqrt((many * usual**2 + scatter**2) / (many + 1))
        weighted = columns.T / (1.0 + (rest / (3 * spread)) ** 2) / spread**2
        expected = np.linalg.inv(weighted @ columns + np.diag([0.0, quartz**-2]))
        line = expected @ (weighted @ least)
    np.testing.assert_allclose(found, [*line, spread], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(variance, expected, rtol=1e-6)


@pytest.mark.parametrize("by", [3600.0, -3600.0, 0.3, -0.3, 0.05])
def test_a_clock_that_is_set_is_noticed_once(by: float) -> None:
    rng, clock = np.random.default_rng(0), CameraClock()
    for n in range(3000):
        taken = n / RATE
        clock.observe(taken + (by if n >= 1500 else 0.0), 50.0 + taken + rng.exponential(0.001))
    assert clock.jumps == 1
    assert clock.offset(clock.last_time) == pytest.approx(50.0 - by, abs=0.002)


def test_a_slow_second_is_no_jump() -> None:
    rng, clock = np.random.default_rng(0), CameraClock()
    for n in range(3000):
        late = 0.2 if 1500 <= n < 1580 else 0.0
        clock.observe(n / RATE, 50.0 + n / RATE + late + rng.exponential(0.001))
    assert clock.jumps == 0


def free(
    frames: int, phases: Sequence[float], rates: Sequence[float] = (), clocks: Sequence[tuple[float, float]] = (), seed: int = 0
) -> list[tuple[int, LiveBlobs]]:
    """Images of cameras that begin at phases (s) and have rates; clocks: zero (s) and speed (ppm) of each, where they have their own."""
    rng, images = np.random.default_rng(seed), []
    for c, phase in enumerate(phases):
        rate = rates[c] if rates else RATE
        zero, ppm = clocks[c] if clocks else (0.0, 0.0)
        for n in range(round(frames * rate / RATE)):
            taken = phase + n / rate
            images.append((c, image(c, n, zero + taken * (1 - 1e-6 * ppm), 50.0 + taken + 0.001 + rng.exponential(0.0005), taken)))
    return images


def misses(frame: RigFrame, taken: float) -> float:
    """px, the largest distance of a blob from its marker at an instant."""
    return max(
        (float(np.linalg.norm(where(taken)[:, None] - xy[None], axis=2).min(axis=0).max()) for xy in frame.xy if len(xy)), default=0.0
    )


def test_blobs_are_moved_to_the_instant_of_one_camera() -> None:
    gather = ByTime(3, RATE)
    frames = [frame for _, frame in driven(gather, free(300, [0.0, 0.0031, 0.0072]))]
    later = frames[5:-5]
    assert len(frames) > 270 and all(len(xy) == 3 for frame in later for xy in frame.xy)
    # Between images they move by up to 8 px; the parabola leaves some thousandths of that.
    assert max(misses(frame, frame.time) for frame in later) < 0.1
    assert [frame.number for frame in frames] == list(range(len(frames)))
    # The largest gap is between 3.1 and 7.2 ms: after it comes the reference, and the others within 5.9 ms.
    assert 0.004 < gather.image_wait < 0.006


def test_cameras_of_clocks_of_their_own_are_compared_by_their_arrival() -> None:
    """The fastest ways are equal here, so that what is left is how well the clocks are compared: a tenth of a millisecond or two."""
    clocks = [(1000.0, 40.0), (-77.0, -30.0), (5e5, 10.0)]
    gather = ByTime(3, RATE)
    frames = [frame for _, frame in driven(gather, free(1500, [0.0, 0.0031, 0.0072], clocks=clocks))]
    assert not gather.one_clock
    # The common clock is this machine's, the fastest way of 1 ms included.
    apart = [misses(frame, frame.time - 50.001) for frame in frames[300:-5]]
    assert len(apart) > 1100
    assert np.median(apart) < 0.25 and max(apart) < 0.8


def test_cameras_of_other_rates_take_part() -> None:
    gather = ByTime(3, RATE)
    frames = [frame for _, frame in driven(gather, free(400, [0.0, 0.002, 0.003], rates=[100.0, 100.0, 50.0]))]
    later = frames[5:-5]
    assert len(later) > 350 and np.diff([frame.time for frame in later]).max() < 0.0101
    assert max(misses(frame, frame.time) for frame in later) < 0.5
    assert np.mean([len(frame.xy[2]) == 3 for frame in later]) > 0.95


def test_no_image_is_used_across_a_hole_in_its_camera() -> None:
    images = [(c, b) for c, b in free(300, [0.0, 0.004]) if not (c == 1 and 100 <= b.number < 110)]
    gather = ByTime(2, RATE)
    frames = [frame for _, frame in driven(gather, images)]
    without = [frame.time for frame in frames if 1 in frame.missing]
    assert len(without) >= 9 and min(without) > 0.99 and max(without) < 1.11
    assert max(misses(frame, frame.time) for frame in frames[5:]) < 0.1
    assert gather.cameras[1].times_away == 1 and not gather.cameras[1].away


def test_an_image_that_is_lost_takes_no_frame_with_it() -> None:
    """Nor one of the camera at whose instants frames are made, which is the first here."""
    images = [(c, b) for c, b in free(200, [0.0, 0.003, 0.006]) if c or b.number % 20]
    gather = ByTime(3, RATE)
    frames = driven(gather, images)
    assert gather._reference == 0 and [frame.number for _, frame in frames] == list(range(len(frames))) and len(frames) >= 175
    assert max(misses(frame, frame.time) for _, frame in frames[5:]) < 0.2
    assert np.diff([frame.time for _, frame in frames]) == pytest.approx(1 / RATE)
    assert max(out - (50.0 + frame.time) for out, frame in frames) < 0.0175


@pytest.mark.parametrize("dead", [0, 1])
def test_a_free_camera_that_dies_takes_no_frame_with_it(dead: int) -> None:
    """Not even the one at whose instants frames are made, which is the first here."""
    images = [(c, b) for c, b in free(400, [0.0, 0.003, 0.006]) if not (c == dead and 200 <= b.number < 300)]
    gather = ByTime(3, RATE)
    frames = driven(gather, images)
    assert [frame.number for _, frame in frames] == list(range(len(frames))) and len(frames) >= 375
    assert np.diff([frame.time for _, frame in frames]).max() < 0.0175
    assert max(out - (50.0 + frame.time) for out, frame in frames) < 0.03
    assert max(misses(frame, frame.time) for _, frame in frames[5:]) < 0.5
    assert [state.times_away for state in gather.cameras] == [c == dead for c in range(3)]
    assert sum(dead in frame.missing for _, frame in frames if 3.05 < frame.time < 3.9) < 3, "it takes part again"


def test_a_camera_whose_clock_is_set_takes_part_again() -> None:
    images = [
        (c, b if c != 1 or b.number < 150 else image(c, b.number, b.time + 3600.0, b.arrived, b.time))
        for c, b in free(400, [0.0, 0.003, 0.005])
    ]
    gather = ByTime(3, RATE)
    frames = [frame for _, frame in driven(gather, images)]
    assert gather.cameras[1].clock.jumps == 1
    times = np.array([frame.time for frame in frames])
    assert (np.diff(times[times < 60]) > 0).all()
    # Its clock is another one now, so all are compared by their arrival.
    assert not gather.one_clock
    last = frames[-60:-5]
    assert all(len(frame.xy[1]) == 3 for frame in last)
    assert max(misses(frame, frame.time - 50.001) for frame in last) < 0.8


def test_a_blob_that_speeds_up_is_put_on_its_parabola() -> None:
    images = [FollowedImage(t, t, np.array([[3000.0 * t * t, 50.0]]), np.array([4.0])) for t in (0.0, 0.01, 0.02)]
    for before, image in zip([None, *images], images, strict=False):
        follow(before, image, 1.0)
    xy, _ = between(images[0], images[1], images[2], 0.015)
    np.testing.assert_allclose(xy, [[3000.0 * 0.015**2, 50.0]], atol=1e-9)
    xy, _ = between(None, images[1], images[2], 0.015)
    np.testing.assert_allclose(xy, [[0.5 * 3000.0 * (0.01**2 + 0.02**2), 50.0]], atol=1e-9)


@pytest.mark.parametrize(("ppm", "one"), [(0.0, True), (100.0, False)])
def test_clocks_that_run_apart_are_not_one(ppm: float, one: bool) -> None:
    """They are 3 ms apart after half a minute, as the images of one clock may be."""
    clocks = CameraClock(), CameraClock()
    for at in np.arange(0.0, 30.0, 0.05):
        clocks[0].observe(at, at)
        clocks[1].observe(at * (1.0 + 1e-6 * ppm), at)
    assert same_clock(*clocks, LONGEST_WAIT) == one


@given(st.integers(0, 10_000), st.integers(2, 4), st.sampled_from([0.0, 0.1]))
@settings(max_examples=20, deadline=None)
def test_images_that_come_twice_late_or_not_at_all_are_taken_once_or_told(seed: int, cameras: int, rough: float) -> None:
    """Of cameras that run freely: lost ones, the same datagram again, and some that the network holds back behind the next ones."""
    rng = np.random.default_rng(seed)
    images = [(c, b) for c, b in free(120, rng.uniform(0, 1 / RATE, cameras).tolist(), seed=seed) if rng.random() >= rough]
    again = [(c, image(c, b.number, b.time, b.arrived + 0.001, b.time)) for c, b in images if rng.random() < rough]
    held = [(c, image(c, b.number, b.time, b.arrived + rng.choice([0.0, 0.025], p=[1 - rough, rough]), b.time)) for c, b in images]
    gather = ByTime(cameras, RATE)
    pushed: dict[int, list[float | None]] = {c: [] for c in range(cameras)}
    push, kept = gather.push, list[int]()

    def counted_push(camera: int, blobs: LiveBlobs) -> float | None:
        pushed[camera].append(push(camera, blobs))
        kept.append(max(len(track.images) for track in gather._tracks))
        return pushed[camera][-1]

    gather.push = counted_push  # type: ignore[method-assign]
    frames = [frame for _, frame in driven(gather, [*held, *again])]
    assert (np.diff([frame.time for frame in frames]) > 0).all() and (np.diff([frame.number for frame in frames]) > 0).all()
    assert max(misses(frame, frame.time) for frame in frames) < 1.5, "nothing is taken at another time than its own"
    for c, state in enumerate(gather.cameras):
        times = [at for at in pushed[c] if at is not None]
        assert len(pushed[c]) - len(times) == state.count.late, "what is not new is told"
        assert (np.diff([at for at in times if not math.isnan(at)]) > 0).all()
        assert state.without == sum(c in frame.missing for frame in frames)
    # Those around the oldest frame that waits, and no more of them in a long session.
    assert max(kept) < 40


def test_images_of_one_instant_need_no_path_and_wait_for_no_other() -> None:
    """As those of a trigger; blobs that were never seen before are in the frame, too."""
    images = [(c, LiveBlobs(f"c{c}", n, n / RATE, 50.0 + n / RATE + 0.001 * c, np.full((1, 2), 700.0 * (n % 2)), np.ones(1)))
              for c in range(3) for n in range(60)]  # fmt: skip
    gather = ByTime(3, RATE)
    frames = driven(gather, images)
    assert [frame.time for _, frame in frames] == pytest.approx([n / RATE for n in range(20, 60)])
    assert all(not frame.missing and all(len(xy) == 1 for xy in frame.xy) for _, frame in frames)
    assert gather.image_wait == 0.0 and sum(state.unlinked for state in gather.cameras) == 0
    assert max(out - 50.0 - frame.time for out, frame in frames[2:]) == pytest.approx(0.002)


def test_an_image_with_the_time_of_the_one_before_is_told() -> None:
    gather = ByTime(2, RATE)
    for c, blobs in free(40, [0.0, 0.003]):
        assert gather.push(c, blobs) is not None
    for more, earlier in ((1, 0.0), (2, 0.1)):
        assert gather.push(1, image(1, blobs.number + more, blobs.time - earlier, 51.0)) is None
    assert gather.cameras[1].untimed == 2 and gather.cameras[1].count.received == blobs.number + 3


def test_images_of_a_free_camera_that_come_after_their_frame_went_on_are_told() -> None:
    """As where radio holds them back for 0.2 s, and brings them together."""
    images = [
        (c, image(c, b.number, b.time, 51.98 + 1e-4 * b.number, b.time) if not c and 180 <= b.number < 200 else b)
        for c, b in free(300, [0.0, 0.003, 0.006])
    ]
    gather = ByTime(3, RATE)
    frames = driven(gather, images)
    assert max(out - (50.0 + frame.time) for out, frame in frames) <= LONGEST_WAIT + 0.02
    state = gather.cameras[0]
    assert state.count.lost == 0 and 12 <= state.late <= 20 and state.times_away == 1 and not state.away
    assert [other.late for other in gather.cameras[1:]] == [0, 0]
    assert all(not frame.missing for _, frame in frames if 52.1 < 50.0 + frame.time < 52.9)


def test_frames_that_nobody_takes_fill_no_memory() -> None:
    gather = ByTime(2, RATE)
    for c, blobs in sorted(free(1000, [0.0, 0.003]), key=lambda each: each[1].arrived):
        gather.push(c, blobs)
    assert [len(track.images) for track in gather._tracks] == [REMEMBERED, REMEMBERED]
    assert len(list(gather.ready(math.inf))) == REMEMBERED
