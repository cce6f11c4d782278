"""`asterism segment`, `asterism motion` and their pages, on simulated limbs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from asterism import Recording, formats
from asterism.cli import main
from asterism.simulation.soft_tissue import TrialPlan, simulate_soft_tissue


@pytest.fixture(scope="module")
def knee(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("motion") / "knee.c3d"
    formats.write(path, simulate_soft_tissue(TrialPlan("knee", points=60, frames=40), seed=1).recording)
    return path


def test_segment_tells_limbs_on_a_page_and_as_json(knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, found = tmp_path / "limbs.html", tmp_path / "limbs.json"
    assert main(["segment", str(knee), "--vertical", "z", "--report", str(page), "--json", str(found)]) == 0
    assert "2 limbs" in capsys.readouterr().out
    file = json.loads(found.read_text())["files"][0]
    assert len(file["limbs"]) == 2 and sum(len(limb["points"]) for limb in file["limbs"]) == 60
    assert "scatter3d" in page.read_text()


def test_motion_tells_angles_their_uncertainty_and_a_budget(knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, table = tmp_path / "motion.html", tmp_path / "angles.csv"
    words = ["motion", str(knee), "--vertical", "z", "--uncertainty", "--trials", "20", "--report", str(page), "-o", str(table)]
    assert main([*words, "--json", str(tmp_path / "a.json")]) == 0
    told = capsys.readouterr()
    assert "limb 1 / limb 2" in told.out and "motion-no-calibration" in told.err
    result = json.loads((tmp_path / "a.json").read_text())["files"][0]
    joint = result["joints"][0]
    # no landmark is palpated for an axis that is found from the motion
    assert set(joint["flexion_budget_deg"]) == {"cameras", "soft tissue", "all"}
    low, high = joint["angle_intervals_deg"]["0.95"]
    assert len(low) == 40 and (np.array(low) <= np.array(high)).all()
    assert "motion estimated" in result["log"][-1]
    lines = table.read_text().splitlines()
    assert len(lines) == 41 and lines[0].startswith("file,joint,time_s,angle_deg,flexion_deg,angle_low95_deg")
    assert "what makes it uncertain" in page.read_text()
    # nowhere do intervals stand without the skin on which they were tried
    assert all("simulated people, whose skin slides" in text for text in (told.out, page.read_text(), result["intervals_tried_on"]))
    assert "that hold the angle with" not in page.read_text()
    assert main([*words, "--json", str(tmp_path / "b.json"), "--overwrite", "--workers", "2"]) == 0
    assert json.loads((tmp_path / "b.json").read_text())["files"] == json.loads((tmp_path / "a.json").read_text())["files"]


def test_existing_files_are_not_replaced(knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = tmp_path / "page.html"
    page.write_text("mine")
    for verb in ("segment", "motion"):
        assert main([verb, str(knee), "--report", str(page)]) == 2
        assert "--overwrite" in capsys.readouterr().err
    assert page.read_text() == "mine"


def test_a_bad_file_of_several_is_named_and_the_others_are_done(knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    two = tmp_path / "two.csv"
    formats.write(two, Recording(np.random.default_rng(0).normal(size=(5, 2, 3)), ("a", "b"), 10.0))
    for verb in ("segment", "motion"):
        assert main([verb, str(knee), str(two), "--vertical", "z"]) == 1
        told = capsys.readouterr()
        assert "two.csv" in told.err and "three" in told.err and "2 limbs" in told.out
        assert main([verb, str(two), "--vertical", "z"]) == 2


def test_words_that_exclude_each_other_are_refused(knee: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["motion", str(knee), "--vertical", "z", "--limbs", "2", "--markers", "helen-hayes"]) == 2
    assert "one of them" in capsys.readouterr().err
    assert main(["motion", str(knee), "--vertical", "z", "--markers", "helen-hayes"]) == 2
    assert "three markers" in capsys.readouterr().err
    assert main(["motion", str(knee), "--method", "magic"]) == 2


def test_a_marker_sets_segments_are_the_limbs(tmp_path: Path) -> None:
    trial = simulate_soft_tissue(TrialPlan("knee", points=5, sparse=True, frames=30), seed=1)
    path, wanted = tmp_path / "legs.toml", {"thigh": ["P1", "P2", "P3", "P4"], "shank": ["P6", "P7", "P8"], "foot": ["P9", "P10"]}
    segments = "\n".join(f"{name} = {markers!r}" for name, markers in wanted.items())
    path.write_text(f"markers = {[f'P{i + 1}' for i in range(10)]!r}\n[segments]\n{segments}\n")
    formats.write(tmp_path / "knee.csv", trial.recording)
    words = ["motion", str(tmp_path / "knee.csv"), "--markers", str(path), "--vertical", "z", "--json", str(tmp_path / "out.json")]
    assert main(words) == 0
    limbs = json.loads((tmp_path / "out.json").read_text())["files"][0]["limbs"]
    assert {limb["name"]: limb["points"] for limb in limbs} == {"thigh": wanted["thigh"], "shank": wanted["shank"]}


@pytest.mark.slow
def test_the_demo_reaches_what_it_promises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from asterism.cli import _demo_motion

    monkeypatch.setattr(_demo_motion, "_POINTS", 120)
    monkeypatch.setattr(_demo_motion, "_TRIALS", 20)
    assert main(["demo", "motion", "-o", str(tmp_path / "demo"), "--json", str(tmp_path / "demo.json")]) == 0
    told = json.loads((tmp_path / "demo.json").read_text())
    assert told["limbs"] == 2 and told["mean_error_deg"]["robust"] < 1.5
    assert (tmp_path / "demo" / "knee.c3d").exists()
    monkeypatch.setattr(_demo_motion, "_POINTS", 6)
    assert main(["demo", "motion", "-o", str(tmp_path / "demo"), "--seed", "3"]) in (1, 2), "six points do not make a knee"


def test_the_covariance_of_a_rig_counts_where_it_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from asterism.cameras.bundle import free_parameters
    from asterism.cameras.files import write_rig
    from asterism.garment.rig_covariance import RigCovariance
    from asterism.simulation.cameras import ring_rig

    rig = ring_rig(5, radius=3.0, height=2.0, size=(2048, 1536), rng=np.random.default_rng(0))
    write_rig(rig, tmp_path / "rig.toml")
    spread = np.diag(np.tile([4e-3, 4e-3, 4e-3, 0.02, 0.02, 0.02], 5) ** 2)
    RigCovariance(rig.names, free_parameters(5, "pose"), spread).save(tmp_path / "rig.npz")
    knee = simulate_soft_tissue(TrialPlan("knee", points=40, frames=20), seed=1).recording
    formats.write(tmp_path / "knee.csv", knee)
    words = ["motion", str(tmp_path / "knee.csv"), "--vertical", "z", "--uncertainty", "--trials", "20", "--json", "-"]
    cameras = []
    for more in (["--rig", str(tmp_path / "rig.toml")], ["--rig", str(tmp_path / "rig.toml"), "--covariance", str(tmp_path / "rig.npz")]):
        assert main([*words, *more]) == 0
        told = capsys.readouterr()
        assert ("motion-no-calibration" in told.err) == (len(more) == 2)
        cameras.append(float(np.mean(json.loads(told.out)["files"][0]["joints"][0]["flexion_budget_deg"]["cameras"])))
    assert cameras[1] > 1.2 * cameras[0]
    assert main([*words, "--covariance", str(tmp_path / "rig.npz")]) == 2
    assert "--rig" in capsys.readouterr().err


def _of_limbs(points: np.ndarray, folder: Path, name: str) -> list[str]:
    """Words that analyse points (T, 8, 3), the first four a thigh, the others a shank, by a marker set of these segments."""
    labels = tuple(f"P{i + 1}" for i in range(8))
    formats.write(folder / name, Recording(points, labels, 50.0))
    segments = f"thigh = {list(labels[:4])!r}\nshank = {list(labels[4:])!r}\n"
    (folder / "set.toml").write_text(f"markers = {list(labels)!r}\n[segments]\n{segments}")
    return ["motion", str(folder / name), "--markers", str(folder / "set.toml"), "--vertical", "z"]


def test_limbs_that_tell_too_little_are_named_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    thigh, shank = rng.normal(0, 0.1, (2, 4, 3))
    turns = np.linspace(0, 1, 30)
    turned = np.array([shank @ np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in turns])
    good = np.concatenate([np.tile(thigh, (30, 1, 1)), turned], axis=1)
    line, few, half = good.copy(), good.copy(), good.copy()
    line[:, :4] = np.linspace(0, 0.3, 4)[:, None] * np.ones(3)
    few[:, :2] = np.nan
    half[:18, 5] = np.nan
    still = np.tile(good[:1], (30, 1, 1))
    cases = [
        (line, 2, "thigh: the limb's points lie in a line"),
        (few, 2, "at most 2 of the limb's points are present"),
        (half, 0, "1 points are missing in more than half of the frames (P6)"),
        (still, 1, "turns by 0.0 degrees at most"),
    ]
    for number, (points, status, sentence) in enumerate(cases):
        assert main(_of_limbs(points, tmp_path, f"case{number}.csv")) == status, sentence
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("asterism: ")]
        assert sum(sentence in line for line in lines) == 1, (sentence, lines)


def test_a_number_of_limbs_is_found_or_said_why_not(knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two rigid limbs of 30 points each do not make twelve; fifteen limbs that move by themselves do."""
    for verb in ("segment", "motion"):
        assert main([verb, str(knee), "--vertical", "z", "--limbs", "12", "--json", str(tmp_path / f"{verb}.json")]) in (0, 1)
        [file] = json.loads((tmp_path / f"{verb}.json").read_text())["files"]
        error = capsys.readouterr().err
        assert (len(file["limbs"]) == 12) != (f"12 limbs were asked for, and {len(file['limbs'])} were found" in error)
        assert main([verb, str(knee), "--vertical", "z", "--limbs", "21"]) == 2
        assert "60 points cannot form 21 limbs" in capsys.readouterr().err
    # A chain of limbs of four points each, which swing by themselves: two of them move alike enough to be merged on the way.
    rng, time = np.random.default_rng(1), np.linspace(0, 2 * np.pi, 60)
    turn, joint, limbs = Rotation.identity(len(time)), np.zeros((len(time), 3)), []
    for number in range(12):
        points = rng.uniform(-0.05, 0.05, (4, 3)) - [0, 0, 0.15]
        limbs += [joint + turn.apply(point) for point in points]
        joint = joint + turn.apply([0, 0, -0.3])
        axis = rng.normal(size=3)
        swing = 0.5 * np.sin((1 + number % 3) * time + rng.uniform(0, 6))
        turn = turn * Rotation.from_rotvec(np.outer(swing, axis / np.linalg.norm(axis)))
    chain = Recording(np.stack(limbs, axis=1), tuple(f"P{k}" for k in range(48)), 50.0)
    formats.write(tmp_path / "chain.npz", chain)
    assert main(["segment", str(tmp_path / "chain.npz"), "--limbs", "12", "--vertical", "z", "--json", str(tmp_path / "chain.json")]) == 0
    [file] = json.loads((tmp_path / "chain.json").read_text())["files"]
    assert sorted(limb["points"] for limb in file["limbs"]) == sorted([f"P{4 * k + p}" for p in range(4)] for k in range(12))


