"""Gait events, cycles and parameters: of feet that move by a known rule, of real children, on the command line."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from on_the_spot import kicking, marching, pedalling, standing_movements

import asterism
from asterism import AsterismError, Recording, formats
from asterism.cli import main
from asterism.files.tables import NumberTable
from asterism.formats import force_plates
from asterism.gait import (
    POINTS,
    Band,
    Cycle,
    GaitAnalysis,
    analyse_gait,
    band_of,
    cycles_of,
    find_events,
    gait_table,
    midstances,
    over_cycle,
    parameters_of,
    profile_scores,
    summarise,
    symmetries,
)
from asterism.gait.events import OFF, STRIKE, EventRules, GaitEvent
from asterism.gait.tables import COLUMNS
from asterism.motion.clinical import exchanged_pairs
from asterism.motion.clinical.measure_files import measures_by_name
from asterism.motion.gaps import fill_gaps
from asterism.simulation import simulate_walks

STRIDE, TIME, STANCE, WIDTH = 1.2, 1.1, 0.62, 0.16
"""m, s, share of the cycle, m: a person who walks by rule."""


def stepping(
    *,
    treadmill: bool = False,
    heading: float = 0.0,
    rate: float = 100.0,
    up: str = "z",
    stride: float = STRIDE,
    time: float = TIME,
    stance: float = STANCE,
) -> Recording:
    """Eight seconds of two feet that stand, swing ahead along half a cosine, and stand; half a cycle apart; the pelvis goes on evenly."""
    times = np.arange(0, 8, 1 / rate)
    speed, points = stride / time, {}

    def foot(phase: float) -> tuple[np.ndarray, np.ndarray]:
        cycle, share = np.divmod(times / time + phase, 1.0)
        swing = np.clip((share - stance) / (1 - stance), 0, 1)
        ahead = stride * (cycle - phase + 0.5 * (1 - np.cos(np.pi * swing)) + stance / 2)
        return ahead, 0.08 * np.sin(np.pi * swing)

    for side, phase, aside in (("L", 0.0, WIDTH / 2), ("R", 0.5, -WIDTH / 2)):
        ahead, lift = foot(phase)
        for name, along, high in (("HEE", 0.0, 0.05), ("TOE", 0.2, 0.04)):
            points[side + name] = np.stack([ahead + along, np.full_like(ahead, aside), high + lift], axis=1)
    for name, aside in (("LASI", 0.12), ("RASI", -0.12), ("SACR", 0.0)):
        points[name] = np.stack([speed * times + 0.1, np.full_like(times, aside), np.full_like(times, 0.9)], axis=1)
    positions = np.stack(list(points.values()), axis=1)
    if treadmill:
        positions[:, :, 0] -= (speed * times)[:, None]
    c, s = np.cos(heading), np.sin(heading)
    positions = positions @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]).T
    if up == "y":
        positions = positions[:, :, [1, 2, 0]]
    return Recording(positions, tuple(points), rate, vertical=np.array([0.0, 1.0, 0.0]) if up == "y" else np.array([0.0, 0.0, 1.0]))


@pytest.mark.parametrize("treadmill", [False, True])
@pytest.mark.parametrize(("heading", "up", "rate"), [(0.0, "z", 100.0), (2.4, "z", 150.0), (-1.0, "y", 60.0)])
def test_parameters_are_those_of_the_rule(treadmill: bool, heading: float, up: str, rate: float) -> None:
    walking = find_events(stepping(treadmill=treadmill, heading=heading, rate=rate, up=up))
    assert walking.treadmill is treadmill
    cycles = cycles_of(walking)
    assert min(sum(cycle.side == side for cycle in cycles) for side in "LR") >= 5
    means = {(one.name, one.side): one for one in summarise(parameters_of(walking, cycles))}
    for side in "LR":
        for name, value, near in (
            ("stride time", TIME, 0.01),
            ("cadence", 120 / TIME, 1.0),
            ("stride length", STRIDE, 0.01),
            ("step length", STRIDE / 2, 0.02),
            ("step width", WIDTH, 0.005),
            ("walking speed", STRIDE / TIME, 0.02),
            ("step time", TIME / 2, 0.02),
        ):
            assert means[name, side].mean == pytest.approx(value, abs=near), (name, side)
            assert means[name, side].sigma > 0


@pytest.mark.parametrize("treadmill", [False, True])
def test_midstance_is_when_the_other_foot_passes(treadmill: bool) -> None:
    """By the rule, a swing is half of a cosine from half a stride behind to half a stride ahead: it passes in its middle."""
    found = midstances(find_events(stepping(treadmill=treadmill)))
    assert len(found) > 8 and {event.side for event in found} == {"L", "R"}
    for event in found:
        # the left foot begins at phase 0, so that the right, half a cycle ahead, swings in the middle of its stance
        phase = (event.time / TIME + (0.0 if event.side == "L" else 0.5)) % 1.0
        assert phase == pytest.approx(STANCE + (1 - STANCE) / 2 - 0.5, abs=0.01) and 0.001 < event.sigma < 0.01


def test_symmetry_is_of_both_sides_and_signed() -> None:
    walk = stepping()
    parameters = parameters_of(walking := find_events(walk), cycles_of(walking))
    assert {one.name for one in symmetries(parameters)} == {"step time", "step length", "stance", "swing", "single support"}
    assert all(abs(one.value) < 3 * one.sigma + 0.5 for one in symmetries(parameters))
    longer = [replace(one, value=1.2 * one.value) if (one.name, one.side) == ("step length", "L") else one for one in parameters]
    more = {one.name: one.value for one in symmetries(longer)}["step length"]
    assert more == pytest.approx(100 * 0.2 / 1.1, abs=1.0)
    assert symmetries([one for one in parameters if one.side == "L"]) == []


def test_events_alternate_and_each_foot_leaves_after_it_struck() -> None:
    walking = find_events(simulate_walks(1, frames=400, markers="helen-hayes", seed=2)[0])
    for side in "LR":
        labels = [event.label for event in walking.events if event.side == side]
        assert all(one != other for one, other in pairwise(labels)) and len(labels) > 4
    for cycle in cycles_of(walking):
        assert cycle.strike.time < cycle.off.time < cycle.next_strike.time
        assert cycle.other_off is not None and cycle.strike.time < cycle.other_off.time < cycle.off.time


def test_a_person_who_stands_has_no_events() -> None:
    walk = stepping()
    still = replace(walk, positions=np.repeat(walk.positions[:1], 300, axis=0))
    swaying = still.positions + 0.01 * np.sin(np.linspace(0, 9, 300))[:, None, None] * np.linspace(-1, 1, still.positions.shape[1])[:, None]
    assert find_events(replace(still, positions=swaying)).events == ()
    analysis = analyse_gait(still)
    assert analysis.walking.events == () and [one.code for one in analysis.findings] == ["gait-no-cycle", "gait-no-angles"]


def test_feet_without_markers_are_named() -> None:
    walk = stepping()
    with pytest.raises(AsterismError, match="heel or ankle and one of the toes"):
        find_events(walk.select(["LHEE", "RHEE", "SACR"]))
    with pytest.raises(AsterismError, match="pelvis"):
        find_events(walk.select(["LHEE", "LTOE"]))
    one_leg = find_events(walk.select(["LHEE", "LTOE", "SACR"]))
    assert {event.side for event in one_leg.events} == {"L"}
    assert "step length" not in {one.name for one in parameters_of(one_leg, cycles_of(one_leg))}


def test_an_ankle_serves_for_a_heel_without_a_marker_and_that_is_said() -> None:
    walk = stepping()
    other = replace(walk, labels=tuple(label.replace("RHEE", "RANK") for label in walk.labels))
    analysis = analyse_gait(other)
    by_heel, by_ankle = ({event.sigma for event in analysis.walking.of(side, STRIKE)} for side in "LR")
    assert len(analysis.walking.events) == len(find_events(walk).events) and min(by_ankle) > max(by_heel)
    assert [one.sentence for one in analysis.findings if one.code == "gait-no-heel"] == [
        "the recording has no marker of the right heel: strikes are told by the ankle, and less certain."
    ]


@given(
    begin=st.floats(0.0, 1.0),
    duration=st.floats(0.3, 2.0),
    slope=st.floats(-5.0, 5.0),
    start=st.floats(-5.0, 5.0),
    rate=st.floats(50.0, 300.0),
)
def test_a_straight_line_stays_one_over_the_cycle(begin: float, duration: float, slope: float, start: float, rate: float) -> None:
    events = [GaitEvent("L", label, begin + share * duration, 0.0, "") for label, share in ((STRIKE, 0.0), (OFF, 0.6), (STRIKE, 1.0))]
    times = np.arange(0.0, begin + duration + 2 / rate, 1 / rate)
    curve = over_cycle(start + slope * times, rate, Cycle("L", *events))
    np.testing.assert_allclose(curve, start + slope * (begin + duration * np.linspace(0, 1, POINTS)), atol=1e-9)


def test_a_cycle_that_the_recording_cuts_off_is_missing_there() -> None:
    events = [GaitEvent("L", label, time, 0.0, "") for label, time in ((STRIKE, 0.5), (OFF, 1.1), (STRIKE, 1.5))]
    curve = over_cycle(np.arange(101.0), 100.0, Cycle("L", *events))
    assert np.isfinite(curve[:50]).all() and np.isnan(curve[52:]).all()


def test_strikes_of_real_children_are_near_those_of_their_files(data: Path) -> None:
    """Told by markers alone; the stored ones are those of force plates. Two files: the benchmark has all."""
    apart: list[float] = []
    for child in ("HC003", "HC042"):
        recording = asterism.read(data / "gait" / child / "straight.c3d")
        start = float(recording.times[0])
        for event in recording.events:
            found = [one for one in find_events(recording).of(event.context[0], event.label)]
            apart.append(min(abs(one.time + start - event.time) for one in found))
    assert len(apart) == 8 and max(apart) < 0.05 and np.mean(apart) < 0.02


def test_a_plate_tells_events_to_milliseconds(data: Path) -> None:
    recording = asterism.read(data / "gait-events/plates/NP1003/walk_1003a09.c3d")
    plates, _ = force_plates(recording)
    by_plates = [event for event in find_events(recording, plates).events if event.source != "markers"]
    assert len(by_plates) == 6 and {event.sigma for event in by_plates} == {0.004}
    for event in by_plates:
        plate = plates[int(event.source.split()[1]) - 1]
        sample = round(event.time * plate.rate)
        before, behind = plate.load[sample - 20 : sample - 5].mean(), plate.load[sample + 5 : sample + 20].mean()
        assert (behind > before) is np.bool_(event.label == STRIKE)


def test_gait_writes_tables_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk, table, curves, page = (tmp_path / name for name in ("walk.c3d", "parameters.csv", "curves.csv", "gait.html"))
    formats.write(walk, simulate_walks(1, frames=300, markers="helen-hayes", seed=3)[0])
    words = ["gait", str(walk), "--measure", "LKneeWidth=102", "-o", str(table), "--curves", str(curves), "--report", str(page)]
    assert main([*words, "--json", str(tmp_path / "gait.json")]) == 0
    assert "walking speed" in capsys.readouterr().out
    found = json.loads((tmp_path / "gait.json").read_text())["files"][0]
    assert found["measures"]["left"]["knee_width"] == pytest.approx(0.102)
    assert {"low", "high", "standard", "same_placement"} == set(found["bands_deg"]["LKneeAngles"]) and "95 % interval" in page.read_text()
    with table.open() as lines:
        rows = list(csv.DictReader(lines))
    each = [row for row in rows if row["kind"] == "parameter"]
    assert {row["name"] for row in each} >= {"cadence", "step width", "double support"} and len(each) == len(found["parameters"])
    assert {row["kind"] for row in rows} == {"parameter", "mean", "symmetry"} and all(float(row["uncertainty"]) > 0 for row in rows)
    with curves.open() as lines:
        knee = [row for row in csv.DictReader(lines) if (row["name"], row["cycle"], row["axis"]) == ("LKneeAngles", "1", "x")]
    flexion = [row for row in knee if row["kind"] == "curve"]
    assert [int(row["percent"]) for row in flexion] == list(range(101))
    highest = next(row for row in knee if row["kind"] == "maximum")
    assert float(highest["value"]) == max(float(row["value"]) for row in flexion) and 1 < float(highest["uncertainty"]) < 20
    # the frame, of which the recording knows the angle, is beside the time
    assert int(highest["first_frame"]) - 1 <= float(highest["begins_s"]) * 100 <= int(highest["last_frame"]) - 1
    assert "knee flexion" in page.read_text() and "foot progression" in page.read_text()


@pytest.fixture(scope="module")
def table_of_a_walk() -> NumberTable:
    return gait_table([("walk", analyse_gait(simulate_walks(1, frames=250, markers="plug-in-gait", seed=3)[0]))])


def test_each_angle_of_a_table_has_its_uncertainty(table_of_a_walk: NumberTable) -> None:
    name, axis, sigma = (list(table_of_a_walk.columns).index(column) for column in ("name", "axis", "uncertainty"))
    sigmas = {(row[name], row[axis]): row[sigma] for row in table_of_a_walk.of("maximum").rows}
    assert {name for name, _ in sigmas} >= {"LPelvisAngles", "LKneeAngles", "LThoraxAngles", "RHeadAngles", "LShoulderAngles"}
    # two markers 20 cm apart that are each 5 mm off turn their line by 2 degrees; an elbow is a hinge, whose other angles are 0
    assert all(0.3 < sigma < 30 for (name, axis), sigma in sigmas.items() if "Elbow" not in name or axis == "x")


def test_a_table_is_refused_before_the_work_where_it_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for name, said in (("walk.xlsx", r".csv or .parquet"), ("walk.parquet", "pip install pyarrow")):
        assert main(["gait", "no-such-walk.c3d", "--table", str(tmp_path / name)]) == 2
        assert said in capsys.readouterr().err and not (tmp_path / name).exists()


def test_a_table_of_other_libraries_has_the_same_cells(tmp_path: Path, table_of_a_walk: NumberTable) -> None:
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    table = table_of_a_walk
    table.write(tmp_path / "walk.parquet")
    frame, read = table.to_dataframe(), pandas.read_parquet(tmp_path / "walk.parquet")
    assert list(read) == list(frame) and len(frame) == len(read) == len(table.rows)
    for column in ("kind", "value", "last_frame"):
        assert read[column].tolist() == frame[column].tolist() == [row[list(frame).index(column)] for row in table.rows]
    assert frame["percent"].isna().sum() == len(table.rows) - len(table.of("curve", "maximum", "minimum").rows)


def test_a_measure_that_is_none_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = tmp_path / "walk.c3d"
    formats.write(walk, simulate_walks(1, frames=60, markers="helen-hayes", seed=3)[0])
    refused = {
        "LKneeWidth=": "no name and number",
        "LKneeWidth": "neither a name",
        "LKneeWidth=0.1": "give it in mm",
        "Knee=100": "no measure",
    }
    for word, said in refused.items():
        assert main(["gait", str(walk), "--measure", word]) == 2
        assert said in capsys.readouterr().err
    assert measures_by_name(["LKneeWidth=101,5"]) == {"LKneeWidth": 101.5}


def test_a_band_is_kept_and_a_person_is_as_far_from_it_as_their_curves(tmp_path: Path) -> None:
    walks = [analyse_gait(walk) for walk in simulate_walks(3, frames=300, markers="helen-hayes", seed=5)]
    band = band_of(walks, ["a", "b", "c"])
    band.save(tmp_path / "controls.band")
    kept = Band.load(tmp_path / "controls.band")
    assert (kept.people, kept.cycles) == (3, band.cycles)
    np.testing.assert_allclose(kept.mean["Knee"], band.mean["Knee"], atol=1e-5)
    moved = replace(walks[0], curves={name: np.repeat(band.mean[name[1:-6]][None], 2, axis=0) for name in walks[0].curves})
    for score in profile_scores([moved], kept):
        assert score.gps == pytest.approx(0.0, abs=1e-5)
    bent = {name: curves + np.radians([10.0, 0.0, 0.0]) if "Knee" in name else curves for name, curves in moved.curves.items()}
    for score in profile_scores([replace(moved, curves=bent)], kept):
        assert np.degrees(score.variables["knee flexion"]) == pytest.approx(10.0, abs=0.01)
        assert np.degrees(score.gps) == pytest.approx(10.0 / 3.0, abs=0.01), "one of nine"
        assert score.gps_sigma is None
    walk = replace(moved, curves=bent)
    for score in profile_scores([walk], kept, sigmas=True):
        # A knee that is off by a degree more throughout is a degree further away, and the score by a third of it.
        parts = walk.bands[f"{score.side}KneeAngles"].standard.values()
        off = float(np.mean(np.sqrt(sum(part[:, 0] ** 2 for part in parts))))
        assert score.sigmas["knee flexion"] == pytest.approx(off, rel=1e-3) and np.radians(0.5) < off
        assert score.gps_sigma == pytest.approx(off / 3.0, rel=1e-2) and score.gdi_sigma is not None
    with pytest.raises(AsterismError, match="two people or more"):
        band_of(walks, ["a", "a", "a"])


def with_turns(analysis: GaitAnalysis, *numbers: int) -> GaitAnalysis:
    """An analysis in which the cycles of these places alone, and their parameters, are of turns."""
    cycles = tuple(replace(cycle, turns=place in numbers) for place, cycle in enumerate(analysis.cycles))
    turning = {(cycle.side, cycle.strike.time) for cycle in cycles if cycle.turns}
    parameters = tuple(replace(one, turns=(one.side, one.begins) in turning) for one in analysis.parameters)
    return replace(analysis, cycles=cycles, parameters=parameters)


def test_cycles_of_turns_are_in_no_mean_or_score_where_there_are_others() -> None:
    walk, other, third = (analyse_gait(one) for one in simulate_walks(3, frames=300, markers="helen-hayes", seed=0))
    walk, other, third = with_turns(walk, 0), with_turns(other), with_turns(third)
    counted = [cycle for cycle in walk.cycles if not cycle.turns]
    stride = {one.side: one for one in summarise(walk.parameters) if one.name == "stride time"}
    for side in "LR":
        own = [cycle.duration for cycle in counted if cycle.side == side]
        assert (stride[side].count, stride[side].mean) == (len(own), pytest.approx(np.mean(own)))
    # all cycles stay in the curves, and some of them count
    assert len(walk.curves["RKneeAngles"]) > len(walk.straight.curves["RKneeAngles"]) == sum(cycle.side == "R" for cycle in counted)
    assert profile_scores([walk], (band := band_of([other, third], ["b", "c"]))) == profile_scores([walk.straight], band)
    everywhere = with_turns(other, *range(len(other.cycles)))
    np.testing.assert_array_equal(
        band_of([walk, everywhere, third], ["a", "b", "c"]).mean["Knee"], band_of([walk, third], ["a", "c"]).mean["Knee"]
    )
    # where all turn, all count
    assert summarise(everywhere.parameters) == summarise(other.parameters)
    assert profile_scores([everywhere], band) == profile_scores([other], band)
    turns = [(row["kind"], row["turns"]) for row in (dict(zip(COLUMNS, row, strict=True)) for row in gait_table([("w", walk)]).rows)]
    assert {("parameter", 0), ("parameter", 1), ("curve", 0), ("curve", 1), ("mean", None)} <= set(turns)


def test_the_deviation_index_counts_standard_deviations_of_the_controls(tmp_path: Path) -> None:
    walks = [with_turns(analyse_gait(walk)) for walk in simulate_walks(4, frames=300, markers="helen-hayes", seed=5)]
    band = band_of(walks[:3], ["a", "b", "c"])
    band.save(tmp_path / "controls.band")
    kept = Band.load(tmp_path / "controls.band")
    assert kept.log_score == band.log_score and band.log_score is not None
    # each control is scored by the other two
    others = [walks[:3][:n] + walks[:3][n + 1 :] for n in range(3)]
    logs = [np.log(score.gps) for n in range(3) for score in profile_scores([walks[n]], band_of(others[n], ["x", "y"]))]
    assert band.log_score == pytest.approx((np.mean(logs), np.std(logs, ddof=1)))
    for score in profile_scores(walks[3:], kept):
        scaled = replace(kept, log_score=(float(np.log(score.gps)) - np.log(2.0), 0.25))
        assert {one.side: one.gdi for one in profile_scores(walks[3:], scaled)}[score.side] == pytest.approx(100 - 10 * np.log(2) / 0.25)
    two = band_of(walks[:2], ["a", "b"])
    assert two.log_score is None and all(score.gdi is None for score in profile_scores(walks[3:], two))


@pytest.mark.parametrize(
    "content", ["", "{}", '{"format": "asterism gait band 9"}', '{"format": "asterism gait band 1", "angles": {"Hip": 3}}']
)
def test_what_is_no_band_is_refused(tmp_path: Path, content: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "no.band"
    path.write_text(content)
    assert main(["gait", "walk.c3d", "--band", str(path)]) == 2
    told = capsys.readouterr().err
    assert "no.band" in told and "--save-band" in told and "Error" not in told


def test_controls_become_a_band_and_others_get_scores(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = []
    for number, walk in enumerate(simulate_walks(3, frames=300, markers="helen-hayes", seed=5)):
        (tmp_path / f"person{number}").mkdir()
        files.append(tmp_path / f"person{number}" / "walk.c3d")
        formats.write(files[-1], replace(walk, metadata={}))
    band, page = tmp_path / "controls.band", tmp_path / "gait.html"
    assert main(["gait", *map(str, files[:2]), "--save-band", str(band)]) == 0
    assert main(["gait", str(files[2]), "--band", str(band), "--report", str(page)]) == 0
    assert "Gait Profile Score, left" in capsys.readouterr().out
    assert "Scores" in page.read_text() and "controls" in page.read_text()


def exchanged(walk: Recording, *stems: str) -> Recording:
    other = {side + stem: twin + stem for stem in stems for side, twin in ("LR", "RL")}
    return replace(walk, labels=tuple(other.get(label, label) for label in walk.labels))


@pytest.mark.parametrize("stems", [("KNE",), ("HEE",), ("HEE", "TOE"), ("ASI", "THI", "KNE", "TIB", "ANK", "HEE", "TOE")])
def test_names_of_the_other_side_are_told_before_anybody_believes_a_side(stems: tuple[str, ...]) -> None:
    walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=4)[0]
    assert not [one for one in analyse_gait(walk).findings if one.code == "clinical-sides-exchanged"]
    (found,) = [one for one in analyse_gait(exchanged(walk, *stems)).findings if one.code == "clinical-sides-exchanged"]
    assert f"L{stems[0]}" in found.sentence or len(stems) > 4
    assert set(exchanged_pairs(exchanged(walk, *stems))) == set(stems)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirror_image_is_told_in_gait_and_in_motion(axis: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = simulate_walks(1, frames=200, markers="helen-hayes", seed=4)[0]
    factors = np.ones(3)
    factors[axis] = -1.0
    asterism.write(tmp_path / "walk.c3d", replace(walk, positions=walk.positions * factors))
    for command in ("gait", "motion"):
        assert main([command, str(tmp_path / "walk.c3d")]) == 1
        assert "clinical-sides-exchanged" in capsys.readouterr().err


def test_a_walk_backwards_has_no_events_rather_than_those_of_a_treadmill() -> None:
    walk = stepping()
    back = replace(walk, positions=walk.positions[::-1].copy())
    analysis = analyse_gait(back)
    assert (analysis.walking.events, analysis.walking.treadmill, analysis.parameters) == ((), False, ())
    assert [one.code for one in analysis.findings] == ["gait-backwards", "gait-no-angles"]
    assert not find_events(stepping(treadmill=True)).feet.backwards


@pytest.mark.filterwarnings("error")
def test_a_walk_backwards_on_a_treadmill_has_no_events_either() -> None:
    walk = stepping(treadmill=True)
    back = analyse_gait(replace(walk, positions=walk.positions[::-1].copy()))
    assert not back.walking.events and "gait-backwards" in {finding.code for finding in back.findings}
    assert analyse_gait(walk).cycles


def test_markers_that_are_seen_for_half_of_the_time_or_hardly_ever() -> None:
    walk = stepping()
    positions = walk.positions.copy()
    positions[len(walk) // 2 :] = np.nan
    assert find_events(replace(walk, positions=positions)).events
    positions[5:] = np.nan
    with pytest.raises(AsterismError, match=r"LHEE.* in ten frames or fewer"):
        find_events(replace(walk, positions=positions))


def left_strikes(walk: Recording, rules: EventRules | None = None) -> np.ndarray:
    return np.array([one.time for one in find_events(walk, rules=rules).of("L", STRIKE)])


def test_a_strike_follows_the_heels_knock_on_the_floor() -> None:
    """Feet that come down 20 ms later, ahead of the pelvis as before, strike later by the knock's share; without the knock, by nothing."""
    walk = stepping(rate=200.0)
    later = walk.positions.copy()
    later[4:, :, 2] = walk.positions[:-4, :, 2]
    for weight in (2.0, 0.0):
        moved = [left_strikes(one, EventRules(knock_weight=weight)) for one in (walk, replace(walk, positions=later))]
        np.testing.assert_allclose(moved[1] - moved[0], 0.02 * weight / (1 + weight), atol=0.003)


