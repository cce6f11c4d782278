"""Bands of angles: hold the curve of known measures, widen with what is not known, by markers as drawn markers do."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import asterism
from asterism.gait import Cycle, GaitAnalysis, GaitEvent, analyse_gait, over_cycle
from asterism.gait.intervals import COVERAGE, AngleBand, angle_bands
from asterism.motion.clinical import ArmMeasures, LegMeasures, SubjectMeasures, clinical_angles
from asterism.motion.clinical.estimated import MeasurePriors, WalkEstimator, WalkPriors
from asterism.motion.clinical.measures import computed_by_the_file
from asterism.motion.clinical.plug_in_gait import angles_of, lower_body, walking_axes
from asterism.simulation import simulate_walks

LEGS = {"knee_width": 0.104, "ankle_width": 0.066, "leg_length": 0.86, "asis_trochanter": 0.072, "thigh_rotation": -0.1,
        "shank_rotation": -0.35, "tibial_torsion": -0.2, "ankle_tilt": 0.05, "foot_flexion": 0.2, "foot_rotation": 0.03}  # fmt: skip
KNOWN = SubjectMeasures(LegMeasures().with_values(LEGS), LegMeasures().with_values(LEGS))


@cache
def walk() -> GaitAnalysis:
    return analyse_gait(simulate_walks(1, frames=220, markers="helen-hayes", seed=4)[0], measures=KNOWN)


def inside(band: AngleBand, curve: np.ndarray) -> np.ndarray:
    middle, half = (band.high + band.low) / 2, (band.high - band.low) / 2
    return np.asarray(np.abs((curve - middle + np.pi) % (2 * np.pi) - np.pi) <= half + 1e-9)


def test_bands_without_measures_hold_the_curves_of_the_files_own_program(data: Path) -> None:
    recording = asterism.read(data / "movement" / "clinical-lower" / "fmc_dynamic15.c3d")
    analysis = analyse_gait(replace(recording, source=None), measures=SubjectMeasures())
    held, widths = [], {}
    for name, band in angle_bands(analysis, ("measures",)).items():
        theirs = computed_by_the_file(recording, name)
        assert theirs is not None
        cycles = [cycle for cycle in analysis.cycles if cycle.side == name[0]]
        curve = np.nanmean([over_cycle(np.radians(theirs), recording.rate, cycle) for cycle in cycles], axis=0)
        if "Pelvis" in name:
            continue  # hangs on no measure
        held.append(inside(band, curve).mean())
        widths[name] = np.degrees(band.high - band.low).mean(axis=0)
    assert np.mean(held) > 0.93 and len(held) == 8
    assert widths["LHipAngles"][0] < 10 and widths["RKneeAngles"][0] < 16 and widths["RKneeAngles"][2] < 26


def test_measures_that_are_known_leave_nothing_open_and_those_that_are_not_are_held() -> None:
    for band in angle_bands(walk(), ("measures",)).values():
        np.testing.assert_allclose(band.high, band.low, atol=1e-9)
    recording = walk().recording
    for lacking in ("thigh_rotation", "foot_flexion", "knee_width"):
        legs = LegMeasures().with_values({name: value for name, value in LEGS.items() if name != lacking})
        blind = analyse_gait(recording, measures=replace(KNOWN, left=legs, right=legs))
        bands = angle_bands(blind, ("measures",))
        name = "LAnkleAngles" if lacking == "foot_flexion" else "LHipAngles"
        axis = {"thigh_rotation": 2, "foot_flexion": 0, "knee_width": 1}[lacking]
        assert (bands[name].high - bands[name].low)[:, axis].min() > 0.01
        assert inside(bands[name], walk().curves[name].mean(axis=0))[:, axis].mean() > 0.9, lacking


def test_a_knee_that_nobody_has_is_not_held() -> None:
    """Else a band could be so wide that it holds everything."""
    legs = LegMeasures().with_values(LEGS | {"knee_width": 0.24, "foot_flexion": -0.3})
    odd = analyse_gait(walk().recording, measures=replace(KNOWN, left=legs, right=legs))
    bands = angle_bands(analyse_gait(walk().recording, measures=SubjectMeasures()), ("measures",))
    assert not inside(bands["LKneeAngles"], odd.curves["LKneeAngles"].mean(axis=0))[:, 1].mean() > 0.5
    assert not inside(bands["LAnkleAngles"], odd.curves["LAnkleAngles"].mean(axis=0))[:, 0].any()


def test_placement_spreads_curves_as_markers_that_are_drawn_do() -> None:
    recording, placed = walk().recording, 0.002
    band = angle_bands(walk(), ("placement",), placed=placed)["RKneeAngles"]
    # The offsets of the standing trial are known, so that wands and toes count as well placed.
    free = [number for number, label in enumerate(recording.labels) if label[1:] not in ("THI", "TIB", "TOE")]
    rng, curves = np.random.default_rng(5), []
    for _ in range(60):
        # Alike along all axes, so that it does not matter along whose.
        positions = recording.positions.copy()
        positions[:, free] += rng.normal(0, placed, (len(free), 3))
        moved = replace(recording, positions=positions)
        drawn = replace(analyse_gait(moved, measures=KNOWN), cycles=walk().cycles)
        outputs = drawn.clinical.outputs["RKneeAngles"] if drawn.clinical is not None else np.zeros((0, 3))
        curves.append(np.mean([over_cycle(outputs, recording.rate, one) for one in walk().cycles if one.side == "R"], axis=0))
    spread = np.std(curves, axis=0)
    np.testing.assert_allclose(band.standard["placement"].mean(axis=0), spread.mean(axis=0), rtol=0.25)
    np.testing.assert_allclose(band.high - band.low, 2 * COVERAGE * band.standard["placement"], rtol=1e-9)


def test_the_band_of_this_session_leaves_out_where_markers_are_put() -> None:
    for name, band in walk().bands.items():
        low, high = band.same_placement
        assert (low > band.low).all() and (high < band.high).all(), name
        rest = angle_bands(walk(), ("measures", "fills", "events"))[name]
        np.testing.assert_allclose((low, high), (rest.low, rest.high), atol=1e-9)


def test_strikes_that_are_off_spread_curves_as_strikes_that_are_drawn_do() -> None:
    """One strike ends a cycle and begins the next, so that it moves both."""
    longer = analyse_gait(simulate_walks(1, frames=420, markers="helen-hayes", seed=4)[0], measures=KNOWN)
    name, own = "LKneeAngles", [cycle for cycle in longer.cycles if cycle.side == "L"]
    clinical, rng, drawn = longer.clinical, np.random.default_rng(3), []
    assert clinical is not None and len(own) > 1 and own[0].next_strike.time == own[1].strike.time
    strikes = {event.time: event for cycle in own for event in (cycle.strike, cycle.next_strike)}
    for _ in range(400):
        moved = {time: replace(event, time=time + rng.normal(0.0, event.sigma)) for time, event in strikes.items()}
        cycles = [replace(cycle, strike=moved[cycle.strike.time], next_strike=moved[cycle.next_strike.time]) for cycle in own]
        drawn.append(np.mean([over_cycle(clinical.outputs[name], longer.recording.rate, cycle) for cycle in cycles], axis=0))
    stated = longer.bands[name].standard["events"]
    np.testing.assert_allclose(stated[2:-2].mean(axis=0), np.std(drawn, axis=0)[2:-2].mean(axis=0), rtol=0.15)


def test_trunk_head_and_arms_have_bands_by_their_markers_and_their_measures() -> None:
    recording = simulate_walks(1, frames=220, markers="plug-in-gait", seed=4)[0]
    blind = analyse_gait(recording, measures=KNOWN)
    arm = ArmMeasures().with_values({"shoulder_offset": 0.05, "elbow_width": 0.08, "wrist_width": 0.05, "hand_thickness": 0.03})
    measured = analyse_gait(recording, measures=replace(KNOWN, left_arm=arm, right_arm=arm, head_offset=0.2))
    assert blind.bands.keys() == blind.curves.keys() >= {f"L{name}Angles" for name in ("Thorax", "Spine", "Head", "Neck", "Elbow", "Wrist")}
    for name in ("LShoulderAngles", "RElbowAngles", "RWristAngles", "LHeadAngles", "LNeckAngles"):
        assert np.allclose(measured.bands[name].standard["measures"], 0.0), name
        assert inside(angle_bands(blind, ("measures",))[name], measured.curves[name].mean(axis=0)).mean() > 0.9, name
    # Each marker, drawn alike along all axes, so that it does not matter along which.
    rng, names = np.random.default_rng(5), ("RShoulderAngles", "RElbowAngles", "LSpineAngles", "LHeadAngles")
    curves: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for _ in range(60):
        moved = replace(recording, positions=recording.positions + rng.normal(0.0, 0.002, (len(recording.labels), 3)))
        outputs = clinical_angles(moved, measures=measured.clinical.subject).outputs if measured.clinical is not None else {}
        for name in names:
            own = [cycle for cycle in measured.cycles if cycle.side == name[0]]
            curves[name].append(np.mean([over_cycle(outputs[name], recording.rate, cycle) for cycle in own], axis=0))
    bands = angle_bands(measured, ("placement",), placed=0.002)
    for name in names:
        spread = np.std(curves[name], axis=0).mean(axis=0)
        np.testing.assert_allclose(bands[name].standard["placement"].mean(axis=0), spread, rtol=0.25, atol=1e-3, err_msg=name)


def test_fills_widen_a_band_by_what_they_leave_open() -> None:
    name = "LKneeAngles"
    cycles = len(walk().curves[name])
    filled = replace(walk(), fill_sigmas={name: np.full((cycles, 101, 3), 0.03)})
    bands = filled.bands
    np.testing.assert_allclose(bands[name].standard["fills"], 0.03 / np.sqrt(cycles))
    assert (bands[name].high - bands[name].low > walk().bands[name].high - walk().bands[name].low).all()
    assert "fills" not in bands["RKneeAngles"].standard


@pytest.mark.parametrize("turn", [-0.3, 0.0, 0.25])
def test_the_knee_shows_how_the_wand_of_the_thigh_stands(turn: float) -> None:
    """The wand of a real leg is turned about the thigh, and the estimate with it."""
    recording = walk().recording
    known = replace(KNOWN, left=replace(KNOWN.left, from_file=tuple(name for name in LEGS if name != "thigh_rotation")))
    shown = [WalkEstimator(one, known, "L").estimate().left.thigh_rotation for one in (recording, turned_wand(recording, turn))]
    assert shown[1] - shown[0] == pytest.approx(turn, abs=0.05)


def test_what_walks_have_in_common_narrows_what_is_open_and_an_axis_that_is_off_in_all_of_them_less() -> None:
    """A knee's axis that errs alike in slope and rotation tells less than two that err apart; with nothing in common the priors stay."""
    known = replace(KNOWN, left=replace(KNOWN.left, from_file=tuple(name for name in LEGS if name != "thigh_rotation")))

    def half(walks: WalkPriors) -> float:
        ((one, other),) = WalkEstimator(walk().recording, known, "L", walks=walks).apart()
        return abs(one[0].left.thigh_rotation - other[0].left.thigh_rotation) / 2

    usual = WalkPriors()
    apart, together = half(replace(usual, axis=0.0)), half(usual)
    wide = (0.0, 100.0)
    nothing = half(WalkPriors(slope=wide, hip_turn=wide, straight=wide, knee_turn=wide, ankle_turn=wide))
    assert apart < 0.95 * together < 0.5 * nothing and nothing == pytest.approx(MeasurePriors().thigh[1], rel=0.01)


