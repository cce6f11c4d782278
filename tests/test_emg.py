"""Muscles in the analog channels of a walk: which they are, and that a burst of a known height and time is where it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

import asterism
from asterism import AsterismError
from asterism.cli import main
from asterism.formats import AnalogChannel
from asterism.gait import EmgRules, GaitAnalysis, analyse_gait, emg_of, envelope, muscles_by_channel, named_channels
from asterism.gait.emg import envelope_spread, is_rectified, peak, side_and_muscle
from asterism.gait.tables import gait_table
from asterism.report.gait import gait_report
from asterism.simulation import simulate_walks

RATE = 1000.0


@pytest.fixture(scope="module")
def walk() -> GaitAnalysis:
    return analyse_gait(simulate_walks(1, frames=300, markers="helen-hayes", seed=3)[0])


def bursts(analysis: GaitAnalysis, side: str, height: float, offset: float = 0.0) -> np.ndarray:
    """A tone of 97 Hz, of this height from 20 to 40 % of each of one foot's cycles, and a hundredth of it elsewhere."""
    times = np.arange(int(len(analysis.recording) / analysis.recording.rate * RATE)) / RATE
    loud = np.full(len(times), 0.01)
    for cycle in analysis.cycles:
        share = (times - cycle.strike.time) / cycle.duration
        loud[(cycle.side == side) & (share > 0.2) & (share < 0.4)] = 1.0
    return offset + height * loud * np.sin(2 * np.pi * 97.3 * times)


def channel(samples: np.ndarray, name: str = "L Rect", **more: object) -> AnalogChannel:
    return replace(AnalogChannel(name, "V", "", samples, RATE), **more)  # type: ignore[arg-type]


def found_in(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis, *channels: AnalogChannel):  # type: ignore[no-untyped-def]
    monkeypatch.setattr("asterism.gait.emg.analog_channels", lambda recording: channels)
    return emg_of(walk.recording, walk.cycles)


def test_a_burst_is_where_and_as_high_as_it_was(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis) -> None:
    (muscle,), findings = found_in(monkeypatch, walk, channel(bursts(walk, "L", 0.002, offset=1.5)))
    assert (muscle.muscle, muscle.side, findings) == ("rectus femoris", "L", [])
    assert set(muscle.cycles) == {"L"} and muscle.cycles["L"].shape == (sum(one.side == "L" for one in walk.cycles), 101)
    mean = muscle.cycles["L"].mean(axis=0)
    assert mean[30] == pytest.approx(0.002 * 2 / np.pi, rel=0.1), "the mean of a rectified sine, and 6 % that the low-pass overshoots"
    assert abs(int(np.argmax(mean)) - 30) < 4 and mean[60:95].max() < 0.1 * mean[30]
    assert peak([muscle]) == pytest.approx(mean.max())


def test_what_moves_slowly_or_hums_above_the_band_is_no_activity() -> None:
    times = np.arange(3000) / RATE
    for hertz in (2.0, 5.0):
        assert envelope(np.sin(2 * np.pi * hertz * times), RATE)[500:-500].max() < 0.02
    wide = EmgRules(low=1.0)
    assert envelope(np.sin(2 * np.pi * 5 * times), RATE, wide)[500:-500].max() > 0.5, "the filter does it"


def test_channels_go_through_the_filters_together_as_alone() -> None:
    samples = np.random.default_rng(2).normal([0.0, 3.0], [1.0, 0.1], (2000, 2))
    together = envelope(samples, RATE)
    np.testing.assert_allclose(together, np.stack([envelope(one, RATE) for one in samples.T], axis=1), atol=1e-12)


def test_a_channel_without_a_side_is_cut_by_both_feet(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis) -> None:
    (muscle,), _ = found_in(monkeypatch, walk, channel(bursts(walk, "L", 1.0), "EMG1.v"))
    assert muscle.side is None and set(muscle.cycles) == {"L", "R"}
    left, right = (int(np.argmax(muscle.cycles[side].mean(axis=0))) for side in "LR")
    assert abs(left - 30) < 4 and abs(right - 80) < 8, "half a cycle apart"