def test_a_strike_follows_the_slap_of_the_toe() -> None:
    """A toe that falls 60 ms behind the heel, or 80 ms: strikes are later by the share of the slap."""
    walk = stepping(rate=200.0)
    toe, heel = walk.labels.index("LTOE"), walk.labels.index("LHEE")

    def slapping(behind: int) -> Recording:
        positions = walk.positions.copy()
        height = positions[:, heel, 2] - 0.05
        positions[behind:, toe, 2] = 0.04 + 3 * height[:-behind]
        return replace(walk, positions=positions)

    for weight in (4.0, 0.0):
        moved = [left_strikes(slapping(behind), EventRules(slap_weight=weight, knock_weight=0.0)) for behind in (12, 16)]
        np.testing.assert_allclose(moved[1] - moved[0], 0.02 * weight / (1 + weight), atol=0.003)


def test_a_slap_counts_only_where_the_heel_is_on_the_floor() -> None:
    """A toe that falls against the heel while both sink tells nothing: the strike is as without its weight."""
    walk = stepping(rate=200.0)
    toe, heel = walk.labels.index("LTOE"), walk.labels.index("LHEE")
    positions = walk.positions.copy()
    lift = positions[:, heel, 2] - 0.05
    positions[6:, toe, 2] = 0.04 + 3 * lift[:-6]
    # the heel sinks for longer
    positions[16:, heel, 2] = 0.05 + lift[:-16]
    moved = [left_strikes(replace(walk, positions=positions), EventRules(slap_weight=weight, knock_weight=0.0)) for weight in (0.0, 4.0)]
    np.testing.assert_array_equal(moved[1], moved[0])
    assert np.abs(left_strikes(replace(walk, positions=positions), EventRules(down=1.0, knock_weight=0.0)) - moved[0]).min() > 0.002


