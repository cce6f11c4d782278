"""Proposed rigs: never worth less than the ring, on their mounts, the same every time, and the kernel equal to its twin."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from computed import computed

from asterism.cameras import Camera
from asterism.cameras.accuracy import Volume, map_rig, sees
from asterism.cameras.aim import looking
from asterism.cameras.plan import Mounts, RigPlan, _kernels, focal_length, search
from asterism.cameras.plan import plan_rig as plan_anew
from asterism.errors import AsterismError

pytestmark = pytest.mark.kernels

SIZE = (1280, 1024)


@pytest.fixture(scope="module", autouse=True)
def _searched_at_fewer_places() -> Iterator[None]:
    """What a search promises holds at any number of places and candidates; fewer are searched in a third of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "RULES", replace(search.RULES, places=200, fine_places=1000, candidates=1000))
        yield


def plan_rig(volume: Volume, cameras: int, size: tuple[int, int], focal: float, **settings: object) -> RigPlan:
    """What `plan_anew` gives; a second for most volumes, so that it is worked out once for the same sources."""
    return computed(plan_anew, volume, cameras, size, focal, beside=search.RULES, **settings)


@pytest.fixture(scope="module")
def hall() -> Volume:
    return Volume.parse("6x4x2.5")


@pytest.fixture(scope="module")
def plan(hall: Volume) -> RigPlan:
    return plan_rig(hall, 6, SIZE, focal_length(1280, fov=56))


@pytest.mark.slow
def test_the_proposal_is_at_least_as_good_as_the_ring_in_every_way(plan: RigPlan, hall: Volume) -> None:
    ours, ring = map_rig(plan.rig, hall), map_rig(plan.ring, hall)
    assert plan.worth > plan.ring_worth
    assert ours.coverage(3) >= ring.coverage(3)
    assert ours.coverage(4) > ring.coverage(4)
    assert ours.facing.mean() > ring.facing.mean()
    assert np.percentile(ours.error, 95) < 0.7 * np.percentile(ring.error, 95)
    assert plan.glare < plan.ring_glare


@pytest.mark.parametrize(("cameras", "spec", "fov"), [(2, "2x2x2", 60.0), (4, "3x3x2", 45.0)])
def test_it_is_never_worth_less_than_the_ring(cameras: int, spec: str, fov: float) -> None:
    volume = Volume.parse(spec)
    result = plan_rig(volume, cameras, SIZE, focal_length(1280, fov=fov))
    assert len(result.rig) == len(result.ring) == cameras
    assert result.worth >= result.ring_worth
    ours, ring = map_rig(result.rig, volume), map_rig(result.ring, volume)
    # the search weighs places that are not those of the map
    assert ours.coverage(min(3, cameras)) >= ring.coverage(min(3, cameras)) - 0.002
    assert ours.facing.mean() >= ring.facing.mean() - 0.005


def test_no_two_cameras_hang_in_one_place(plan: RigPlan) -> None:
    eyes = np.stack([camera.position for camera in plan.rig])
    gaps = np.linalg.norm(eyes[:, None] - eyes, axis=2)[np.triu_indices(len(eyes), 1)]
    assert gaps.min() > 0.3 - 1e-9


def test_cameras_hang_where_they_may(plan: RigPlan) -> None:
    for rig in (plan.rig, plan.ring):
        for camera in rig:
            x, y, z = camera.position
            assert np.isclose(abs(x), 4.5) or np.isclose(abs(y), 3.5), f"{camera.name} hangs at {camera.position}, not on a wall"
            assert abs(x) < 4.5 + 1e-9
            assert abs(y) < 3.5 + 1e-9
            assert 2.2 - 1e-9 <= z <= 2.6 + 1e-9
            assert abs(camera.rotation[0, 2]) < 1e-9, "level: its rows of pixels are horizontal"


def test_the_same_question_has_the_same_answer() -> None:
    volume = Volume.parse("3x2x2")
    first, second = (plan_anew(volume, 2, SIZE, 1000.0) for _ in range(2))
    assert all(
        np.array_equal(a.position, b.position) and np.array_equal(a.rotation, b.rotation)
        for a, b in zip(first.rig, second.rig, strict=True)
    )