@pytest.mark.parametrize(
    ("name", "unit", "description", "told"),
    [
        ("L Rect", "V", "Imported Analog Device", True),
        ("Voltage.RERS", "V", "", True),
        ("Voltage.1", "V", "Analog EMG::Voltage [3,1]", True),
        ("EMG12.v", "mV", "", True),
        ("Foot Switch1.FS", "V", "Noraxon EMG 1.0::Foot Switch1", False),
        ("L Spare", "V", "Analog Device", False),
        ("Voltage.FootswitchA", "V", "Analog EMG::Voltage", False),
        ("Raw.Pin 1", "V", "Force Plate::Raw", False),
        ("SINE", "V", "", False),
        ("EMG1 ACC X", "V", "Delsys EMG", False),
        ("Fz1", "N", "EMG", False),
    ],
)
def test_muscles_are_told_by_unit_name_and_description(
    monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis, name: str, unit: str, description: str, told: bool
) -> None:
    one = channel(bursts(walk, "R", 1.0), name, unit=unit, description=description)
    assert len(found_in(monkeypatch, walk, one)[0]) == told
    assert not found_in(monkeypatch, walk, replace(one, of_plate=True))[0]


def test_sides_and_muscles_are_read_as_laboratories_write_them() -> None:
    wanted = {
        "Left Tibialis Anterior": ("L", "tibialis anterior"), "RTA": ("R", "tibialis anterior"), "EMG_GAST_L": ("L", "gastrocnemius"),
        "LG": (None, "gastrocnemius lateralis"), "R.SOL": ("R", "soleus"), "RF": (None, "rectus femoris"), "LRF": ("L", "rectus femoris"),
        "EMG7": (None, ""), "": (None, ""), "VL_R": ("R", "vastus lateralis"), "Left": ("L", ""),
    }  # fmt: skip
    assert {name: side_and_muscle(name) for name in wanted} == wanted


def test_a_person_names_what_the_file_does_not(
    monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis, capsys: pytest.CaptureFixture[str]
) -> None:
    channels, _ = found_in(monkeypatch, walk, channel(bursts(walk, "R", 1.0), "EMG1.v"), channel(bursts(walk, "L", 1.0), "L TA"))
    muscles = muscles_by_channel(["EMG1=right soleus", "EMG9=LRF"])
    first, second = named_channels(channels, muscles)
    assert (first.side, first.muscle, set(first.cycles)) == ("R", "soleus", {"R"}) and second == channels[1]
    with pytest.raises(AsterismError, match="other side"):
        named_channels(channels, muscles_by_channel(["L TA=RTA"]))
    for word in ("EMG1", "EMG1=soleus", "EMG1=L", "=LRF"):
        assert main(["gait", "walk.c3d", "--emg", word]) == 2
        assert word in capsys.readouterr().err


def test_channels_that_cannot_be_used_are_left_out_and_said(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis) -> None:
    good = bursts(walk, "L", 1.0)
    broken = good.copy()
    broken[7] = np.nan
    loose = np.where(np.random.default_rng(0).random(len(good)) > 0.5, 1.25, -1.25)
    for samples, more, said in (
        (np.zeros(len(good)), {}, "equal"),
        (broken, {}, "no numbers"),
        (loose, {}, "loose cable"),
        (good[:500], {}, "shorter than a second"),
        (good[::10], {"rate": 100.0}, "too few for a muscle"),
    ):
        channels, (finding,) = found_in(monkeypatch, walk, channel(samples, **more))
        assert channels == () and finding.code == "emg-channel" and said in finding.sentence and "L Rect" in finding.sentence
    channels, (finding,) = found_in(monkeypatch, walk, channel(np.clip(good, -0.9, 0.9)))
    assert len(channels) == 1 and finding.code == "emg-clipped"