def test_flat_feet_strike_by_the_height_of_their_heels_and_less_certainly_as_it_differs_from_the_halt() -> None:
    """Feet that sink without knock or slap: 20 ms later in height is half of it later in the strike, halting as before."""
    walk = stepping(rate=200.0)
    slow = walk.positions.copy()
    feet = [walk.labels.index(name) for name in ("LHEE", "LTOE", "RHEE", "RTOE")]
    lift = slow[:, feet, 2] - slow[:, feet, 2].min(axis=0)
    slow[:, feet, 2] -= lift - lift**3 / 0.08**2
    later = slow.copy()
    later[4:, :, 2] = slow[:-4, :, 2]
    rules = EventRules(apart=10.0)
    moved = [left_strikes(replace(walk, positions=positions), rules) for positions in (slow, later)]
    np.testing.assert_allclose(moved[1] - moved[0], 0.01, atol=0.003)
    sigmas = np.array([[one.sigma for one in find_events(replace(walk, positions=one)).of("L", STRIKE)] for one in (slow, later)])
    # half of what the two differ by, beside what they leave
    spread = np.sqrt(sigmas**2 - rules.strike_sigma**2)
    np.testing.assert_allclose(np.abs(spread[1] - spread[0]), 0.01, atol=0.003)


def test_noise_is_no_knock_of_feet_that_sink() -> None:
    """Feet that sink without a knock, seen with errors of 3 mm: strikes stay nearer than where all that stands out counts."""
    walk = stepping(rate=200.0)
    feet = [walk.labels.index(name) for name in ("LHEE", "LTOE", "RHEE", "RTOE")]
    slow = walk.positions.copy()
    lift = slow[:, feet, 2] - slow[:, feet, 2].min(axis=0)
    slow[:, feet, 2] -= lift - lift**3 / 0.08**2
    noisy = slow + np.random.default_rng(2).normal(0.0, 0.003, slow.shape)
    true = left_strikes(replace(walk, positions=slow))
    apart = [np.abs(left_strikes(replace(walk, positions=noisy), EventRules(noise=noise)) - true).mean() for noise in (0.0, 6.0)]
    assert apart[1] < 0.7 * apart[0] and apart[1] < 0.02, apart


