"""Filters of trajectories: against known motion with white noise and with skin that swings, spikes, gaps, and what is said of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.signal import lfilter

import asterism
from asterism import AsterismError, formats
from asterism.cli import main
from asterism.motion.filters import FilterChoice, filter_trajectories, find_spikes, last_filter
from asterism.motion.splines import _products, quintic_spline_and_power, spline_cut_off
from asterism.recording import ProcessingStep, Recording
from asterism.simulation import simulate_walks

RATE, FRAMES = 100.0, 500


@pytest.fixture(scope="module")
def heel() -> np.ndarray:
    """(T, 3) m: swings of least jerk, a heel that rises early and turns in: no sum of the waves that filters are made for."""
    cycle, share = np.divmod(np.arange(FRAMES) / RATE / 1.05, 1.0)
    swing = np.clip((share - 0.6) / 0.4, 0.0, 1.0)
    ahead = 1.37 * (cycle + 10 * swing**3 - 15 * swing**4 + 6 * swing**5)
    high = 0.12 * np.sin(np.pi * swing) ** 2 + 0.03 * np.sin(np.pi * np.clip((share - 0.35) / 0.5, 0, 1)) ** 4
    return np.stack([ahead, 0.05 * np.sin(2 * np.pi * share), high], axis=1)


def skin(seed: int, hz: float, size: float) -> np.ndarray:
    """(T, 3) m: soft tissue that swings at a frequency with a third of critical damping, pushed at random; not white."""
    decay, turn = np.exp(-2 * np.pi * hz * 0.3 / RATE), 2 * np.pi * hz / RATE
    pushes = np.random.default_rng(seed).normal(size=(FRAMES + 300, 3))
    swings = lfilter([1.0], [1.0, -2 * decay * np.cos(turn), decay**2], pushes, axis=0)[300:]
    return size * swings / swings.std()


def one(path: np.ndarray, rate: float = RATE) -> Recording:
    return Recording(path[:, None], ("LHEE",), rate)


def filtered(path: np.ndarray, choice: str) -> np.ndarray:
    return filter_trajectories(one(path), FilterChoice.of(choice)).recording.positions[:, 0]


def speed_error(path: np.ndarray, truth: np.ndarray) -> float:
    """m/s, RMS by central differences, off the ends."""
    apart = RATE * np.gradient(path - truth, axis=0)[10:-10]
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def test_white_noise_is_what_the_spline_is_made_for(heel: np.ndarray) -> None:
    errors = {choice: list[float]() for choice in ("none", "spline", "butterworth", "butterworth:6")}
    for seed in range(3):
        noisy = heel + np.random.default_rng(seed).normal(0.0, 0.0005, heel.shape)
        for choice, found in errors.items():
            found.append(speed_error(filtered(noisy, choice), heel))
    mean = {choice: float(np.mean(found)) for choice, found in errors.items()}
    assert mean["spline"] < 0.4 * mean["none"] and mean["spline"] < mean["butterworth"] < 0.6 * mean["none"], mean
    # A cut-off that suits walking at a clinic's pace cuts the heel's own motion.
    assert mean["butterworth:6"] > mean["butterworth"], mean


def test_skin_that_swings_is_no_white_noise_and_residual_analysis_takes_it_off(heel: np.ndarray) -> None:
    mean = {}
    for choice in ("none", "spline", "butterworth"):
        noisy = [heel + skin(seed, 9.0, 0.002) + np.random.default_rng(seed).normal(0.0, 0.0002, heel.shape) for seed in range(3)]
        mean[choice] = float(np.mean([speed_error(filtered(path, choice), heel) for path in noisy]))
    # Cross-validation believes what neighbouring samples share; it keeps the skin's motion, and adds nothing.
    assert 0.8 * mean["none"] < mean["spline"] < 1.01 * mean["none"], mean
    assert mean["butterworth"] < 0.7 * mean["none"], mean


@pytest.mark.parametrize("cut_off", [4.0, 6.0, 12.0])
def test_a_wave_of_the_cut_off_keeps_71_percent(cut_off: float) -> None:
    wave = np.sin(2 * np.pi * cut_off * np.arange(FRAMES) / RATE)[:, None] * [0.1, 0.0, 0.0]
    left = filtered(wave, f"butterworth:{cut_off:g}")
    assert left[100:-100, 0].std() / wave[100:-100, 0].std() == pytest.approx(np.sqrt(0.5), abs=0.01)


def test_the_splines_cut_off_is_where_71_percent_are_left() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 0.001, (2000, 1))
    _, power = quintic_spline_and_power(0.2 * np.sin(np.arange(2000) / 20.0)[:, None] + noise)
    wave = np.sin(2 * np.pi * spline_cut_off(power, 1.0) * np.arange(2000))[:, None]
    # A smoother is linear: what the same smoothness leaves of a wave tells its frequency response.
    fit, rough = _products(2000)
    basis = BSpline.design_matrix(np.arange(2000.0), np.arange(-5.0, 2005.0), 5)
    left = basis @ solveh_banded(fit + 10.0**power * rough, basis.T @ wave, lower=True)
    assert left[200:-200].std() / wave[200:-200].std() == pytest.approx(np.sqrt(0.5), abs=0.01)


@settings(max_examples=30, deadline=None)
@given(begin=st.integers(3, FRAMES - 8), width=st.integers(1, 3), size=st.floats(0.012, 0.5), seed=st.integers(0, 999))
def test_a_spike_is_found_with_its_frames(begin: int, width: int, size: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    times = np.arange(FRAMES)[:, None] / RATE
    path = np.sin(5.0 * times + rng.uniform(0.0, 6.0, 3)) * 0.3 + rng.normal(0.0, 0.0003, (FRAMES, 3))
    assert find_spikes(path, RATE) == []
    jump = rng.normal(size=3)
    path[begin : begin + width] += size * jump / np.linalg.norm(jump)
    [found] = find_spikes(path, RATE)
    np.testing.assert_array_equal(found, np.arange(begin, begin + width))


def test_a_level_that_stays_and_a_heel_that_strikes_are_no_spikes(heel: np.ndarray) -> None:
    noisy = heel + np.random.default_rng(0).normal(0.0, 0.0002, heel.shape)
    assert find_spikes(noisy[::2], RATE / 2) == [], "fewer frames make no spikes"
    noisy[300:] += 0.05
    assert find_spikes(noisy, RATE) == [] and find_spikes(noisy[:5], RATE) == [] and find_spikes(np.full((50, 3), np.nan), RATE) == []


def test_spikes_are_replaced_where_a_filter_works_and_only_said_where_none_does(heel: np.ndarray) -> None:
    spoilt = heel.copy()
    spoilt[200] += 0.04
    kept = filter_trajectories(one(spoilt), FilterChoice())
    assert kept.recording.positions is kept.recording.positions and (kept.recording.positions[:, 0] == spoilt).all()
    assert [finding.code for finding in kept.findings] == ["filter-spike"] and "frame 201" in kept.findings[0].sentence
    mended = filter_trajectories(one(spoilt), FilterChoice.of("butterworth:15"))
    assert np.linalg.norm(mended.recording.positions[:, 0] - heel, axis=1)[190:211].max() < 0.003
    assert mended.effects[0].spikes == 1 and "replaced" in mended.findings[0].sentence


@pytest.mark.parametrize("choice", ["spline", "butterworth", "butterworth:8"])
def test_gaps_stay_and_each_piece_is_filtered_for_itself(heel: np.ndarray, choice: str) -> None:
    noisy = heel + np.random.default_rng(1).normal(0.0, 0.0005, heel.shape)
    noisy[100:130] = noisy[140:150] = np.nan
    walk = Recording(np.stack([noisy, noisy], axis=1), ("LHEE", "*1"), RATE)
    result = filter_trajectories(walk, FilterChoice.of(choice))
    np.testing.assert_array_equal(result.recording.visible, walk.visible)
    np.testing.assert_array_equal(result.recording.positions[:, 1], walk.positions[:, 1])
    np.testing.assert_array_equal(result.recording.positions[130:140, 0], noisy[130:140])  # ten frames tell no noise
    np.testing.assert_allclose(result.recording.positions[:100, 0], filtered(noisy[:100], choice))
    assert [effect.label for effect in result.effects] == ["LHEE"] and 0.0 < result.effects[0].moved < 0.003


@pytest.mark.parametrize("text", ["", "median", "spline:6", "none:3", "butterworth:", "butterworth:-1", "butterworth:x", "butterworth:inf"])
def test_what_is_no_filter_is_refused(text: str) -> None:
    if text == "butterworth:":
        assert FilterChoice.of(text) == FilterChoice("butterworth")
        return
    with pytest.raises(AsterismError, match="butterworth:6"):
        FilterChoice.of(text)


def test_a_cut_off_that_the_rate_does_not_carry_is_refused(heel: np.ndarray) -> None:
    with pytest.raises(AsterismError, match="40 Hz or less"):
        filter_trajectories(one(heel), FilterChoice("butterworth", 45.0))


@pytest.mark.parametrize(
    "settings_", [{}, {"filter": "median", "markers": {}}, {"filter": "spline", "markers": {"LHEE": [1]}}, {"markers": 3}]
)
def test_a_log_that_somebody_edited_says_nothing(heel: np.ndarray, settings_: dict) -> None:
    edited = replace(one(heel), log=(ProcessingStep("filtered", "", settings_),))
    assert str(last_filter(edited)) == "not filtered"


def test_gait_and_convert_filter_and_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [walk] = simulate_walks(1, frames=240, markers="helen-hayes", seed=1)
    spoilt = walk.positions.copy()
    spoilt[100, walk.labels.index("LTHI")] += 0.05
    source, table = tmp_path / "walk.c3d", tmp_path / "out.json"
    formats.write(source, replace(walk, positions=spoilt))
    assert main(["gait", str(source), "--filter", "butterworth:10", "--json", str(table), "--report", str(tmp_path / "page.html")]) == 1
    shown = capsys.readouterr()
    assert "filtered by a Butterworth filter without lag, cut-off 10 Hz" in shown.out and "LTHI in frame 101" in shown.err
    assert "butterworth 10 Hz" in (tmp_path / "page.html").read_text()
    [content] = json.loads(table.read_text())["files"]
    assert content["filter"]["filter"] == "butterworth:10"
    assert {one["marker"]: one["spikes"] for one in content["filter"]["markers"]}["LTHI"] == 1
    knowing = (tmp_path / "page.html").read_text().split("What to know", 1)[1].split("</table>", 1)[0]
    assert "LTHI in frame 101" in knowing, "the page does not say what the terminal does"
    assert main(["gait", str(source), "--json", "-"]) == 1
    assert json.loads(capsys.readouterr().out)["files"][0]["filter"] == {"filter": "none", "markers": []}
    assert main(["convert", str(source), str(tmp_path / "smooth.c3d"), "--filter", "spline", "--json", str(tmp_path / "c.json")]) == 1
    smooth = asterism.read(tmp_path / "smooth.c3d")
    assert last_filter(smooth).choice.method == "spline" and len(last_filter(smooth).effects) == len(walk.labels)
    assert np.linalg.norm(smooth.positions - walk.positions, axis=2).max() < 0.02
    assert main(["gait", str(source), "--filter", "median"]) == 2


@pytest.mark.parametrize(("cut_off", "told"), [(6.0, False), (1.0, True)])
def test_a_filter_that_takes_away_movement_is_told(cut_off: float, told: bool) -> None:
    [walk] = simulate_walks(subjects=1, frames=200, markers="helen-hayes", seed=0)
    found = filter_trajectories(walk, FilterChoice("butterworth", cut_off)).findings
    assert [one.code for one in found if one.code == "filter-strong"] == ["filter-strong"] * told
    assert all("takes away movement" in one.sentence for one in found)


@pytest.mark.parametrize(("cut_off", "said"), [(0.1, "0.1 Hz"), (0.016, "0.016 Hz"), (2.96, "3 Hz"), (6.0, "6 Hz")])
def test_no_cut_off_is_called_0_hz(heel: np.ndarray, cut_off: float, said: str) -> None:
    assert filter_trajectories(one(heel), FilterChoice("butterworth", cut_off)).span == said
