"""The whole chain on a simulated session, the comparisons with the truth, and `asterism demo cameras` on top."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism.cameras import Rig
from asterism.cameras.files import read_rig
from asterism.cli import _demo_cameras, main
from asterism.errors import AsterismError
from asterism.formats import read_blobs
from asterism.geometry import rotation_from_vector
from asterism.recording import Clouds
from asterism.simulation import pipeline, session, simulate_walks
from asterism.simulation.cameras import ring_rig
from asterism.simulation.comparison import compare_points, compare_rigs
from asterism.simulation.pipeline import Criterion, PipelineResult
from asterism.simulation.session import SimulatedSession, simulate_session


def test_a_rig_in_another_world_is_the_same_rig() -> None:
    rig = ring_rig(5, rng=np.random.default_rng(0))
    errors = compare_rigs(rig.moved(rotation_from_vector([0.1, 0.2, 2.0]), [1.0, 2.0, 3.0]), rig)
    assert errors.position.max() < 1e-12
    assert errors.direction.max() < 1e-6
    assert errors.focal.max() == 0
    assert abs(errors.world[1] - np.linalg.norm([0.1, 0.2, 2.0])) < 1e-9


def test_what_is_wrong_with_a_rig_is_found() -> None:
    rig = ring_rig(6)
    longer = Rig(tuple(replace(c, focal=(1.01 * c.focal[0], c.focal[1])) if c.name == "c2" else c for c in rig))
    errors = compare_rigs(longer, rig)
    assert np.allclose(errors.focal, [0, 0.01, 0, 0, 0, 0])
    larger = compare_rigs(rig.moved(np.eye(3), np.zeros(3), 1.01), rig)
    assert np.allclose(larger.position, 0.04, atol=1e-3), "a scale that is 1 % wrong is not forgiven: 4 cm at 4 m"
    with pytest.raises(AsterismError, match="three common cameras"):
        compare_rigs(Rig(rig.cameras[:2]), rig)


def test_points_are_paired_once_and_ghosts_are_counted() -> None:
    positions = np.array([[[0.0, 0, 0], [1.0, 0, 0], [2.0, 0, 0]], [[0.0, 0, 0], [0.001, 0, 0], [np.nan, 0, 0]]])
    clouds = Clouds.from_points([[[1.002, 0, 0], [0.0, 0.001, 0], [5.0, 0, 0]], [[0.0005, 0, 0.0001]]], 100.0)
    result = compare_points(clouds, positions, [[True, True, False], [True, True, False]])
    assert result.truth.tolist() == [[1, 0, -1], [0, -1, -1]]
    assert np.allclose(result.error[0, :2], [0.001, 0.002])
    assert result.ghosts == 1
    assert result.points == 4
    assert result.found(0.0015) == 0.5, "one is off by 2 mm, one shares its only point with its neighbour"
    with pytest.raises(AsterismError, match="frames"):
        compare_points(clouds, positions[:1], np.ones((1, 3)))


def test_a_session_is_the_same_each_time_and_another_with_another_seed() -> None:
    walk = simulate_walks(1, frames=30, seed=0)[0]
    one, again, other = (simulate_session(walk, seed, wand_frames=50) for seed in (0, 0, 1))
    assert np.array_equal(one.blobs.xy, again.blobs.xy)
    assert np.array_equal(one.wand.xy, again.wand.xy)
    assert not np.array_equal(one.rig[0].position, other.rig[0].position)
    assert one.seen.shape == walk.positions.shape[:2]
    assert 3 < one.seen.mean() < 6, "a body hides a marker from half of eight cameras"


def test_a_measurement_that_is_not_there_keeps_no_promise() -> None:
    assert not Criterion("", float("nan"), 1.0, False, "").met
    assert not Criterion("", float("nan"), 1.0, True, "").met
    assert Criterion("", 1.0, 1.0, False, "").met


@pytest.mark.slow
def test_the_demo_keeps_its_promises_and_says_when_it_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    outcomes: list[PipelineResult] = []
    sessions: list[SimulatedSession] = []
    work, simulate = pipeline.run_pipeline, session.simulate_session
    monkeypatch.setattr(session, "simulate_session", lambda *given: sessions.append(simulate(*given)) or sessions[-1])
    monkeypatch.setattr(pipeline, "run_pipeline", lambda *given: outcomes.append(work(*given)) or outcomes[-1])
    folder, told = tmp_path / "demo", tmp_path / "demo.json"
    assert main(["demo", "cameras", "-o", str(folder), "--json", str(told)]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "MISSED" not in shown.out
    content = json.loads(told.read_text())
    assert content["found_within_3_mm"] > 0.995
    assert content["labels"]["wrong"] <= 0.005 * content["labels"]["right"]
    assert all(check["met"] for check in content["criteria"])
    errors = compare_rigs(read_rig(folder / "rig.toml"), read_rig(folder / "true-rig.toml"))
    assert errors.position.max() < 0.002
    assert len(read_blobs(folder / "walk.csv")) == 300
    labelled = asterism.read(folder / "walk-labelled.c3d", markers="helen-hayes")
    assert labelled.visible.mean() > 0.97
    assert all((folder / name).stat().st_size > 0 for name in ("rig.html", "report.html", "points.npz", "wand.csv", "l-frame.csv"))

    by_hand = [shlex.split(line)[1:] for line in shown.out.splitlines() if line.startswith("  asterism ")]
    assert [words[0] for words in by_hand] == ["calibrate", "reconstruct", "label"]
    for words in by_hand:
        assert main(words) == 0, words
    assert compare_rigs(read_rig(folder / "my-rig.toml"), read_rig(folder / "rig.toml")).world[0] < 1e-6
    capsys.readouterr()

    model = asterism.MarkerModel.load(folder / "walkers.model")
    monkeypatch.setattr(_demo_cameras, "train_on_walkers", lambda walks, seed: model)
    monkeypatch.setattr(session, "simulate_session", lambda *given: sessions[0])
    damaged = replace(outcomes[0], wrong=500)
    monkeypatch.setattr(pipeline, "run_pipeline", lambda *given: damaged)
    assert main(["demo", "cameras", "-o", str(folder), "--json", "-"]) == 1
    shown = capsys.readouterr()
    assert "labels that are wrong" in shown.err
    assert [check["name"] for check in json.loads(shown.out)["criteria"] if not check["met"]] == ["labels that are wrong"]