@pytest.mark.parametrize("treadmill", [False, True])
def test_events_of_a_part_are_those_of_the_whole_up_to_its_ends(treadmill: bool) -> None:
    """All that lie 40 ms or more within the part, wherever it begins and ends, and no other."""
    walk = stepping(treadmill=treadmill)
    whole = find_events(walk).events
    for begin in range(0, 120, 9):
        end = len(walk) - begin
        part = find_events(replace(walk, positions=walk.positions[begin:end])).events
        found = {(one.side, one.label, round(one.time + begin / 100, 1)) for one in part}
        inside = {(one.side, one.label, round(one.time, 1)) for one in whole if begin + 4 <= 100 * one.time <= end - 5}
        around = {(one.side, one.label, round(one.time, 1)) for one in whole if begin <= 100 * one.time <= end}
        assert inside <= found <= around


def test_the_last_steps_before_a_halt_are_steps() -> None:
    """Steps grow shorter, to an eighth of the first; each counts, and a foot that sways by 2 cm afterwards does not."""
    walk = stepping()
    halting, sway = walk.positions.copy(), stepping().positions[:200] * [0.0, 0.0, 1.0]
    halting[:, :, 0] = 4.0 * (1 - np.exp(-walk.positions[:, :, 0] / 4.0))
    sway[:] = halting[-1]
    sway[:, 0, 0] += 0.02 * np.sin(np.linspace(0, 12, 200)) ** 2
    steps = find_events(walk).events
    found = find_events(replace(walk, positions=np.concatenate([halting, sway]))).events
    assert [(one.side, one.label) for one in found] == [(one.side, one.label) for one in steps]


