"""How certain clinical angles are: against first-order propagation by hand, by source, whatever the workers, on the command line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from asterism import Recording, formats
from asterism.cli import main
from asterism.motion.clinical import (
    CLINICAL,
    ClinicalAngles,
    ClinicalErrors,
    ClinicalUncertainty,
    LegMeasures,
    SkinMotion,
    clinical_angles,
    clinical_uncertainty,
)
from asterism.motion.joints import leg_frames
from asterism.motion.uncertainty import MeasurementNoise, MonteCarloRules
from asterism.simulation import simulate_walks

FEW = MonteCarloRules(most=200, block=100)
PLACED = ClinicalErrors(skin=None, placement_m=0.002)


@cache
def walk() -> tuple[Recording, ClinicalAngles]:
    [recording] = simulate_walks(subjects=1, frames=8, markers="helen-hayes", seed=3)
    return recording, clinical_angles(recording)


def found(errors: ClinicalErrors, trials: int = 60, workers: int = 1) -> ClinicalUncertainty:
    return clinical_uncertainty(*walk(), errors, rules=replace(FEW, most=trials), budget_trials=10, workers=workers)


def test_misplaced_markers_are_as_first_order_propagation_has_them() -> None:
    """By central differences: each marker of the right leg and the pelvis moved along the axes of its segment."""
    recording, _ = walk()
    frames = leg_frames(recording, "R")
    segments = {"LASI": frames.pelvis, "RASI": frames.pelvis, "SACR": frames.pelvis, "RTHI": frames.thigh, "RKNE": frames.thigh}
    variance = np.zeros((len(recording), 3))
    for label, axes in segments.items():
        for axis in range(3):
            moved = []
            for step in (-1e-4, 1e-4):
                positions = recording.positions.copy()
                positions[:, recording.labels.index(label)] += step * axes[:, :, axis]
                moved.append(clinical_angles(replace(recording, positions=positions), "R").joints[0].angles)
            variance += (PLACED.placement_m * (moved[1] - moved[0]) / 2e-4) ** 2  # type: ignore[operator]
    [hip] = [one for one in found(PLACED, trials=240).joints if one.joint.name == "right hip"]
    np.testing.assert_allclose(hip.standard, np.sqrt(variance), rtol=0.18)
    low, high = hip.intervals[0.95]
    np.testing.assert_allclose(high - low, 2 * 1.96 * np.sqrt(variance), rtol=0.3)
    assert ((low < hip.joint.angles) & (hip.joint.angles < high)).all()


def test_without_sources_there_is_no_uncertainty_and_each_source_alone_adds_some() -> None:
    nothing = ClinicalErrors(skin=None, placement_m=None)
    for one in found(nothing, trials=20).joints:
        assert not np.nanmax(one.standard) > 1e-9
    cases = [(replace(nothing, noise=MeasurementNoise(0.001)), "cameras"), (replace(nothing, skin=SkinMotion()), "soft tissue"),
             (PLACED, "placement")]  # fmt: skip
    for errors, source in cases:
        for one in found(errors, trials=20).joints:
            spent = {name: float(np.nanmax(part)) for name, part in one.budget.items()}
            assert all((size > 1e-4) == (name in (source, "all")) for name, size in spent.items()), (source, spent)


def test_skin_moves_with_the_flexion_and_by_its_size() -> None:
    once, twice = (found(ClinicalErrors(skin=SkinMotion().times(factor), placement_m=None), trials=60) for factor in (0.1, 0.2))
    for one, other in zip(once.joints, twice.joints, strict=True):
        np.testing.assert_allclose(other.standard, 2 * one.standard, rtol=0.1, atol=1e-12)  # of what skin does not turn, rounding
    [knee] = [one for one in once.joints if one.joint.name == "left knee"]
    bent = np.abs(walk()[1].joints[1].angles[:, 0])
    assert knee.standard[np.argmax(bent), 0] > knee.standard[np.argmin(bent), 0]


def test_an_examiner_misplaces_a_marker_once_for_all_frames() -> None:
    recording, _ = walk()
    still = replace(recording, positions=np.repeat(recording.positions[:1], 4, axis=0))
    made = clinical_uncertainty(still, clinical_angles(still), PLACED, rules=replace(FEW, most=20), budget_trials=5)
    for one in made.joints:
        np.testing.assert_allclose(one.standard, np.repeat(one.standard[:1], 4, axis=0), rtol=1e-6)


def test_a_wand_that_a_static_trial_calibrated_counts_as_well_placed() -> None:
    recording, clinical = walk()
    known = LegMeasures(from_file=("thigh_rotation", "shank_rotation", "foot_flexion"))
    static = replace(clinical, measures=dict.fromkeys(clinical.measures, known))
    before = found(PLACED)
    after = clinical_uncertainty(recording, static, PLACED, rules=replace(FEW, most=60), budget_trials=5)
    for one, other in zip(before.joints, after.joints, strict=True):
        if one.joint.joint == "ankle":
            assert np.nanmean(other.standard[:, 0]) < 0.85 * np.nanmean(one.standard[:, 0])


def test_gaps_stay_gaps_and_workers_change_nothing() -> None:
    recording, _ = walk()
    positions = recording.positions.copy()
    positions[3, recording.labels.index("LKNE")] = np.nan
    holed = replace(recording, positions=positions)
    made = [
        clinical_uncertainty(holed, clinical_angles(holed), rules=replace(FEW, most=20, block=10), budget_trials=10, workers=workers)
        for workers in (1, 2)
    ]
    for one, other in zip(*(each.joints for each in made), strict=True):
        np.testing.assert_array_equal(np.isnan(one.standard), np.isnan(one.joint.angles))
        np.testing.assert_array_equal(one.standard, other.standard)
        np.testing.assert_array_equal(one.intervals[0.65], other.intervals[0.65])


def test_motion_prints_and_writes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, page, table, told = (tmp_path / name for name in ("walk.c3d", "page.html", "angles.csv", "told.json"))
    formats.write(path, walk()[0])
    words = ["motion", str(path), "--vertical", "z", "--limbs", "3", "--uncertainty", "--trials", "10"]
    assert main([*words, "--report", str(page), "-o", str(table), "--json", str(told)]) in (0, 1)
    assert "largest standard uncertainties" in capsys.readouterr().out and "95 %" in page.read_text()
    joints = json.loads(told.read_text())["files"][0]["clinical"]["joints"]
    with table.open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["joint"] == "right knee"]
    [knee] = [joint for joint in joints if (joint["side"], joint["joint"]) == ("right", "knee")]
    for name in CLINICAL:
        low, high = knee[f"{name}_intervals_deg"]["0.95"]
        np.testing.assert_allclose([float(row[f"{name}_low95_deg"]) for row in rows], low, atol=1e-3)
        np.testing.assert_allclose([float(row[f"{name}_high95_deg"]) for row in rows], high, atol=1e-3)
        assert set(knee[f"{name}_budget_deg"]) == {"cameras", "soft tissue", "placement", "all"}
