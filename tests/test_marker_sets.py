"""The shipped marker sets: complete, unambiguous, and right on the files of many laboratories."""

from __future__ import annotations

import numpy as np
import pytest

from asterism.formats import describe, read
from asterism.recording import MarkerSet, canonical, shipped_marker_sets, worn_marker_sets

HELEN_HAYES = ["RASI", "LASI", "SACR", "RTHI", "LTHI", "RKNE", "LKNE", "RTIB", "LTIB", "RANK", "LANK", "RHEE", "LHEE", "RTOE", "LTOE"]


COUNTS = {
    "cast": 32,
    "cleveland-clinic": 41,
    "clouthier": 62,
    "cmu": 41,
    "hamner-running": 42,
    "helen-hayes": 15,
    "helen-hayes-full-body": 25,
    "helen-hayes-medial": 19,
    "ior-gait": 22,
    "landmarks-49": 49,
    "landmarks-73": 73,
    "leuven": 61,
    "opencap-lab": 47,
    "optitrack-baseline": 41,
    "optitrack-baseline-37": 37,
    "optitrack-baseline-fingers": 49,
    "optitrack-baseline-lower": 20,
    "optitrack-biomech": 57,
    "optitrack-core": 50,
    "optitrack-core-fingers": 54,
    "optitrack-rizzoli-lower": 24,
    "oxford-foot": 37,
    "plug-in-gait": 39,
    "plug-in-gait-lower": 16,
    "plug-in-gait-oxford-foot": 59,
    "qtm-animation": 42,
    "qtm-hands": 28,
    "qtm-sports": 41,
    "qualisys-clusters": 64,
    "rizzoli-foot": 30,
    "sprint-51": 51,
    "vicon-35": 35,
    "vicon-53": 53,
}


def test_the_sets_of_the_field_are_shipped_with_their_counts():
    assert {name: len(MarkerSet.load(name)) for name in shipped_marker_sets()} == COUNTS


# fmt: off
MIDDLE = {
    "ARIEL", "BHD", "BackTop", "C7", "CLAV", "CV7", "Chest", "ChestLow", "ChestTop", "Clav", "FHD", "HV",
    "HeadFront", "HeadSide", "HeadTop", "MAN", "OCC", "P1", "P2", "P3", "Pelvis1", "Pelvis2", "Pelvis3", "RBAC",
    "RBAK", "SACR", "SEL", "SJN", "STR", "STRN", "SUP", "SXS", "SpineThoracic12", "SpineThoracic2", "SpineTop",
    "Sternum", "T10", "T12", "T2", "T6", "T7", "TV2", "TV7", "Top.Head", "V.Sacral", "WaistBack", "WaistCBack",
    "r_sh4", "r_thigh5",
    "Front.Head",
    "Rear.Head",
    "R.Offset",
}
# fmt: on
"""Markers of no pair: in the middle of the body, or on one side alone."""


def test_helen_hayes_has_the_order_of_the_thesis():
    assert list(MarkerSet.load("helen-hayes").names) == HELEN_HAYES


@pytest.mark.parametrize("name", COUNTS)
def test_every_side_has_its_mirror_with_mirrored_aliases(name):
    markers = MarkerSet.load(name)
    paired = {marker for pair in markers.pairs for marker in pair}
    middle = set(markers.names) - paired
    assert middle <= MIDDLE
    for left, right in markers.pairs:
        # One letter tells the sides apart: LKNE, WaistLBack, L_knee beside r_knee, HeadLeft.
        swapped = left.casefold().replace("left", "right") if "Left" in left else left.casefold()
        assert right.casefold() in {swapped[:i] + "r" + swapped[i + 1 :] for i, letter in enumerate(swapped) if letter in "lr"}
        assert len(markers.aliases.get(left, ())) == len(markers.aliases.get(right, ()))


@pytest.mark.parametrize("name", COUNTS)
def test_every_marker_lies_on_one_segment(name):
    markers = MarkerSet.load(name)
    on = [marker for members in markers.segments.values() for marker in members]
    assert sorted(on) == sorted(markers.names)