def test_a_page_of_angles_that_no_cycle_shows_has_no_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A knee's marker out of view throughout the cycles, and in view before them."""
    walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=3)[0]
    positions = walk.positions.copy()
    positions[20:, walk.labels.index("LKNE")] = np.nan
    formats.write(tmp_path / "walk.c3d", replace(walk, positions=positions))
    assert main(["gait", str(tmp_path / "walk.c3d"), "--report", str(tmp_path / "gait.html")]) == 0
    assert "Warning" not in capsys.readouterr().err and "knee flexion" in (tmp_path / "gait.html").read_text()


def test_events_and_angles_are_as_uncertain_as_the_fills_they_rest_on() -> None:
    [walk] = simulate_walks(1, frames=300, markers="helen-hayes", seed=3)
    whole = analyse_gait(walk)
    strike = whole.walking.of("L", STRIKE)[1]
    positions, frame = walk.positions.copy(), round(strike.time * walk.rate)
    for label, reach in (("LHEE", 12), ("RTIB", 30)):
        positions[frame - reach : frame + reach, walk.labels.index(label)] = np.nan
    filled = fill_gaps(replace(walk, positions=positions), limit=1.0).recording
    told = analyse_gait(filled)
    near, alone = (
        min(walking.of("L", STRIKE), key=lambda event: abs(event.time - strike.time)) for walking in (told.walking, find_events(filled))
    )
    assert near.filled and near.sigma > alone.sigma and abs(near.time - strike.time) < 2 * near.sigma
    assert [event.sigma for event in told.walking.of("R", OFF)] == [event.sigma for event in whole.walking.of("R", OFF)]
    assert not whole.fill_sigmas and not any(event.filled for event in whole.walking.events)
    # The left knee has no filled marker of its own: a fill of the right shank leaves it alone.
    most = {side: float(np.degrees(np.nanmax(told.fill_sigmas[f"{side}KneeAngles"]))) for side in "LR"}
    assert most["L"] < 1e-6 < 0.05 < most["R"] < 10.0, most


