"""Lights that never move: reported where they make points, left out only when asked."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.cli import main
from asterism.formats import write_blobs
from asterism.reconstruction import ReconstructionSettings, reconstruct, summary
from asterism.reconstruction.static_points import find_static_points
from asterism.recording import Blobs
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, walker_capsules
from asterism.simulation.comparison import compare_points


@cache
def filmed(reflections: int, frames: int = 120) -> tuple[Rig, np.ndarray, Blobs]:
    rng = np.random.default_rng(6)
    walk = simulate_walks(1, frames=frames, seed=9)[0]
    rig = ring_rig(6, rng=rng)
    lamp = np.tile([1.2, -0.9, 0.1], (frames, 1, 1))
    blobs, _ = simulate_blobs(
        rig,
        np.concatenate([walk.positions, lamp], axis=1),
        ImagingSettings(noise=0.3, reflections=reflections),
        body=walker_capsules(walk),
        rng=rng,
    )
    return rig, walk.positions, blobs


def ghosts(rig: Rig, truth: np.ndarray, blobs: Blobs, **more: bool) -> float:
    points = compare_points(reconstruct(blobs, rig, ReconstructionSettings(**more)).clouds, truth, np.isfinite(truth[:, :, 0]))
    return 1000 * points.ghosts / points.points


def test_masking_takes_ghosts_of_reflections_away_and_no_marker() -> None:
    rig, truth, blobs = filmed(12)
    assert ghosts(rig, truth, blobs) > 60, "nothing to mask"
    assert ghosts(rig, truth, blobs, mask_static=True) < 3
    masked = reconstruct(blobs, rig, ReconstructionSettings(mask_static=True))
    found = compare_points(masked.clouds, truth, np.isfinite(truth[:, :, 0]))
    assert found.found(0.01) >= compare_points(reconstruct(blobs, rig).clouds, truth, np.isfinite(truth[:, :, 0])).found(0.01)
    assert masked.masked_places.min() >= 12


def test_static_points_are_given_with_position_and_cameras() -> None:
    rig, _, blobs = filmed(0)
    (lamp,) = find_static_points(reconstruct(blobs, rig))
    assert np.linalg.norm(lamp.position - [1.2, -0.9, 0.1]) < 2e-3
    assert lamp.cameras >= 4 and lamp.share == 1.0
    numbers, findings = summary(reconstruct(blobs, rig), rig)
    assert findings == (), "a marker that rests on the floor, seen by many cameras, is no fault"
    assert len(numbers["static_points"]) == 1


def test_static_points_of_most_frames_come_first() -> None:
    """Three lamps among markers that move; two of the lamps are off in some of the frames."""
    rng = np.random.default_rng(2)
    lamps, alight = np.array([[1.2, -0.9, 0.1], [-1.0, 0.4, 0.3], [0.3, 1.1, 0.2]]), [70, 100, 85]
    points = np.concatenate([np.tile(lamps, (100, 1, 1)), rng.uniform([-0.5, -0.5, 0.5], [0.5, 0.5, 1.5], (100, 6, 3))], axis=1)
    for lamp, frames in enumerate(alight):
        points[frames:, lamp] = np.nan
    rig = ring_rig(4, rng=rng)
    blobs, _ = simulate_blobs(rig, points, ImagingSettings(noise=0.2, merging=False), rng=rng)
    found = find_static_points(reconstruct(blobs, rig, ReconstructionSettings(noise=0.2)))
    assert [point.share for point in found] == pytest.approx([1.0, 0.85, 0.7], abs=0.02)
    assert np.allclose([point.position for point in found], lamps[[1, 2, 0]], atol=2e-3)


def test_reflections_that_meet_in_two_cameras_are_found() -> None:
    rig, _, blobs = filmed(12)
    finding = summary(reconstruct(blobs, rig), rig)[1][-1]
    assert finding.code == "reconstruct-static-points" and "two cameras only" in finding.sentence and "--mask-static" in finding.mend


def test_a_static_trial_is_no_finding_until_masking_takes_it() -> None:
    rig, truth, _ = filmed(0)
    still = np.repeat(truth[:1], 80, axis=0)
    blobs, _ = simulate_blobs(rig, still, ImagingSettings(noise=0.3, missed=0.1), rng=np.random.default_rng(0))
    made = reconstruct(blobs, rig)
    assert summary(made, rig)[1] == ()
    assert len(find_static_points(made)) > 0.8 * still.shape[1]
    assert "reconstruct-mostly-static" in {
        finding.code for finding in reconstruct(blobs, rig, ReconstructionSettings(mask_static=True)).findings
    }


def test_the_command_says_and_masks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig, _, blobs = filmed(12)
    write_rig(rig, tmp_path / "rig.toml")
    write_blobs(blobs, tmp_path / "2d.csv")
    words = ["reconstruct", str(tmp_path / "2d.csv"), "--rig", str(tmp_path / "rig.toml"), "-o", str(tmp_path / "clouds.npz")]
    assert main([*words, "--json", str(tmp_path / "told.json")]) == 1
    shown = capsys.readouterr()
    assert "points that never move" in shown.out and "reflections" in shown.err
    assert len(json.loads((tmp_path / "told.json").read_text())["static_points"]) > 1
    assert main([*words, "--mask-static", "--overwrite"]) == 0
    assert "static lights left out" in capsys.readouterr().out