def test_a_ceiling_is_used_only_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "RULES", replace(search.RULES, candidates=2000))  # a large room has many mounts
    volume = Volume.parse("2x2x1")
    room = Volume(np.array([-6.0, -6, 0]), np.array([6.0, 6, 4]))
    walls = plan_rig(volume, 2, SIZE, 1400.0, mounts=Mounts.around(volume, room, (3.0, 3.0)))
    over = plan_rig(volume, 2, SIZE, 1400.0, mounts=Mounts.around(volume, room, (3.0, 3.0), ceiling=True))
    on_wall = [bool(np.isclose(np.abs(camera.position[:2]), 6).any()) for camera in walls.rig]
    assert all(on_wall)
    assert any(np.abs(camera.position[:2]).max() < 5.9 for camera in over.rig)
    assert over.worth > walls.worth, "from 3 m away one measures better than from 6"


def test_in_a_low_room_cameras_hang_below_its_ceiling() -> None:
    assert Mounts.around(Volume.parse("4x4x1.8"), Volume.parse("6x6x2.1")).heights == (2.1, 2.1)
    assert Mounts.around(Volume.parse("4x4x1.8"), Volume.parse("6x6x2.4")).heights == (2.2, 2.4)
    assert Mounts.around(Volume.parse("4x4x1.8")).heights == (2.2, 2.6)
    assert Mounts.around(Volume.parse("4x4x1.8"), heights=(2.0, 3.5)).heights == (2.0, 3.5), "without walls nothing ends above"


def test_places_along_the_walls_go_once_around() -> None:
    mounts = Mounts.around(Volume.parse("6x4x2"))
    places = np.array([mounts.position(np.array([along, 2.4, 0.0])) for along in np.linspace(0, mounts.around_m, 801)])
    assert np.allclose(places[0], places[-1])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < mounts.around_m / 800 + 1e-9
    for angle in np.linspace(0, 2 * np.pi, 37):
        at = mounts.position(mounts.toward(angle, np.array([0.5, -0.3, 1.0])))
        found = np.arctan2(at[1] + 0.3, at[0] - 0.5)
        assert abs((found - angle + np.pi) % (2 * np.pi) - np.pi) < 1e-9


def square_hall(noise: float = 0.3) -> search._Hall:
    volume = Volume.parse("3x3x2")
    return search._Hall(volume, Mounts.around(volume), SIZE, 1000.0, noise, 300)


def test_a_rig_that_sees_less_than_it_must_is_worth_less_by_what_is_missing() -> None:
    hall, rng = square_hall(), np.random.default_rng(0)
    some = [np.concatenate([hall.mounts.toward(angle, hall.centre), hall.centre]) for angle in rng.uniform(0, 2 * np.pi, 12)]
    lacking = 0
    for count in (3, 4, 6, 12):
        poses = np.array(some[:count])
        for least in ((0.0, 0.0), (0.9, 0.0), (0.0, 0.9), (1.0, 1.0)):
            missing = np.maximum(np.subtract(least, hall.shares(poses)), 0.0).sum()
            assert hall.worth(poses, least) == pytest.approx(hall.worth(poses) - search.RULES.lack * missing)
            lacking += 0 < missing < sum(least)
    assert lacking > 3


def test_a_square_hall_is_worth_as_much_from_each_side() -> None:
    """The markers on a body face all horizontal directions alike."""
    hall = square_hall()
    sides = [
        np.array([np.concatenate([hall.mounts.toward(side * np.pi / 2 + off, hall.centre), hall.centre]) for off in (-0.3, 0.1, 0.4)])
        for side in range(4)
    ]
    worth = [hall.worth(poses) for poses in sides]
    assert worth == pytest.approx([worth[0]] * 4, abs=0.01), "but for places that lie on a border"


def test_the_search_offers_mounts_for_many_cameras_and_aims_into_the_volume() -> None:
    volume = Volume.parse("0.4x0.4x0.4")
    hall = search._Hall(volume, Mounts.around(volume, Volume.parse("1x1x2.3"), (2.2, 2.2)), SIZE, 1000.0, 0.3, 30)
    poses = hall.searched(14, lambda share: None)
    assert hall.mounts.around_m / search.RULES.spacing < 14, "too few at the usual spacing"
    assert len(np.unique(poses[:, :3], axis=0)) == 14
    assert (poses[:, 3:] >= volume.low).all() and (poses[:, 3:] <= volume.high).all()
    aims = hall._aims()
    assert (aims >= volume.low).all() and (aims <= volume.high).all()