def test_measures_spread_curves_as_measures_that_are_drawn_do() -> None:
    """Along independent directions, each on its own, slope and bend hold what all of them do together."""
    recording = walk().recording.frames(slice(60, 220, 3))
    estimator, rng, count = WalkEstimator(recording, SubjectMeasures(), "LR"), np.random.default_rng(1), 100
    body = lower_body(recording, estimator.estimate())
    middle, room = angles_of(recording, body), walking_axes(body)
    drawn, stated = ({name: np.zeros_like(values) for name, values in middle.items()} for _ in range(2))
    for one, other in estimator.apart():
        more, less = (angles_of(recording, made, room) for _, made in (one, other))
        for name in middle:
            stated[name] += ((more[name] - less[name]) / 2) ** 2 + 3.0 * ((more[name] + less[name]) / 2 - middle[name]) ** 2
    for _ in range(count):
        angles = angles_of(recording, lower_body(recording, estimator.drawn(rng)), room)
        for name in middle:
            drawn[name] += (angles[name] - middle[name]) ** 2 / count
    for name in ("LHipAngles", "RKneeAngles", "LAnkleAngles", "RFootProgressAngles"):
        by_bands, by_draws = (np.sqrt(np.nanmean(part[name], axis=0)) for part in (stated, drawn))
        np.testing.assert_allclose(by_bands, by_draws, rtol=0.25, err_msg=name)