@pytest.mark.parametrize(
    "label, marker",
    [
        ("R.ASIS", "RASI"),
        ("r_asis", "RASI"),
        ("Ann:LASI", "LASI"),
        ("ASISl", "LASI"),
        ("V.Sacral", "SACR"),
        ("s2", "SACR"),
        ("VSAC", "SACR"),
        ("r_l_thigh", "RTHI"),
        ("l_l_thigh", "LTHI"),
        ("R_femoral_wand", "RTHI"),
        ("L_femoral_epicondyle", "LKNE"),
        ("r_calf", "RTIB"),
        ("R_tibial_band", "RTIB"),
        ("L_malleolus", "LANK"),
        ("R.Heel", "RHEE"),
        ("L_meta_h", "LTOE"),
        ("R_meta_h", "RTOE"),
        ("l_toe", "LTOE"),
    ],
)
def test_spellings_of_the_thesis_and_of_other_laboratories(label, marker):
    assert MarkerSet.load("helen-hayes").name_of(label) == marker


@pytest.mark.parametrize("label", ["LHipAngles", "LHJC", "CentreOfMass", "*12", "", "R.Thigh.Upper", "LKNE2", "RSHN", "L_mknee"])
def test_what_is_no_marker_of_the_set_is_none(label):
    assert MarkerSet.load("helen-hayes").name_of(label) is None


def test_no_alias_repeats_a_name_of_its_own_set():
    for name in shipped_marker_sets():
        markers = MarkerSet.load(name)
        names = {canonical(marker) for marker in markers.names}
        assert not [a for aliases in markers.aliases.values() for a in aliases if canonical(a) in names]


@pytest.mark.parametrize(
    "file, markers, expected",
    [
        ("gait/HC002/straight.c3d", "helen-hayes", 15),
        ("gait/HC055/turn.c3d", "oxford-foot", 37),
        ("gait/HC031/static.c3d", "plug-in-gait", 33),
        ("movement/pig39/test_movement.c3d", "plug-in-gait", 39),
        ("movement/cmu41/02_01_walk.c3d", "plug-in-gait", 37),
        ("movement/clinical-lower/auc_dynamic.c3d", "helen-hayes", 15),
        ("movement/clinical-lower/sydney_gait03.c3d", "helen-hayes", 14),
        ("movement/clinical-lower/fmc_dynamic15.c3d", "helen-hayes", 14),
        ("movement/fullbody61/markers.trc", "helen-hayes", 15),
        ("movement/lab51-multiactivity/walking1.trc", "helen-hayes", 10),
        ("conformance/trc/init100.trc", "helen-hayes", 15),
        ("conformance/c3d/sample_03/gait-raw.c3d", "helen-hayes", 15),
        ("conformance/c3d/sample_32/vicon_zerowire.c3d", "plug-in-gait", 39),
    ],
)
def test_sets_find_their_columns_in_real_files(data, file, markers, expected):
    recording = read(data / file, markers=markers)
    names = MarkerSet.load(markers).names
    assert recording.labels == names
    everything = read(data / file)
    named = {MarkerSet.load(markers).name_of(label) for label in everything.labels} - {None}
    assert len(named) == expected
    seen = {name for name, there in zip(names, recording.visible.any(axis=0), strict=True) if there}
    assert seen <= named
    assert len(seen) >= expected - 2


def test_left_and_right_are_not_mixed_up_in_real_files(data):
    """Looking along the way that the pelvis faces (away from the sacrum), left markers lie on the left."""
    for file in (
        "gait/HC002/straight.c3d",
        "movement/clinical-lower/auc_dynamic.c3d",
        "conformance/trc/init100.trc",
        "movement/fullbody61/markers.trc",
    ):
        recording = read(data / file, markers="helen-hayes")
        column = {name: recording.positions[:, i] for i, name in enumerate(recording.labels)}
        ahead = 0.5 * (column["LASI"] + column["RASI"]) - column["SACR"]
        left = np.cross(np.broadcast_to(recording.vertical, ahead.shape), ahead)
        for core in ("ASI", "THI", "KNE", "ANK", "HEE"):
            side = ((column["L" + core] - column["R" + core]) * left).sum(axis=1)
            assert np.nanmedian(side) > 0, f"{file}: {core}"


@pytest.mark.parametrize("name", COUNTS)
def test_a_file_with_a_sets_own_names_wears_this_set(name):
    markers = MarkerSet.load(name)
    best = worn_marker_sets([f"Ann:{marker}" for marker in reversed(markers.names)])[0]
    assert (best.name, best.found, best.missing, best.extra) == (name, markers.names, (), ())