def test_gait_fills_gaps_first_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = simulate_walks(1, frames=300, markers="helen-hayes", trials=2, seed=3)
    positions = first.positions.copy()
    positions[100:130, first.labels.index("LKNE")] = np.nan
    formats.write(tmp_path / "one.c3d", replace(first, positions=positions))
    formats.write(tmp_path / "two.c3d", second)
    words = ["gait", str(tmp_path / "one.c3d"), str(tmp_path / "two.c3d"), "--json", str(tmp_path / "out.json"), "--overwrite"]
    told = []
    for fill in ("none", "40"):
        assert main([*words, "--fill", fill, "--report", str(tmp_path / "page.html")]) in (0, 1)
        content = json.loads((tmp_path / "out.json").read_text())["files"][0]
        told.append(np.isfinite(np.array(content["curves_deg"]["LKneeAngles"], float)).mean())
        assert ("30 samples) filled" in capsys.readouterr().out) == (fill == "40") == bool(content["filled"])
        assert ("Filled markers" in (tmp_path / "page.html").read_text()) == (fill == "40")
    assert told[0] < told[1] == 1.0
    assert np.max(content["fill_sigmas_deg"]["LKneeAngles"]) > 0.05 and main([*words, "--fill", "much"]) == 2


@pytest.mark.parametrize("seed", [6, 11, 12])
def test_points_that_are_no_walk_break_nothing(seed: int) -> None:
    """Events of noise may leave a stance of one sample."""
    labels = simulate_walks(1, 20, 50.0, markers="helen-hayes", seed=5)[0].labels
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (60, len(labels), 3))
    for parameter in analyse_gait(Recording(noise, labels, 50.0)).parameters:
        assert parameter.sigma > 0.0