def turned_wand(recording: asterism.Recording, turn: float) -> asterism.Recording:
    """With LTHI turned backwards about the line from hip to knee, by rad."""
    clinical = walk().clinical
    assert clinical is not None
    from asterism.motion.clinical import lower_body

    leg = lower_body(recording, clinical.subject, "L").legs["L"]
    column = recording.labels.index("LTHI")
    arm = recording.positions[:, column] - leg.knee
    line = leg.thigh[:, :, 2]
    along = np.einsum("ti,ti->t", arm, line)[:, None] * line
    across = arm - along
    positions = recording.positions.copy()
    positions[:, column] = leg.knee + along + np.cos(turn) * across + np.sin(turn) * np.cross(line, across)
    return replace(recording, positions=positions)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("hidden", "without", "all_the_same"),
    [
        ("LKNE", ["LHip", "LKnee", "LAnkle"], ["LPelvis", "RHip", "RKnee", "RAnkle"]),
        ("LHEE", [], ["LHip", "LKnee", "LAnkle", "RAnkle"]),
        ("SACR", ["LPelvis", "LHip", "RKnee"], []),
        ("RTIB", ["RKnee", "RAnkle"], ["RHip", "LKnee", "LAnkle"]),
    ],
)
def test_markers_that_no_cycle_shows_leave_their_angles_without_a_band(hidden: str, without: list[str], all_the_same: list[str]) -> None:
    recording, clinical = walk().recording, walk().clinical
    assert clinical is not None
    positions = recording.positions.copy()
    positions[12:, recording.labels.index(hidden)] = np.nan
    blind = replace(walk(), recording=replace(recording, positions=positions), clinical=replace(clinical, subject=SubjectMeasures()))
    for name in without:
        assert np.isnan(blind.bands[f"{name}Angles"].low).all(), name
    for name in all_the_same:
        band = blind.bands[f"{name}Angles"]
        assert np.isfinite(band.low).all() and (band.high > band.low).all(), name