def test_what_is_missing_and_extra_is_told():
    labels = [label for label in HELEN_HAYES if label not in ("LTHI", "RTHI")] + ["C7", "*12", "R.Knee.Medial"]
    [best] = worn_marker_sets(labels)
    assert (best.name, best.missing, best.extra) == ("helen-hayes", ("RTHI", "LTHI"), ("C7", "R.Knee.Medial"))
    assert worn_marker_sets(["LKNE", "RKNE", "*1"]) == () == worn_marker_sets([])


@pytest.mark.parametrize(
    "file, name, missing",
    [
        ("gait/HC002/straight.c3d", "plug-in-gait-oxford-foot", 0),
        ("gait-events/opensim/subject01_walk1.trc", "cleveland-clinic", 0),
        ("movement/pig39/rom_static.c3d", "vicon-35", 0),
        ("conformance/trc/init100.trc", "helen-hayes-full-body", 3),
        ("movement/clouthier62/labelled/KneeltoProne01.c3d", "clouthier", 0),
        ("movement/fullbody61/markers_Squat2.trc", "leuven", 0),
        ("movement/lab51-multiactivity/DJ1.trc", "opencap-lab", 0),
        ("movement/running42/run200.trc", "hamner-running", 0),
        ("movement/sprint53/run0700cms.trc", "sprint-51", 0),
        ("movement/qtm-fullbody/ech_anat_pose.c3d", "landmarks-73", 0),
        ("movement/qtm-fullbody/lem_static.c3d", "landmarks-49", 0),
        ("movement/qtm-fullbody/running_0002.c3d", "qualisys-clusters", 0),
        ("movement/pig39/test_movement.c3d", "plug-in-gait", 0),
        ("movement/cmu41/02_01_walk.c3d", "cmu", 0),
        ("movement/clinical-lower/sydney_gait03.c3d", "plug-in-gait-lower", 0),
        ("movement/clinical-lower/auc_dynamic.c3d", "helen-hayes", 0),
        ("movement/clinical-lower/auc_static.c3d", "helen-hayes-medial", 0),
        ("gait-events/parkinson/SUB01_off_walk_12b.c3d", "ior-gait", 0),
        ("movement/optitrack-lower/rizzoli24/jog_001.c3d", "optitrack-rizzoli-lower", 0),
        ("movement/optitrack-lower/skeleton20/jog_001.c3d", "optitrack-baseline-lower", 0),
        ("conformance/trc/dataWithBlanksForMissingMarkers.trc", "cast", 6),
        ("movement/vicon53/nick_freeform_001.c3d", "vicon-53", 0),
        ("movement/mouse-qtm/MOS1aD_S2_M5_MC2_T2_TRM_5MMIN_E.mat", None, 0),
    ],
)
def test_real_files_wear_the_set_of_their_laboratory(data, file, name, missing):
    worn = describe(data / file)["marker_sets"]
    assert [each["name"] for each in worn[:1]] == [name] * (name is not None)
    assert [len(each["missing"]) for each in worn[:1]] == [missing] * (name is not None)


@pytest.mark.parametrize("name", ["ior-gait", "cast", "plug-in-gait-lower"])
def test_the_sides_of_sets_on_landmarks_are_not_mixed_up_in_real_files(data, name):
    file = {"ior-gait": "gait-events/parkinson/SUB01_off_walk_12b.c3d", "cast": "conformance/trc/dataWithBlanksForMissingMarkers.trc"}
    recording = read(data / file.get(name, "movement/clinical-lower/sydney_gait03.c3d"), markers=name)
    markers, column = MarkerSet.load(name), {label: recording.positions[:, i] for i, label in enumerate(recording.labels)}
    front = [column[label] for label in markers.segments["pelvis"][:2]]
    ahead = sum(front) - sum(column[label] for label in markers.segments["pelvis"][2:])
    left = np.cross(np.broadcast_to(recording.vertical, ahead.shape), ahead)
    for one, other in markers.pairs:
        side = ((column[one] - column[other]) * left).sum(axis=1)
        assert np.isnan(side).all() or np.nanmedian(side) > 0, f"{one} lies right of {other}"


def test_a_set_under_its_own_names_comes_before_one_under_other_names(data):
    worn = describe(data / "gait-events/plates/NP1002/walk_1002a07.c3d")["marker_sets"]
    assert [each["name"] for each in worn] == ["vicon-35", "plug-in-gait", "plug-in-gait-lower", "helen-hayes", "ior-gait"]