def test_a_recording_of_less_than_a_step_is_refused() -> None:
    walk = simulate_walks(1, 60, 50.0, markers="helen-hayes", seed=5)[0]
    with pytest.raises(AsterismError, match=r"lasts 0\.0006 s by its rate"):
        analyse_gait(replace(walk, rate=1e5))


def test_a_person_who_turns_is_told() -> None:
    """The way of a walk is bent; a straight walk does not turn, nor does one with short steps from side to side."""
    (walk,) = simulate_walks(1, frames=400, markers="helen-hayes", seed=4)
    positions = walk.positions.copy()
    middle = np.nanmean(positions[:, :, :2], axis=1)
    # each frame turned about the person, and the person moved along a circle: the heading turns by a quarter in four seconds
    angles = np.deg2rad(90.0) * np.arange(400) / 400.0
    steps = np.diff(middle, axis=0, prepend=middle[:1])
    turns = np.stack([np.stack([np.cos(angles), -np.sin(angles)], 1), np.stack([np.sin(angles), np.cos(angles)], 1)], 1)
    path = np.cumsum(np.einsum("txy,ty->tx", turns, steps), axis=0)
    positions[:, :, :2] = np.einsum("txy,tmy->tmx", turns, positions[:, :, :2] - middle[:, None]) + path[:, None]
    turned = analyse_gait(replace(walk, positions=positions))
    assert "gait-turning" in {finding.code for finding in turned.findings} and all(cycle.turns for cycle in turned.cycles)
    swaying = stepping()
    swaying.positions[:, :, 1] += 0.06 * np.sin(2 * np.pi * swaying.times / TIME)[:, None]
    assert not any(cycle.turns for cycle in cycles_of(find_events(swaying)))
    straight = analyse_gait(walk)
    assert "gait-turning" not in {finding.code for finding in straight.findings} and not any(cycle.turns for cycle in straight.cycles)