def test_a_leg_that_few_frames_show_has_no_band_where_nobody_measured_it() -> None:
    """What a handful of frames tell of measures is nothing; with all measures nothing is open."""
    recording, left = walk().recording, next(cycle for cycle in walk().cycles if cycle.side == "L")
    positions, seen = recording.positions.copy(), round((left.strike.time + 0.3 * left.duration) * recording.rate)
    column = recording.labels.index("LKNE")
    positions[: seen - 3, column] = positions[seen + 4 :, column] = np.nan
    few = replace(recording, positions=positions)
    blind, known = (analyse_gait(few, measures=measures).bands for measures in (SubjectMeasures(), KNOWN))
    assert np.isnan(blind["LHipAngles"].low).all() and np.isnan(blind["LHipAngles"].standard["measures"]).all()
    assert not known["LHipAngles"].standard["measures"].any()
    assert np.isfinite(blind["RKneeAngles"].low).all()


def test_bands_of_a_minute_are_those_of_one_of_its_cycles() -> None:
    """However many cycles there are, those that are looked at are seen in as many frames."""
    recording, name = walk().recording, "LKneeAngles"
    first = next(cycle for cycle in walk().cycles if cycle.side == "L")
    begin, end = (round(event.time * recording.rate) for event in (first.strike, first.next_strike))

    def later(event: GaitEvent, number: int) -> GaitEvent:
        return replace(event, time=event.time + (number * (end - begin) - begin) / recording.rate)

    cycles = tuple(Cycle("L", later(first.strike, k), later(first.off, k), later(first.next_strike, k)) for k in range(49))
    one = replace(walk(), cycles=(first,), curves={name: walk().curves[name][:1]})
    minute = replace(recording, positions=np.tile(recording.positions[begin:end], (50, 1, 1)))
    many = replace(one, recording=minute, cycles=cycles, curves={name: np.repeat(walk().curves[name][:1], 49, axis=0)})
    # The frame of the last strike is the first one of the next copy there.
    widths = [found.bands[name].standard["placement"][:98] for found in (one, many)]
    np.testing.assert_allclose(widths[1], widths[0], atol=0.05 * float(widths[0].max()))


def test_markers_by_other_spellings_have_the_same_bands_and_what_nothing_tells_has_none() -> None:
    other = {"LASI": "L.ASIS", "RASI": "R.ASIS"}
    recording = walk().recording
    spelled = replace(walk(), recording=replace(recording, labels=tuple(other.get(label, label) for label in recording.labels)))
    for name, band in spelled.bands.items():
        np.testing.assert_allclose(band.high, walk().bands[name].high, atol=1e-9)
    # Markers put half a metre beside their places tell no angle.
    lost = angle_bands(walk(), ("placement",), placed=0.5)["LKneeAngles"]
    assert np.isnan(lost.low).all() and np.isfinite(lost.standard["placement"]).all()
