"""The shipped marker sets: complete, unambiguous, and right on the files of many laboratories."""

from __future__ import annotations

import numpy as np
import pytest

from asterism.formats import read
from asterism.recording import MarkerSet, canonical, shipped_marker_sets

HELEN_HAYES = ["RASI", "LASI", "SACR", "RTHI", "LTHI", "RKNE", "LKNE", "RTIB", "LTIB", "RANK", "LANK", "RHEE", "LHEE", "RTOE", "LTOE"]


def test_three_sets_are_shipped_with_their_counts():
    assert {name: len(MarkerSet.load(name)) for name in shipped_marker_sets()} == {"helen-hayes": 15, "oxford-foot": 37, "plug-in-gait": 39}


def test_helen_hayes_has_the_order_of_the_thesis():
    assert list(MarkerSet.load("helen-hayes").names) == HELEN_HAYES


@pytest.mark.parametrize("name", ["helen-hayes", "oxford-foot", "plug-in-gait"])
def test_every_side_has_its_mirror_with_mirrored_aliases(name):
    markers = MarkerSet.load(name)
    paired = {marker for pair in markers.pairs for marker in pair}
    middle = set(markers.names) - paired
    assert middle <= {"SACR", "C7", "T10", "CLAV", "STRN", "RBAK"}
    for left, right in markers.pairs:
        assert left == "L" + right[1:]
        assert len(markers.aliases.get(left, ())) == len(markers.aliases.get(right, ()))


@pytest.mark.parametrize("name", ["helen-hayes", "oxford-foot", "plug-in-gait"])
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