def test_the_kernel_equals_its_twin() -> None:
    rng = np.random.default_rng(0)
    places, facings, candidates, mounts = 7, 4, 5, 3
    slopes = rng.normal(size=(4, places, 2, 3)) * 1000
    told = np.einsum("cpki,cpkj->cpij", slopes, slopes)
    seen, sided = rng.random((4, places)) < 0.6, rng.random((4, places, facings)) < 0.6
    seen_new, mount, faces = (
        rng.random((candidates, places)) < 0.6,
        rng.integers(0, mounts, candidates),
        rng.random((mounts, places, facings)) < 0.6,
    )
    new = rng.normal(size=(candidates, places, 2, 3)) * 1000
    told_new = np.einsum("cpki,cpkj->cpij", new, new)
    upper = np.triu_indices(3)
    both = seen[:, :, None] & sided
    out = np.empty(candidates)
    packed = np.einsum("cpd,cpi->pdi", both, told[..., upper[0], upper[1]])
    _kernels.worth_with(seen.sum(0), both.sum(0), packed, seen_new, told_new[..., upper[0], upper[1]], faces, mount, out)
    for k in range(candidates):
        covered = np.take([0.0, 0.1, 0.4, 1.0], np.minimum(seen.sum(0) + seen_new[k], 3)).mean()
        counts, quality = [], []
        for p, d in np.ndindex(places, facings):
            use = [told[c, p] for c in range(4) if both[c, p, d]] + ([told_new[k, p]] if seen_new[k, p] and faces[mount[k], p, d] else [])
            counts.append(min(len(use), 2) / 2)
            error = np.sqrt(np.trace(np.linalg.inv(np.sum(use, axis=0)))) if len(use) >= 2 else np.inf
            quality.append(np.clip((-2 - np.log10(error)) / 2, 0, 1))
        assert np.isclose(out[k], 0.5 * covered + 0.25 * np.mean(counts) + 0.25 * np.mean(quality), atol=1e-12)


def test_a_camera_looks_where_it_is_aimed() -> None:
    rotation, translation = looking([4.0, 1.0, 2.5], [0.2, 0.1, 0.9])
    camera = Camera("one", SIZE, (1000.0, 1000.0), (639.5, 511.5), rotation, translation)
    assert np.allclose(camera.project([0.2, 0.1, 0.9]), (639.5, 511.5))
    assert np.allclose(camera.position, (4.0, 1.0, 2.5))
    down = Camera("two", SIZE, (1000.0, 1000.0), (639.5, 511.5), *looking([0, 0, 3], [0, 0, 0]))
    assert down.project([0.0, 0.5, 0])[1] < 511, "y is up in the image of a camera that looks straight down"
    with pytest.raises(AsterismError, match="where it stands"):
        looking([0, 0, 1], [0, 0, 1])


def test_lenses_from_angles_and_millimetres() -> None:
    assert np.isclose(focal_length(1000, fov=90), 500)
    assert np.isclose(focal_length(1280, focal_mm=6.0, pixel_um=4.8), 1250)
    camera = Camera("one", (1000, 10), (500.0, 500.0), (499.5, 4.5))
    assert sees(plan_rig(Volume.parse("1x1x1"), 2, SIZE, 1000.0).rig, [[0.0, 0, 0.5]]).all()
    assert camera.project([0.999, 0, 1.0])[0] < 1000 < camera.project([1.002, 0, 1.0])[0]


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: plan_rig(Volume.parse("2x2x2"), 1, SIZE, 1000.0), "at least two"),
        (lambda: plan_rig(Volume.parse("2x2x2"), 3, SIZE, -1.0), "positive"),
        (lambda: Mounts.around(Volume.parse("6x4x2"), Volume.parse("5x5x3")), "does not hold"),
        (lambda: Mounts.around(Volume.parse("6x4x2"), heights=(3.0, 2.0)), "lowest height first"),
        (lambda: Mounts.around(Volume.parse("6x4x2"), Volume.parse("8x6x1.9")), "does not hold"),
        (lambda: Mounts.around(Volume.parse("6x4x2"), Volume.parse("8x6x2.4"), (2.2, 2.6)), "in a room of 2.4 m"),
        (lambda: focal_length(1000), "--fov"),
        (lambda: focal_length(1000, fov=60, focal_mm=4), "--fov"),
        (lambda: focal_length(1000, fov=190), "190"),
        (lambda: focal_length(1000, focal_mm=-4, pixel_um=5), "positive"),
    ],
    ids=["one camera", "focal", "room", "heights", "low room", "above the room", "no lens", "two lenses", "fov", "mm"],
)
def test_what_makes_no_sense_is_refused(ask, message: str) -> None:
    with pytest.raises(AsterismError, match=message):
        ask()