def test_a_run_that_is_broken_off_leaves_the_files_that_were_done(
    knee: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from asterism.motion import analysis

    files = [tmp_path / f"{name}.c3d" for name in "abc"]
    for file in files:
        file.write_bytes(knee.read_bytes())
    table, told = tmp_path / "angles.csv", tmp_path / "told.json"
    analyse = analysis.analyse_motion
    seen: list[object] = []

    def interrupted(recording: Recording, *args: object, **more: object) -> object:
        seen.append((table.read_text(), json.loads(told.read_text())) if table.exists() else None)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return analyse(recording, *args, **more)

    monkeypatch.setattr(analysis, "analyse_motion", interrupted)
    words = ["motion", *map(str, files), "--vertical", "z", "-o", str(table), "--json", str(told)]
    assert main([*words, "--report", str(tmp_path / "page.html")]) == 130
    # the first file was written while the second one waited: a kill there would have left it
    before, now = seen[1], (table.read_text(), json.loads(told.read_text()))
    assert before is not None and str(files[0]) in before[0] and not before[1]["complete"]
    assert [one["file"] for one in now[1]["files"]] == list(map(str, files[:2])) and not now[1]["complete"]
    assert {row.split(",")[0] for row in now[0].splitlines()[1:]} == set(map(str, files[:2]))
    assert "2 files had been analysed and are written" in capsys.readouterr().err and (tmp_path / "page.html").exists()
    monkeypatch.undo()
    assert main([*words, "--overwrite"]) == 0 and json.loads(told.read_text())["complete"]
