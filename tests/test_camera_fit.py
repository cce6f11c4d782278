"""A rig that is not the recording's is found: which camera does not fit, and why; a good rig gives no finding."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from asterism.cameras import Camera, Rig
from asterism.findings import Finding
from asterism.geometry import rotation_from_vector
from asterism.reconstruction import ReconstructionSettings, reconstruct, summary
from asterism.reconstruction.camera_fit import fit_of_cameras
from asterism.recording import Blobs
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules
from asterism.simulation.comparison import compare_points


@cache
def filmed(cameras: int, noise: float = 0.3, frames: int = 80) -> tuple[Rig, np.ndarray, Blobs]:
    """A walker whose body hides markers, strays, and where the markers were."""
    rng = np.random.default_rng(8)
    walk = simulate_walks(1, frames=frames, seed=4)[0]
    rig = ring_rig(cameras, rng=rng)
    return (
        rig,
        walk.positions,
        simulate_blobs(rig, walk.positions, ImagingSettings(noise=noise, strays=0.5), body=walker_capsules(walk), rng=rng)[0],
    )


def turned(camera: Camera, degrees: float) -> Camera:
    """As it was calibrated, before somebody turned it."""
    rotation = rotation_from_vector(np.radians(degrees) * np.array([0.6, 0.64, 0.48])) @ camera.rotation
    return replace(camera, rotation=rotation, translation=-rotation @ camera.position)


def zoomed(camera: Camera, factor: float) -> Camera:
    return replace(camera, focal=(factor * camera.focal[0], factor * camera.focal[1]))


def with_(rig: Rig, **cameras: Camera) -> Rig:
    return replace(rig, cameras=tuple(replace(cameras.get(camera.name, camera), name=camera.name) for camera in rig))


def late(blobs: Blobs, camera: int, frames: int) -> Blobs:
    frame = blobs.frame_of + np.where(blobs.camera_of == camera, frames, 0)
    kept = (frame >= 0) & (frame < len(blobs))
    return Blobs.from_rows(frame[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, frames=len(blobs))


def findings_of(blobs: Blobs, rig: Rig) -> list[Finding]:
    return list(summary(reconstruct(blobs, rig), rig)[1])


def messages(blobs: Blobs, rig: Rig) -> list[str]:
    return [str(finding) for finding in findings_of(blobs, rig)]


@pytest.mark.parametrize("cameras", [4, 8])
@pytest.mark.parametrize(
    "change",
    [
        lambda c: turned(c, 0.1),
        lambda c: turned(c, 0.4),
        lambda c: turned(c, 4.0),
        lambda c: zoomed(c, 1.006),
        lambda c: replace(c, radial=(0.4,)),
    ],
    ids=["a tenth of a degree", "0.4 degrees", "4 degrees", "zoom", "another lens"],
)
def test_the_camera_that_does_not_fit_is_named_and_no_other(cameras: int, change) -> None:
    rig, _, blobs = filmed(cameras)
    found = findings_of(blobs, with_(rig, c2=change(rig["c2"])))
    assert [(finding.code, finding.where) for finding in found] == [("reconstruct-camera-misfit", "c2")]


@pytest.mark.parametrize("cameras", [3, 4, 8])
@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
def test_a_good_rig_gives_no_finding(cameras: int, noise: float) -> None:
    rig, _, blobs = filmed(cameras, noise)
    assert messages(blobs, rig) == []


def test_noisy_blobs_are_not_blamed_on_a_camera() -> None:
    rig, _, blobs = filmed(6, 2.5)
    (said,) = messages(blobs, rig)
    assert "no camera is off as a whole" in said


@pytest.mark.parametrize("frames", [1, -1, 5])
def test_a_camera_out_of_step_is_said_with_its_frames(frames: int) -> None:
    rig, _, blobs = filmed(6)
    (said,) = messages(late(blobs, 1, frames), rig)
    assert f"camera c2 is {abs(frames)} frame" in said and f"its frame 200 is the others' frame {200 - frames}" in said


def test_exchanged_names_are_said() -> None:
    rig, _, blobs = filmed(6)
    said = messages(blobs, with_(rig, c1=rig["c4"], c4=rig["c1"]))
    assert said == [
        f"camera {a} shows what camera {b} of the rig should show. Were their names exchanged?" for a, b in (("c1", "c4"), ("c4", "c1"))
    ]


def test_other_pixels_other_units_another_rig() -> None:
    rig, _, blobs = filmed(6, frames=20)
    assert any("outside its image" in said for said in messages(replace(blobs, xy=2 * blobs.xy), rig))
    in_mm = replace(rig, cameras=tuple(replace(camera, translation=1000 * camera.translation) for camera in rig))
    assert any("millimetres" in said for said in messages(blobs, in_mm))
    for other in (
        replace(rig, cameras=tuple(turned(camera, degrees) for camera, degrees in zip(rig, (1.0, -1.5, 2.0, 1.2, -0.8, 1.0), strict=True))),
        ring_rig(6, radius=3.0, rng=np.random.default_rng(1)),
    ):
        assert any("do not use these points" in said.lower() for said in messages(blobs, other))
    upside_down = blobs.xy * [1, -1] + [0, rig[0].size[1] - 1]
    assert any("y counted from the top" in said for said in messages(replace(blobs, xy=upside_down), rig))
    assert any("fit" in said for said in messages(blobs, replace(rig, cameras=tuple(replace(camera, radial=()) for camera in rig))))


def test_two_moved_cameras_of_eight_spoil_no_points_and_are_named() -> None:
    rig, truth, blobs = filmed(8)
    wrong = with_(rig, c2=turned(rig["c2"], 1.0), c5=turned(rig["c5"], 2.0))
    made = reconstruct(blobs, wrong)
    assert made.noise[0] < 0.4
    seen = np.isfinite(compare_points(reconstruct(blobs, rig).clouds, truth, truth[:, :, 0] > -np.inf).error)
    assert compare_points(made.clouds, truth, seen).found(0.01) > 0.97
    assert [said.partition(" does")[0] for said in messages(blobs, wrong)] == ["camera c2", "camera c5"]


def test_reflections_are_told_from_a_camera_that_was_moved() -> None:
    rig, _, blobs = filmed(6)
    rng = np.random.default_rng(0)
    many = 60 * len(blobs)
    lit = Blobs.from_rows(
        np.concatenate([blobs.frame_of, np.repeat(np.arange(len(blobs)), 60)]),
        np.concatenate([blobs.camera_of, np.full(many, 1)]),
        np.concatenate([blobs.xy, rng.uniform(0, 1000, (many, 2))]),
        blobs.cameras,
    )
    (said,) = messages(lit, rig)
    assert said.startswith("camera c2:") and "reflections" in said


def test_the_systematic_residual_is_what_the_image_is_off_by() -> None:
    """Cameras whose images are shifted by one pixel, seen by nine that are not."""
    rig, _, blobs = filmed(10)
    shifted = replace(rig["c2"], centre=(rig["c2"].centre[0] + 0.8, rig["c2"].centre[1] - 0.6))
    wrong = with_(rig, c2=shifted)
    fits = fit_of_cameras(reconstruct(blobs, wrong, ReconstructionSettings(noise=0.5)), wrong)
    assert fits[1].systematic == pytest.approx(1.0, abs=0.1)
    assert max(fit.systematic for c, fit in enumerate(fits) if c != 1) < 0.3
