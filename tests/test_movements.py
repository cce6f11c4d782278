"""Events by rule: of movements whose times the test knows, of real ones, of rules and recordings that are no good, on the command line."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import asterism
from asterism import AsterismError, Event, Recording
from asterism.cli import main
from asterism.motion.events import FoundMovement, MovementRules, find_movement, movement_table, shipped_movements
from asterism.simulation import simulate_walks

RATE = 100.0
NOISE = 0.0005
"""m, of a marker in a frame."""


def noisy(points: dict[str, np.ndarray], seed: int = 0) -> Recording:
    positions = np.stack(list(points.values()), axis=1)
    return Recording(positions + NOISE * np.random.default_rng(seed).standard_normal(positions.shape), tuple(points), RATE)


def pedalling(cadence: float = 90.0) -> Recording:
    """Four seconds of two feet on cranks of 170 mm, half a revolution apart; the left one is at the top at 0.1 s."""
    times = np.arange(0, 4, 1 / RATE)
    points = {}
    for side, behind, aside in (("L", 0.0, 0.1), ("R", 0.5, -0.1)):
        angle = 2 * np.pi * ((times - 0.1) * cadence / 60 + behind)
        toe = np.stack([0.17 * np.sin(angle), np.full_like(angle, aside), 0.3 + 0.17 * np.cos(angle)], axis=1)
        hip, ankle = np.array([-0.2, aside, 1.05]), toe + np.array([-0.12, 0.0, 0.08])
        # the knee of two limbs of 0.45 m, ahead of the line from hip to ankle
        line = ankle - hip
        length = np.linalg.norm(line, axis=1, keepdims=True)
        ahead = np.stack([-line[:, 2], 0 * angle, line[:, 0]], axis=1) / length
        knee = hip + line / 2 + ahead * np.sqrt(np.maximum(0.45**2 - (length / 2) ** 2, 0.0))
        points |= {f"{side}TOE": toe, f"{side}TRO": np.tile(hip, (len(times), 1)), f"{side}KNE": knee, f"{side}ANK": ankle}
    return noisy(points)


def swing(times: np.ndarray, lag: float = 0.0) -> np.ndarray:
    """rad: still until 0.5 s, 140 degrees back until 1.4 s, through 0 at 1.65 s, 150 degrees on the other side at 2.1 s, and half back."""
    marks = np.array([0.0, 0.5, 0.95, 1.4, 1.65, 1.85, 2.1, 3.0])
    degrees = np.array([0.0, 0.0, -75.0, -140.0, 0.0, 110.0, 150.0, 90.0])
    return np.radians(PchipInterpolator(marks, degrees)(times - lag))


def golf() -> Recording:
    """Hands on an arc of 0.7 m about a shoulder, the club in line with the arm; pelvis and trunk turn by less, and earlier."""
    times = np.arange(0, 3, 1 / RATE)
    angle = swing(times)
    radial = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    shoulder = np.array([0.0, 0.0, 1.4])
    points = {"LWRA": shoulder + 0.7 * radial, "CLUBHEAD": shoulder + 1.6 * radial, "LSHO": shoulder + 0.001 * radial}
    points |= {"LWRB": points["LWRA"], "RWRA": points["LWRA"], "RWRB": points["LWRA"]}
    for name, ahead, share in (("ASI", 0.06, 0.3), ("SHO", 0.03, 0.6)):
        turn = share * swing(times, -ahead)
        for side, sign in (("L", 1.0), ("R", -1.0)):
            height = 1.0 if name == "ASI" else 1.4
            points[side + name] = np.stack([sign * 0.15 * np.cos(turn), sign * 0.15 * np.sin(turn), np.full_like(turn, height)], axis=1)
    return noisy(points)


def times_of(movement: FoundMovement, name: str, side: str = "") -> list[float]:
    return [event.time for event in movement.events if (event.name, event.side) == (name, side)]


def test_the_top_and_the_bottom_of_each_pedal_stroke_are_where_the_crank_is() -> None:
    movement = find_movement(pedalling(), MovementRules.load("pedalling"))
    period = 60.0 / 90.0
    for name, side, first in (("Top", "L", 0.1), ("Bottom", "L", 0.1 + period / 2), ("Top", "R", 0.1 + period / 2), ("Bottom", "R", 0.1)):
        found = times_of(movement, name, side)
        assert len(found) >= 5
        np.testing.assert_allclose((np.array(found) - first + period / 2) % period - period / 2, 0.0, atol=0.006, err_msg=f"{name} {side}")
    assert all(0.002 < event.sigma < 0.01 for event in movement.events) and not movement.findings
    revolutions = [phase for phase in movement.phases if phase.name == "revolution"]
    assert len(revolutions) >= 8 and all(abs(phase.duration - period) < 4 * phase.sigma for phase in revolutions)
    stroke = next(phase for phase in movement.phases if phase.name == "downstroke")
    height = {one.kind: one.value for one in stroke.extremes if one.signal == "height"}
    assert height["maximum"] == pytest.approx(0.47, abs=0.004) and height["minimum"] == pytest.approx(0.13, abs=0.004)


def test_the_phases_of_a_golf_swing_and_the_order_of_its_segments() -> None:
    movement = find_movement(golf(), MovementRules.load("golf-swing"))
    # the hands rise fast to the finish and sink slowly, which a filter makes late
    for name, time, near in (("Top", 1.4, 0.02), ("Impact", 1.65, 0.02), ("Finish", 2.1, 0.04)):
        assert times_of(movement, name) == pytest.approx([time], abs=near), name
    assert 0.45 < times_of(movement, "Takeaway")[0] < 0.7
    assert [phase.name for phase in movement.phases] == ["backswing", "forward swing", "follow-through"]
    assert movement.phases[1].duration == pytest.approx(0.25, abs=0.02)
    assert [peak.signal for peak in movement.peaks[:2]] == ["pelvis", "trunk"] and movement.peaks[0].time < movement.peaks[2].time
    assert {peak.signal for peak in movement.peaks[2:]} == {"arm", "club"}
    # 60 and 30 ms ahead of the arm: more than the uncertainty of the peaks
    assert movement.peaks[0].same > 0.9 and movement.peaks[0].sigma < 0.03


def test_the_trunk_of_a_person_who_lifts_leans_as_far_as_it_does() -> None:
    """Two lifts: the trunk leans evenly to 70 degrees at 1.5 and 4.5 s, and back, 30 degrees in 0.5 s."""
    times = np.arange(0, 6, 1 / RATE)
    lean = np.radians(np.maximum(70.0 - 60.0 * np.minimum(np.abs(times - 1.5), np.abs(times - 4.5)), 0.0))
    pelvis = np.tile([0.0, 0.0, 0.95], (len(times), 1))
    along = np.stack([np.sin(lean), 0 * lean, np.cos(lean)], axis=1)
    hands = pelvis + 0.5 * along - [0.0, 0.0, 0.6]
    points = {"SACR": pelvis, "C7": pelvis + 0.5 * along, "LFIN": hands, "RFIN": hands}
    movement = find_movement(noisy(points), MovementRules.load("lifting"))
    # 20 degrees lie 50 of them, 0.83 s, before and behind the middle
    for name, expected in (("Bending", [0.667, 3.667]), ("Lowest", [1.5, 4.5]), ("Upright", [2.333, 5.333])):
        assert times_of(movement, name) == pytest.approx(expected, abs=0.015), name
    assert [phase.name for phase in movement.phases] == ["reaching", "lifting"] * 2
    most = [one.value for phase in movement.phases for one in phase.extremes if (one.signal, one.kind) == ("trunk", "maximum")]
    assert most == pytest.approx([70.0] * 4, abs=3.0) and [one.code for one in movement.findings] == ["movement-markers"]


def test_events_become_less_certain_with_noise() -> None:
    quiet, loud = (find_movement(noise, MovementRules.load("pedalling")) for noise in (pedalling(), _louder(pedalling(), 20.0)))
    mean = [np.mean([event.sigma for event in one.events]) for one in (quiet, loud)]
    assert mean[1] > 2 * mean[0]
    apart = [
        abs(event.time - near)
        for event in loud.events
        for near in [min(times_of(quiet, event.name, event.side), key=lambda t: abs(t - event.time))]
    ]
    assert np.sqrt(np.mean(np.square(apart))) < 2 * mean[1]


def _louder(recording: Recording, times: float) -> Recording:
    rng = np.random.default_rng(1)
    return replace(recording, positions=recording.positions + times * NOISE * rng.standard_normal(recording.positions.shape))


def test_what_is_in_a_gap_or_behind_the_end_is_left_out_and_told() -> None:
    recording = pedalling()
    positions = recording.positions.copy()
    # around the third top of the left foot, at 1.433 s
    positions[140:147, recording.labels.index("LTOE")] = np.nan
    gap = find_movement(replace(recording, positions=positions), MovementRules.load("pedalling"))
    whole = find_movement(recording, MovementRules.load("pedalling"))
    assert (
        len(times_of(gap, "Top", "L")) == len(times_of(whole, "Top", "L")) - 1
        and min(np.abs(np.array(times_of(gap, "Top", "L")) - 1.433)) > 0.5
    )
    assert [one.code for one in gap.findings] == ["movement-left-out"] and "missing there" in gap.findings[0].sentence
    cut = golf().frames(slice(90, None))
    movement = find_movement(cut, MovementRules.load("golf-swing"))
    assert not times_of(movement, "Takeaway") and times_of(movement, "Impact") == pytest.approx([0.75], abs=0.02)
    assert [one.code for one in movement.findings] == ["movement-left-out"] and "Takeaway before Top" in movement.findings[0].sentence


def test_markers_that_are_not_worn_cost_their_signals_alone() -> None:
    hands = find_movement(pedalling().select(["LTOE", "RTOE"]), MovementRules.load("pedalling"))
    assert times_of(hands, "Top", "L") and [one.code for one in hands.findings] == ["movement-markers"]
    with pytest.raises(AsterismError, match="no marker for pelvis"):
        find_movement(pedalling(), MovementRules.load("squat"))
    other = Recording(pedalling().positions, tuple(f"M{n}" for n in range(8)), RATE)
    rules = replace(MovementRules.load("pedalling"), sides=("L",))
    assert times_of(find_movement(other, rules, {"pedal": "M0"}), "Top", "L")
    for given, said in (({"pedal": "M9"}, "no marker M9"), ({"crank": "M0"}, "no marker of these rules")):
        with pytest.raises(AsterismError, match=said):
            find_movement(other, rules, given)


def test_a_person_who_stands_or_walks_does_not_squat_or_pedal() -> None:
    """A share of the range alone would make movements of sway and noise."""
    still = pedalling()
    positions = np.repeat(still.positions[:1], 400, axis=0) + NOISE * np.random.default_rng(2).standard_normal(still.positions.shape)
    walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=0)[0]
    for recording, rules in ((replace(still, positions=positions), "pedalling"), (walk, "squat"), (walk, "pedalling")):
        movement = find_movement(recording, MovementRules.load(rules))
        assert movement.events == () and movement.findings[-1].code == "movement-none"


GOOD = """
[markers]
hand = ["LFIN"]
[signals]
height = { along = "up", of = "hand" }
[[events]]
name = "High"
signal = "height"
find = "maximum"
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('find = "maximum"', 'find = "max"', "'max' is not one of maximum, minimum, rising, falling"),
        ('find = "maximum"', 'find = "rising"', "cross a level"),
        ('find = "maximum"', 'find = "maximum"\nafter = "Low"', "not one of those before it"),
        ('find = "maximum"', 'find = "maximum"\nprominence = "much"', "40 %"),
        ('find = "maximum"', 'find = "maximum"\nprominance = 0.1', "prominance is no key here"),
        ('signal = "height"', 'signal = "depth"', "'depth' is not one of height"),
        ('along = "up", of', 'bend', "bend is of 3 markers"),
        ('along = "up", of', 'tall', "says what the signal is"),
        ('"LFIN"', '"{side}FIN"', "neither the signal nor the movement says which"),
        ("[[events]]", "[events]", "a list of tables"),
        ("[markers]", "cut_off = -1\n[markers]", "more than 0"),
        ("[markers]", "[markers", "no TOML"),
    ],
)  # fmt: skip
def test_rules_that_are_none_are_refused_with_their_place(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "rules.toml"
    path.write_text(GOOD)
    assert MovementRules.load(path).events[0].name == "High"
    path.write_text(GOOD.replace(old, new))
    with pytest.raises(AsterismError, match=said) as told:
        MovementRules.load(path)
    assert "rules.toml" in str(told.value)


def test_rules_that_are_missing_name_those_that_ship() -> None:
    with pytest.raises(AsterismError, match="shipped ones are golf-swing, lifting, pedalling, squat"):
        MovementRules.load("tennis")
    assert {MovementRules.load(name).title for name in shipped_movements()} == {"Golf swing", "Lifting", "Pedalling", "Squat"}


def test_events_are_written_into_the_file_and_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = replace(pedalling(), events=(Event("Top", 1.0, "Left"), Event("Whistle", 2.0)), first_frame=51)
    asterism.formats.write(tmp_path / "bike.c3d", walk)
    words = ["events", str(tmp_path / "bike.c3d"), "--rules", "pedalling", "-o", str(tmp_path / "out"), "--table", str(tmp_path / "t.csv")]
    words += ["--vertical", "z"]
    assert main([*words, "--json", str(tmp_path / "bike.json")]) == 0
    assert "revolution" in capsys.readouterr().out
    told = json.loads((tmp_path / "bike.json").read_text())["files"][0]
    event = ezc3d.c3d(str(tmp_path / "out" / "bike.c3d"))["parameters"]["EVENT"]
    written = list(zip(event["LABELS"]["value"], event["CONTEXTS"]["value"], event["TIMES"]["value"][1].round(3), strict=True))
    # times in the file count from the trial's first frame, of which half a second is not stored; the older Top has gone
    sides = {"L": "Left", "R": "Right"}
    expected = [(one["name"], sides[one["side"]], round(one["time"] + 0.5, 3)) for one in told["events"]]
    expected.append(("Whistle", "", 2.0))
    assert sorted(one[:2] for one in written) == sorted(one[:2] for one in expected)
    np.testing.assert_allclose(sorted(one[2] for one in written), sorted(one[2] for one in expected), atol=2e-3)
    with (tmp_path / "t.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert {row["kind"] for row in rows} == {"event", "duration", "minimum", "maximum", "range"}
    assert all(float(row["uncertainty"]) >= 0 for row in rows) and int(rows[0]["first_frame"]) >= 51
    assert len(movement_table({"a": find_movement(walk, MovementRules.load("pedalling"))}).rows) == len(rows)
    assert main(["events", str(tmp_path / "bike.c3d"), "--rules", "pedalling", "--marker", "pedal"]) == 2
    assert main(["events", str(tmp_path / "bike.c3d"), "--rules", "pedalling", "-o", str(tmp_path), "--overwrite"]) == 2


def test_real_squats_are_counted(data: Path) -> None:
    """Five squats, by the height of the pelvis as anybody sees it; and one, of another laboratory."""
    for name, count, depth in (("lab51-multiactivity/squats1.trc", 5, 0.3), ("fullbody61/markers_Squat2.trc", 1, 0.15)):
        movement = find_movement(asterism.read(data / "movement" / name), MovementRules.load("squat"))
        assert [len(times_of(movement, event)) for event in ("Descent", "Depth", "Upright")] == [count] * 3 and not movement.findings
        for phase in movement.phases:
            height = [one.value for one in phase.extremes if one.signal == "height"]
            assert max(height) - min(height) > depth


def test_a_real_golf_club_meets_the_ball_when_the_ball_goes(data: Path) -> None:
    recording = asterism.read(data / "conformance" / "c3d" / "sample_16" / "golf.c3d")
    markers = dict(
        club_head="2019", hands="2017", grip="2015", left_hip="2009", right_hip="2004", left_shoulder="2014", right_shoulder="2011"
    )
    movement = find_movement(recording, MovementRules.load("golf-swing"), markers)
    ball = recording.positions[:, recording.labels.index("2020")]
    gone = np.flatnonzero(np.linalg.norm(ball - ball[60], axis=1)[60:] > 0.1)[0] + 60
    assert times_of(movement, "Impact") == pytest.approx([gone / recording.rate], abs=0.01)