def test_the_standing_trial_of_a_folder_is_no_walk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "ann"
    folder.mkdir()
    (walk,) = simulate_walks(1, frames=150, markers="helen-hayes", seed=4)
    asterism.write(folder / "walk.c3d", walk)
    asterism.write(folder / "static.c3d", replace(walk, positions=np.repeat(walk.positions[40:41], 60, axis=0), events=()))
    main(["gait", str(folder), "--static", str(folder / "static.c3d"), "--json", "-"])
    assert [Path(one["file"]).name for one in json.loads(capsys.readouterr().out)["files"]] == ["walk.c3d"]


def running(rate: float = 200.0) -> Recording:
    """190 steps/min on a treadmill at 3.3 m/s: the feet stand for a third of the time, and between them the pelvis falls freely."""
    time, stance = 120 / 190, 0.36
    walk = stepping(treadmill=True, rate=rate, stride=3.3 * time, time=time, stance=stance)
    share = np.mod(walk.times / time, 0.5) / 0.5
    pull = np.where(share < 2 * stance, 1 / (2 * stance) - 1, -1.0) * 9.81
    rise = np.cumsum(pull) / rate
    height = np.cumsum(rise - rise.mean()) / rate
    pelvis = [walk.labels.index(name) for name in ("LASI", "RASI", "SACR")]
    walk.positions[:, pelvis, 2] += (height - np.polyval(np.polyfit(walk.times, height, 1), walk.times))[:, None]
    return walk


def smaller(walk: Recording, size: float) -> Recording:
    """A person of another size who moves alike, as gravity has it."""
    return replace(walk, positions=size * walk.positions, rate=walk.rate / np.sqrt(size))


@pytest.mark.parametrize("person", [stepping(), smaller(stepping(), 0.5), running(), smaller(running(), 0.7)])
def test_a_rate_that_is_twice_too_high_or_low_is_told_and_quick_people_are_not(person: Recording) -> None:
    for factor in (1.0, 2.0, 0.5):
        found = [one for one in analyse_gait(replace(person, rate=factor * person.rate)).findings if one.code == "gait-rate-doubtful"]
        assert len(found) == (factor != 1.0), (factor, found)
        for one in found:
            assert ("short" if factor > 1 else "long") in one.sentence


def test_somebody_who_squats_in_place_has_no_rate_of_steps() -> None:
    walk = stepping()
    pelvis = walk.positions[:, 4:].mean(axis=1, keepdims=True)
    # the feet stay behind the pelvis' way by a tenth of theirs: no step is longer than 6 cm
    walk.positions[:, :, 0] -= 0.95 * pelvis[:, :, 0]
    walk.positions[:, :4, 0] *= 0.05
    assert not [one for one in analyse_gait(replace(walk, rate=400.0)).findings if one.code == "gait-rate-doubtful"]


@pytest.mark.parametrize("name", standing_movements())
def test_feet_that_stay_where_they_are_take_no_steps(name: str) -> None:
    walking = find_events(standing_movements()[name])
    assert not walking.events and not walking.treadmill


def test_who_marches_on_the_spot_takes_steps_from_when_a_foot_leaves_to_when_it_is_back() -> None:
    recording, swings = marching()
    walking = find_events(recording)
    assert not walking.treadmill
    for side in "LR":
        for label, truth in ((OFF, swings[side]), (STRIKE, swings[side] + 0.5)):
            told = [event.time for event in walking.of(side, label)]
            np.testing.assert_allclose(told, truth, atol=0.07, err_msg=f"{side} {label}")


def test_who_kicks_strikes_when_the_foot_comes_down() -> None:
    recording, lands = kicking()
    walking = find_events(recording)
    assert [(event.side, event.label) for event in walking.events] == [("R", OFF), ("R", STRIKE)]
    assert walking.events[1].time == pytest.approx(lands, abs=0.07)


def test_feet_on_pedals_are_on_no_belt() -> None:
    """They go back below, as on a treadmill, and are not level there."""
    walking = find_events(pedalling())
    assert not walking.events and not walking.treadmill


@pytest.mark.skipif("ASTERISM_DATA" not in os.environ, reason="needs ASTERISM_DATA")
@pytest.mark.parametrize(
    ("path", "events"),
    [
        ("lab51-multiactivity/squats1.trc", 0),
        ("fullbody61/markers_Squat2.trc", 0),
        ("fullbody61/markers_StairUp3.trc", 10),
        ("optitrack-lower/rizzoli24/jumping_jacks_001.c3d", 0),
    ],
    ids=["squats", "squat", "stairs", "jumping jacks"],
)
def test_real_squats_are_no_steps_and_stairs_are(path: str, events: int) -> None:
    found = find_events(asterism.read(Path(os.environ["ASTERISM_DATA"]) / "movement" / path))
    assert len(found.events) == events