def test_the_report_shows_both_sides_of_a_muscle_in_one_panel(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis, tmp_path: Path) -> None:
    channels, _ = found_in(monkeypatch, walk, channel(bursts(walk, "L", 1.0)), channel(bursts(walk, "R", 9.0), "R Rect"))
    gait_report(tmp_path / "p.html", [("walk", replace(walk, emg=channels))])
    section = (tmp_path / "p.html").read_text().split("<h2>Muscle activity")[1].split("</section>")[0]
    assert section.count("<figure") == 1 and "L Rect, R Rect" in section
    assert 'class="mean left"' in section and 'class="mean right"' in section and 'class="interval left"' in section
    high = float(section.split('data-high="')[1].split('"')[0])
    assert 100 < high < 160, "each side is shown against its own peak"
    gait_report(tmp_path / "q.html", [("walk", walk)])
    assert "Muscle activity" not in (tmp_path / "q.html").read_text()


def test_real_walks_hold_muscles_that_their_steps_drive(data: Path) -> None:
    """The left and the right calf push in the second half of the stance, before the foot leaves the floor."""
    analysis = analyse_gait(asterism.read(data / "gait-events/fullbody/small.c3d"))
    calves = [one for one in analysis.emg if one.muscle == "gastrocnemius"]
    assert [one.side for one in calves] == ["R", "L"] and len(analysis.emg) == 14
    for one in calves:
        assert one.side is not None
        assert 25 < int(np.argmax(one.cycles[one.side].mean(axis=0))) < 60


def test_an_envelope_is_as_uncertain_as_noise_of_its_bandwidth_and_strikes(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis) -> None:
    """Of a narrower band less is known; of one that was rectified before nothing is said."""
    wide = np.random.default_rng(2).normal(size=60000)
    narrow = sosfiltfilt(butter(2, [60, 120], "bandpass", fs=RATE, output="sos"), wide)
    for samples in (wide, narrow):
        found = envelope(samples, RATE)[1000:-1000]
        assert envelope_spread(samples, RATE) == pytest.approx(found.std() / found.mean(), rel=0.12)
    assert 1.5 * envelope_spread(wide, RATE) < envelope_spread(narrow, RATE) < 0.5
    size = len(bursts(walk, "L", 1.0))
    channels, _ = found_in(monkeypatch, walk, channel(wide[:size]), channel(np.abs(wide[:size]), "R Rect"))
    assert [one.spread is None for one in channels] == [False, True]
    rows = gait_table([("walk", replace(walk, emg=channels))]).of("curve").rows
    stated = {row[2]: [one[9] for one in rows if one[2] == row[2]] for row in rows if str(row[2]).startswith("EMG")}
    assert all(one > 0 for one in stated["EMG L Rect"]) and set(stated["EMG R Rect"]) == {None}


def test_a_signal_that_was_rectified_before_is_smoothed_only_and_said(monkeypatch: pytest.MonkeyPatch, walk: GaitAnalysis) -> None:
    raw = bursts(walk, "L", 1.0)
    ((whole,), _) = found_in(monkeypatch, walk, channel(raw))
    resting = np.where(np.abs(raw) > 0.02, np.abs(raw), 0.0)
    for name, samples in (("rectified", np.abs(raw)), ("silent at rest", resting), ("an envelope", envelope(raw, RATE))):
        (muscle, other), (finding,) = found_in(monkeypatch, walk, channel(samples), channel(raw, "R Rect"))
        assert (finding.code, finding.where, muscle.rectified, other.rectified) == ("emg-rectified", "L Rect", True, False), name
        np.testing.assert_allclose(muscle.cycles["L"], whole.cycles["L"], atol=0.08, err_msg=name)
    high_passed = envelope(envelope(raw, RATE), RATE)
    assert high_passed.max() < 0.2 * envelope(raw, RATE).max(), "as a raw signal it would have gone"
    for offset in (0.0, 2.0, -2.0):
        assert not is_rectified(raw + offset), "an offset rectifies nothing"
    assert not is_rectified(-np.abs(raw)), "nor do exchanged electrodes"
