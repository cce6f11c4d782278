"""A bumped camera is named and mended from a recording of a walker; a rig that is good stays as it is."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from computed import computed

from asterism.calibration import Refinement
from asterism.calibration import refine_rig as refine_anew
from asterism.cameras import Camera, Rig
from asterism.cameras.files import read_rig, write_rig
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.formats import write_blobs
from asterism.geometry import rotation_from_vector
from asterism.recording import Blobs
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules


def refine_rig(blobs: Blobs, rig: Rig, **settings: int) -> Refinement:
    """What `refine_anew` gives; a second for most rigs, so that it is worked out once for the same sources."""
    return computed(refine_anew, blobs, rig, **settings)


@cache
def filmed(cameras: int) -> tuple[Rig, Blobs]:
    rng = np.random.default_rng(1)
    walk = simulate_walks(1, frames=300, seed=2)[0]
    rig = ring_rig(cameras, rng=rng)
    return rig, simulate_blobs(rig, walk.positions, ImagingSettings(noise=0.3, strays=0.5), body=walker_capsules(walk), rng=rng)[0]


def bumped(camera: Camera, degrees: float, metres: float) -> Camera:
    """As a rig has it that was calibrated before the bump."""
    axis = np.array([0.5, 0.8, 0.33])
    rotation = rotation_from_vector(np.radians(degrees) * axis / np.linalg.norm(axis)) @ camera.rotation
    return replace(camera, rotation=rotation, translation=-rotation @ (camera.position + metres * np.array([0.6, 0.0, 0.8])))


def with_bumps(rig: Rig, bumps: dict[int, tuple[float, float]]) -> Rig:
    return replace(rig, cameras=tuple(bumped(camera, *bumps[c]) if c in bumps else camera for c, camera in enumerate(rig)))


@pytest.mark.parametrize(
    ("cameras", "bumps"),
    [
        (3, {1: (0.5, 0.0)}),
        (4, {2: (0.15, 0.0)}),
        (6, {0: (8.0, 0.05)}),
        (6, {1: (1.0, 0.01), 4: (3.0, 0.02)}),
    ],
    ids=["one of three", "a tenth of a degree", "eight degrees", "two cameras"],
)
def test_the_bumped_are_named_and_mended(cameras: int, bumps: dict[int, tuple[float, float]]) -> None:
    true, blobs = filmed(cameras)
    before = with_bumps(true, bumps)
    made = refine_rig(blobs, before, frames=40)
    assert [c for c, check in enumerate(made.cameras) if check.state == "moved"] == sorted(bumps)
    assert all(check.state == "good" for c, check in enumerate(made.cameras) if c not in bumps)
    points = np.random.default_rng(3).uniform([-0.5, -0.5, 0.2], [0.5, 0.5, 1.6], (100, 3))
    for c in range(cameras):
        off = np.linalg.norm(made.rig[c].project(points) - true[c].project(points), axis=1)
        assert np.median(off) < (0.6 if c in bumps else 1e-9), f"camera {c}: {np.median(off):.2f} px"


@pytest.mark.parametrize("cameras", [3, 6])
def test_a_good_rig_stays_as_it_is(cameras: int) -> None:
    true, blobs = filmed(cameras)
    made = refine_rig(blobs, true, frames=40)
    assert made.findings == ()
    assert all(np.array_equal(a.translation, b.translation) for a, b in zip(made.rig, true, strict=True))


def test_a_camera_that_saw_nothing_is_unknown_and_two_cannot_be_told_apart() -> None:
    true, blobs = filmed(4)

    def of(cameras: list[int]) -> Blobs:
        kept = np.isin(blobs.camera_of, cameras)
        return Blobs.from_rows(blobs.frame_of[kept], blobs.camera_of[kept], blobs.xy[kept], true.names, frames=len(blobs))

    assert [check.state for check in refine_rig(of([0, 1, 2]), true, frames=40).cameras] == ["good", "good", "good", "unknown"]
    with pytest.raises(AsterismError, match="only 2 cameras"):
        refine_rig(of([0, 1]), true)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true, blobs = filmed(4)
    write_rig(with_bumps(true, {2: (1.0, 0.01)}), tmp_path / "old.toml")
    write_rig(true, tmp_path / "true.toml")
    write_blobs(blobs, tmp_path / "walk.csv")
    words = ["calibrate", "refine", tmp_path / "walk.csv", "--rig", tmp_path / "old.toml", "-o", tmp_path / "new.toml"]
    words += ["--json", tmp_path / "told.json", "--report", tmp_path / "page.html", "--frames", "40"]
    assert main([str(word) for word in words]) == 1
    shown = capsys.readouterr()
    assert f"camera {true[2].name} was moved: it is turned by" in shown.err
    told = json.loads((tmp_path / "told.json").read_text(encoding="utf-8"))
    assert [camera["state"] for camera in told["cameras"]] == ["good"] * 2 + ["moved", "good"]
    assert np.linalg.norm(read_rig(tmp_path / "new.toml")[2].position - true[2].position) < 0.005
    assert "was moved" in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert main(["calibrate", "refine", str(tmp_path / "walk.csv"), "--rig", str(tmp_path / "true.toml"), "--frames", "40"]) == 0
    assert "no camera was moved" in capsys.readouterr().out
    # a format that cannot hold the vertical says so, here as of a board
    words = ["calibrate", "refine", str(tmp_path / "walk.csv"), "--rig", str(tmp_path / "true.toml"), "--frames", "40"]
    assert main([*words, "-o", str(tmp_path / "rig.yml"), "--json", str(tmp_path / "lost.json")]) == 1
    assert "leaves out the vertical" in capsys.readouterr().err
    assert [one["code"] for one in json.loads((tmp_path / "lost.json").read_text())["findings"]][-1] == "board-format-loses"


def zoomed(camera: Camera, factor: float) -> Camera:
    return replace(camera, focal=(factor * camera.focal[0], factor * camera.focal[1]))


@pytest.mark.parametrize("cameras", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_a_turned_zoom_ring_is_told_from_a_bump(cameras: int) -> None:
    true, blobs = filmed(cameras)
    made = refine_rig(blobs, replace(true, cameras=(true[0], zoomed(true[1], 1.04), *true.cameras[2:])), frames=40)
    check = made.cameras[1]
    assert check.state == "moved" and check.zoomed == pytest.approx(1 / 1.04 - 1, abs=0.004)
    assert check.shifted < 0.03, "what the zoom did must not be put down to a camera that walked away"
    assert "focal length changed by -3." in made.findings[0].sentence
    turned_only = refine_rig(blobs, with_bumps(true, {1: (2.0, 0.02)}), frames=40).cameras[1]
    assert turned_only.state == "moved" and turned_only.zoomed == 0.0


def late(blobs: Blobs, camera: int, frames: int) -> Blobs:
    frame = blobs.frame_of + np.where(blobs.camera_of == camera, frames, 0)
    kept = (frame >= 0) & (frame < len(blobs))
    return Blobs.from_rows(frame[kept], blobs.camera_of[kept], blobs.xy[kept], blobs.cameras, frames=len(blobs))


@pytest.mark.parametrize("frames", [pytest.param(1, marks=pytest.mark.slow), -4])
def test_a_camera_out_of_step_is_not_mended_as_if_it_were_bumped(frames: int) -> None:
    true, blobs = filmed(6)
    made = refine_rig(late(blobs, 2, frames), true, frames=40)
    assert [(check.state, check.lag_frames) for check in made.cameras] == [("good", 0)] * 2 + [("out of step", frames)] + [("good", 0)] * 3
    assert np.array_equal(made.rig[2].rotation, true[2].rotation)


def test_exchanged_names_are_said() -> None:
    true, blobs = filmed(8)
    swapped = replace(true, cameras=(replace(true[1], name="c1"), replace(true[0], name="c2"), *true.cameras[2:]))
    said = [str(finding) for finding in refine_rig(blobs, swapped, frames=40).findings]
    assert "camera c1 stands where the rig has camera c2. Check whether their names were exchanged." in said


def bent(rig: Rig) -> Rig:
    return replace(rig, cameras=tuple(replace(camera, radial=(0.3,)) for camera in rig))


@pytest.mark.parametrize(
    "case", [pytest.param("another ring", marks=pytest.mark.slow), "upside down", pytest.param("bent lenses", marks=pytest.mark.slow)]
)
def test_a_rig_that_is_not_the_recordings_is_refused(case: str) -> None:
    true, blobs = filmed(4)
    upside_down = replace(blobs, xy=blobs.xy * [1, -1] + [0, 1023])
    rig, seen = {
        "another ring": (ring_rig(4, radius=3.0, rng=np.random.default_rng(1)), blobs),
        "upside down": (true, upside_down),
        "bent lenses": (bent(true), blobs),
    }[case]
    with pytest.raises(AsterismError, match="calibrate the rig again"):
        refine_rig(seen, rig, frames=24)


def test_one_other_lens_is_lost() -> None:
    true, blobs = filmed(4)
    one_bent = replace(true, cameras=(true[0], bent(true)[1], *true.cameras[2:]))
    assert [check.state for check in refine_rig(blobs, one_bent, frames=40).cameras] == ["good", "lost", "good", "good"]


def test_markers_that_stand_in_few_places_tell_nothing() -> None:
    true, _ = filmed(6)
    still = np.tile(np.array([[0.0, 0.0, 1.0], [0.4, 0.1, 1.2], [-0.3, 0.3, 0.6]]), (60, 1, 1))
    blobs, _ = simulate_blobs(true, still, ImagingSettings(noise=0.3), rng=np.random.default_rng(0))
    assert {check.state for check in refine_rig(blobs, true).cameras} == {"unknown"}
