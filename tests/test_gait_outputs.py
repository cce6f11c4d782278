"""Copies of walks with model outputs: read back with another library, beside what the file held, again and again, against a vendor's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import ezc3d
import numpy as np
import pytest

import asterism
from asterism import Recording
from asterism.cli import main
from asterism.formats import ModelPoint, force_plates, write_model_outputs
from asterism.gait import GaitAnalysis, analyse_gait, midstances, model_points, write_gait_c3d
from asterism.motion.clinical import Kinetics
from asterism.recording.filled import GapFill, logged_fills
from asterism.simulation import simulate_walks

STALE = 7.0
"""deg, mm, steps/min: what an older program left in the file."""


def walk_file(path: Path, *, prefix: str = "", angle_unit: str = "deg") -> Path:
    """Three seconds of a walk as a vendor may have left it: a stale knee angle and Cadence, events inside and outside the frames."""
    walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=3)[0]
    points = np.ones((4, len(walk.labels) + 2, 300))
    points[:3, :-2] = 1000 * np.moveaxis(walk.positions, 2, 0).swapaxes(1, 2)
    points[:3, -2:] = STALE
    file = ezc3d.c3d()
    declared = file["parameters"]
    declared["POINT"]["RATE"]["value"], declared["POINT"]["UNITS"]["value"] = [100.0], ["mm"]
    declared["POINT"]["LABELS"]["value"] = [prefix + label for label in (*walk.labels, "LKneeAngles", "LElbowAngles")]
    declared["ANALOG"]["RATE"]["value"], declared["ANALOG"]["LABELS"]["value"] = [1000.0], ["emg"]
    file["data"]["points"], file["data"]["analogs"] = points, np.sin(np.arange(3000.0))[None, None]
    groups = {
        "POINT": {"ANGLES": [prefix + "LKneeAngles", prefix + "LElbowAngles"], "ANGLE_UNITS": [angle_unit]},
        "SUBJECTS": {"USED": [1.0], "NAMES": ["Ann"]},
        "EVENT": {
            "USED": [4.0],
            "CONTEXTS": ["Left", "General", "Right", "Left"],
            "LABELS": ["Foot Strike", "Event", "foot strike", "Foot Off"],
            "DESCRIPTIONS": ["old", "a door opens", "old", "outside"],
            "TIMES": np.array([[0.0, 0.0, 0.0, 0.0], [1.0, 1.5, 1.7, 9.0]]),
        },
        "ANALYSIS": {
            "USED": [2.0],
            "NAMES": ["GDI", "Cadence"],
            "CONTEXTS": ["Left", "Left"],
            "UNITS": ["", "steps/min"],
            "DESCRIPTIONS": ["by hand", ""],
            "SUBJECTS": ["Ann", "Ann"],
            "VALUES": [91.0, STALE],
        },
        "PROCESSING": {"LKneeWidth": [102.0]},
    }
    for group, parameters in groups.items():
        for name, value in parameters.items():
            file.add_parameter(group, name, value)
    file.write(str(path))
    return path


def integers(path: Path, target: Path) -> Path:
    """The same file with samples of 16-bit integers: points in steps of 0.2 mm, one missing, analog samples in steps of 0.001."""
    raw = path.read_bytes()
    start, points, analog = (int.from_bytes(raw[at : at + 2], "little") for at in (16, 2, 4))
    at = 512 * (start - 1)
    values = np.frombuffer(raw, "<f4", 300 * (4 * points + analog), at).reshape(300, -1).copy()
    coordinates = values[:, : 4 * points].reshape(300, points, 4)
    coordinates[:, :, :3] /= 0.2
    coordinates[5, 0] = (0.0, 0.0, 0.0, -1.0)
    values[:, 4 * points :] *= 1000.0
    head = bytearray(raw[:at])
    old = np.float32(-1.0).tobytes()
    place = head.index(b"SCALE", head.index(b"POINT")) + 5 + 4
    assert head[12:16] == head[place : place + 4] == old
    head[12:16] = head[place : place + 4] = np.float32(0.2).tobytes()
    place = head.index(b"GEN_SCALE") + 9 + 4
    head[place : place + 4] = np.float32(0.001).tobytes()
    target.write_bytes(bytes(head) + np.rint(values).astype("<i2").tobytes())
    return target


def analysis_of(path: Path) -> GaitAnalysis:
    recording = asterism.read(path)
    return analyse_gait(recording, force_plates(recording)[0])


def with_kinetics(analysis: GaitAnalysis, *, per_kg: bool = True) -> GaitAnalysis:
    """The analysis with a moment, a power and a force that the test knows, unknown in the first ten frames."""
    known = np.where(np.arange(len(analysis.recording)) < 10, np.nan, 1.0)
    force = known[:, None] * np.array([2.0, 0.5, 9.0])
    kinetics = Kinetics({"LKneeMoment": known[:, None] * np.array([0.7, -0.2, 0.1])}, {"LKneePower": 1.5 * known}, {}, per_kg)
    return replace(analysis, kinetics=replace(kinetics, ground={"LGroundReactionForce": force}))


def column(file: ezc3d.c3d, label: str) -> np.ndarray:
    return np.asarray(file["data"]["points"][:3, file["parameters"]["POINT"]["LABELS"]["value"].index(label)])


@pytest.mark.parametrize(("prefix", "unit", "factor"), [("", "deg", 180 / np.pi), ("Ann:", "rad", 1.0)])
def test_another_library_reads_outputs_beside_all_that_the_file_held(tmp_path: Path, prefix: str, unit: str, factor: float) -> None:
    before = walk_file(tmp_path / "walk.c3d", prefix=prefix, angle_unit=unit)
    analysis = with_kinetics(analysis_of(before))
    assert write_gait_c3d(tmp_path / "out.c3d", analysis) == []
    old, new = ezc3d.c3d(str(before)), ezc3d.c3d(str(tmp_path / "out.c3d"))
    point = new["parameters"]["POINT"]
    assert analysis.clinical is not None
    for name, angles in analysis.clinical.outputs.items():
        assert prefix + name in point["ANGLES"]["value"]
        np.testing.assert_allclose(column(new, prefix + name), factor * angles.T, atol=1e-4)
    assert point["ANGLES"]["value"].count(prefix + "LKneeAngles") == 1 and point["ANGLE_UNITS"]["value"] == [unit]
    assert point["LABELS"]["value"].count(prefix + "LKneeAngles") == 1
    for kind, unit_of_it in (("MOMENT", "Nmm"), ("POWER", "W"), ("FORCE", "N"), ("MODELED_MARKER", "mm")):
        assert point[f"{kind}_UNITS"]["value"] == [unit_of_it]
    assert point["MOMENTS"]["value"] == [prefix + "LKneeMoment"] and point["POWERS"]["value"] == [prefix + "LKneePower"]
    groups = point["TYPE_GROUPS"]["value"]
    assert dict(zip(groups[::2], groups[1::2], strict=True)) == {
        "ANGLES": "ANGLE", "FORCES": "FORCE", "MOMENTS": "MOMENT", "POWERS": "POWER", "MODELED_MARKERS": "MODELED_MARKER"
    }  # fmt: skip
    np.testing.assert_allclose(column(new, prefix + "LKneeMoment")[:, 10:].T, np.tile([700.0, -200.0, 100.0], (290, 1)), rtol=1e-6)
    np.testing.assert_allclose(column(new, prefix + "LKneePower")[:, 10:].T, np.tile([0.0, 0.0, 1.5], (290, 1)), rtol=1e-6)
    assert np.isnan(column(new, prefix + "LKneePower")[:, :10]).all()
    # the joint centres stand between the markers of the leg, in the file's unit
    assert (column(new, prefix + "LHJC")[2] > column(new, prefix + "LKJC")[2]).all() and 300 < column(new, prefix + "LKJC")[2].mean() < 700
    # all else is as it was
    kept = [*analysis.recording.labels, "LElbowAngles"]
    for label in kept:
        np.testing.assert_array_equal(column(new, prefix + label), column(old, prefix + label))
    np.testing.assert_array_equal(new["data"]["analogs"], old["data"]["analogs"])
    assert new["parameters"]["PROCESSING"]["LKneeWidth"]["value"] == [102.0]


def test_points_of_other_programs_without_the_subject_do_not_hide_a_stale_angle(tmp_path: Path) -> None:
    walk = asterism.read(walk_file(tmp_path / "walk.c3d", prefix="Ann:"))
    file = ezc3d.c3d(str(tmp_path / "walk.c3d"))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    file["parameters"]["POINT"]["LABELS"]["value"] = [*labels[:-1], "TABLE"]
    file.write(str(tmp_path / "mixed.c3d"))
    mixed = asterism.read(tmp_path / "mixed.c3d")
    new = ModelPoint("LKneeAngles", "ANGLES", np.ones((len(walk), 3)))
    write_model_outputs(tmp_path / "out.c3d", mixed, [new], [])
    written = ezc3d.c3d(str(tmp_path / "out.c3d"))["parameters"]["POINT"]["LABELS"]["value"]
    assert written == [*labels[:-1], "TABLE"]


def test_events_and_parameters_replace_those_of_the_same_name(tmp_path: Path) -> None:
    analysis = analysis_of(walk_file(tmp_path / "walk.c3d"))
    write_gait_c3d(tmp_path / "out.c3d", analysis)
    new = ezc3d.c3d(str(tmp_path / "out.c3d"))["parameters"]
    event, found = new["EVENT"], (*analysis.walking.events, *midstances(analysis.walking))
    told = list(zip(event["LABELS"]["value"], event["CONTEXTS"]["value"], event["TIMES"]["value"][1].round(4), strict=True))
    expected = [(one.label, {"L": "Left", "R": "Right"}[one.side], round(one.time, 4)) for one in found]
    # the strikes at 1.0 and 1.7 s are gone; what is no gait event, or outside the frames, is not
    expected = sorted([*expected, ("Event", "General", 1.5), ("Foot Off", "Left", 9.0)], key=lambda one: one[2])
    assert [one[:2] for one in told] == [one[:2] for one in expected]
    np.testing.assert_allclose([one[2] for one in told], [one[2] for one in expected], atol=1e-4)
    assert dict(zip(event["LABELS"]["value"], event["DESCRIPTIONS"]["value"], strict=True))["Event"] == "a door opens"
    icons = dict(zip(event["LABELS"]["value"], event["ICON_IDS"]["value"], strict=True))
    assert icons == {"Foot Strike": 1, "Foot Off": 2, "Event": 0, "Midstance": 0}
    table = new["ANALYSIS"]
    values = dict(zip(zip(table["NAMES"]["value"], table["CONTEXTS"]["value"], strict=True), table["VALUES"]["value"], strict=True))
    assert values["GDI", "Left"] == 91.0 and 90 < values["Cadence", "Left"] < 140
    assert table["NAMES"]["value"].count("Cadence") == 2 and set(table["SUBJECTS"]["value"]) == {"Ann"}
    units = dict(zip(table["NAMES"]["value"], table["UNITS"]["value"], strict=True))
    assert units["Single Support"] == "s" and units["Foot Off"] == "%" and units["Walking Speed"] == "m/s"
    # of one cycle: both feet and this foot alone make up the time that it stands
    stance = values["Foot Off", "Left"] / 100 * values["Stride Time", "Left"]
    assert values["Single Support", "Left"] + values["Double Support", "Left"] == pytest.approx(stance, abs=2e-3)
    told_of = dict(zip(table["NAMES"]["value"], table["DESCRIPTIONS"]["value"], strict=True))
    assert told_of["Cadence"].startswith("+- ") and "cycle" in told_of["Cadence"] and told_of["GDI"] == "by hand"


def test_events_are_at_their_frames_where_a_file_begins_at_another_time(tmp_path: Path) -> None:
    """As a TRC file whose frame 1 is at 20.3 s: a C3D file has no other clock than its frames."""
    walk = simulate_walks(1, frames=300, markers="helen-hayes", seed=3)[0]
    analysis = analyse_gait(replace(walk, events=(), metadata={"first_time": 20.3}))
    write_gait_c3d(tmp_path / "out.c3d", analysis)
    written = asterism.read(tmp_path / "out.c3d")
    expected = sorted(event.time for event in (*analysis.walking.events, *midstances(analysis.walking)))
    np.testing.assert_allclose([event.time - written.times[0] for event in written.events], expected, atol=1e-5)


def test_its_own_output_gives_the_same_file(tmp_path: Path) -> None:
    walk_file(tmp_path / "walk.c3d")
    once, twice = tmp_path / "once", tmp_path / "twice"
    assert main(["gait", str(tmp_path / "walk.c3d"), "--c3d", str(once)]) in (0, 1)
    assert main(["gait", str(once), "--c3d", str(twice)]) in (0, 1)
    assert (once / "walk.c3d").read_bytes() == (twice / "walk.c3d").read_bytes() != (tmp_path / "walk.c3d").read_bytes()


def test_no_input_is_replaced_and_nothing_without_being_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = walk_file(tmp_path / "walk.c3d")
    held = path.read_bytes()
    assert main(["gait", str(path), "--c3d", str(tmp_path), "--overwrite"]) == 2
    assert "input" in capsys.readouterr().err and path.read_bytes() == held
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "walk.c3d").write_bytes(b"mine")
    assert main(["gait", str(path), "--c3d", str(tmp_path / "out")]) != 0
    told = capsys.readouterr().err
    # -o is another output of this command
    assert "another folder with --c3d" in told and "--overwrite" in told and (tmp_path / "out" / "walk.c3d").read_bytes() == b"mine"
    # walk.trc and walk.c3d would have one copy
    asterism.formats.write(tmp_path / "walk.trc", asterism.read(path))
    assert main(["gait", str(path), str(tmp_path / "walk.trc"), "--c3d", str(tmp_path / "new")]) == 2
    assert main(["gait", str(tmp_path / "walk.trc"), "--c3d", str(tmp_path / "new")]) in (0, 1)
    assert "LHipAngles" in ezc3d.c3d(str(tmp_path / "new" / "walk.c3d"))["parameters"]["POINT"]["ANGLES"]["value"]


def test_moments_without_a_mass_are_not_taken_for_those_per_kg(tmp_path: Path) -> None:
    analysis = with_kinetics(analysis_of(walk_file(tmp_path / "walk.c3d")), per_kg=False)
    assert {one.kind for one in model_points(analysis)} == {"ANGLES", "MODELED_MARKERS"}


def test_forces_and_centres_are_in_the_axes_of_the_file(tmp_path: Path) -> None:
    """A walk with y up is the walk with z up, turned."""
    walk = asterism.read(walk_file(tmp_path / "walk.c3d"))
    to_y_up = [1, 2, 0]
    turned = Recording(walk.positions[:, :, to_y_up], walk.labels, walk.rate, vertical=np.array([0.0, 1.0, 0.0]))
    plain, other = (
        {one.name: one.values for one in model_points(with_kinetics(analyse_gait(replace(one, source=None))))} for one in (walk, turned)
    )
    for name in ("LGroundReactionForce", "LHJC", "RAJC"):
        np.testing.assert_allclose(other[name], plain[name][:, to_y_up], atol=1e-9)
    np.testing.assert_allclose(other["LKneeAngles"], plain["LKneeAngles"], atol=1e-9)


def test_outputs_that_a_filled_marker_is_behind_are_flagged(tmp_path: Path) -> None:
    recording = asterism.read(walk_file(tmp_path / "walk.c3d"))
    filled = logged_fills(recording, [GapFill("LTHI", 1.0, 1.1, 0.004)], "test", 0.01)
    write_gait_c3d(tmp_path / "out.c3d", analyse_gait(filled))
    file = asterism.read(tmp_path / "out.c3d").source
    left, right = (file.residuals_of(slice(None))[:, file.labels.index(name)] for name in ("LKneeAngles", "RKneeAngles"))
    # steps of a millimetre
    assert file.scale == 1.0 and (left[100:111] == 4).all() and left.sum() == 44 and not right.any()


def test_integers_become_real_numbers_of_the_same_value(tmp_path: Path) -> None:
    """Steps of a millimetre are too coarse for powers and radians."""
    path = integers(walk_file(tmp_path / "walk.c3d"), tmp_path / "integers.c3d")
    before = asterism.read(path)
    assert before.metadata["encoding"] == "PC integer"
    power = ModelPoint("LKneePower", "POWERS", np.full((300, 3), 0.123))
    write_model_outputs(tmp_path / "out.c3d", before, [power], [])
    after, file = asterism.read(tmp_path / "out.c3d"), ezc3d.c3d(str(tmp_path / "out.c3d"))
    assert after.metadata["encoding"] == "PC real"
    np.testing.assert_allclose(after.positions, before.positions, atol=1e-7)
    np.testing.assert_array_equal(np.isnan(after.positions), np.isnan(before.positions))
    np.testing.assert_allclose(file["data"]["analogs"], ezc3d.c3d(str(path))["data"]["analogs"], atol=1e-6)
    np.testing.assert_allclose(column(file, "LKneePower"), 0.123, rtol=1e-6)


def test_a_vendors_file_gets_the_vendors_names_lists_and_values(data: Path) -> None:
    path = data / "gait-events" / "plates" / "NP1002" / "walk_1002a07.c3d"
    analysis, file = analysis_of(path), ezc3d.c3d(str(path))
    point = file["parameters"]["POINT"]
    for one in model_points(analysis):
        if one.kind == "MODELED_MARKERS":
            continue
        assert one.name in point[one.kind]["value"]
        theirs = column(file, one.name).T
        ours = one.values * {"ANGLES": 180 / np.pi, "MOMENTS": 1000.0}.get(one.kind, 1.0)
        apart = ours - theirs
        scale = np.nanstd(theirs)
        assert np.sqrt(np.nanmean(apart**2)) < 0.1 * scale, one.name
