"""Text formats, MAT and NPZ: what is written comes back; what a file says is understood, however its vendor writes it."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from asterism.errors import AsterismError
from asterism.formats import TimeSeriesTable, convert, describe, read, read_clouds, read_table, write, write_table
from asterism.formats._tables import _timed_rate
from asterism.formats.csv_long import write_long
from asterism.formats.csv_nexus import is_nexus
from asterism.recording import Clouds, Event, Recording, as_vertical

NAMES = ("LASI", "RASI", "LKNE", "RKNE", "LANK", "RANK", "C7", "*1")
TOLERANCE = {"trc": 1e-8, "csv": 1e-9, "tsv": 1e-8, "mat": 1e-12, "npz": 0.0, "sto": 1e-9, "mot": 1e-9}

relaxed = settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


def body(frames: int = 20, rate: float = 100.0, missing: bool = True) -> Recording:
    """Somebody of 1.7 m who stands and sways by 10 mm along x; one marker is missing in frames 3 and 4."""
    heights = np.array([1.0, 1.0, 0.5, 0.5, 0.1, 0.1, 1.5, 1.7])
    sideways = np.array([0.1, -0.1, 0.1, -0.1, 0.1, -0.1, 0.01, 0.02])
    positions = np.zeros((frames, 8, 3))
    positions[:, :, 0] = 0.3 + 0.01 * np.sin(np.arange(frames) / 7.0)[:, None] * heights
    positions[:, :, 1] = sideways
    positions[:, :, 2] = heights
    if missing:
        positions[3:5, 2] = np.nan
    return Recording(positions, NAMES, rate, as_vertical("z"), (Event("Foot Strike", 0.15, "Left"),), {"subject": "Ann"}, first_frame=11)


positions_of_bodies = arrays(np.float64, (5, 8, 3), elements=st.floats(-2.0, 2.0, width=32)).map(
    lambda noise: body(5, missing=False).positions + 0.2 * noise
)


@relaxed
@pytest.mark.parametrize("suffix", sorted(TOLERANCE))
@given(
    positions=positions_of_bodies,
    gone=arrays(np.bool_, (5, 8)),
    rate=st.sampled_from([50.0, 100.0, 119.88012, 240.0, 300.0]),
)
def test_positions_gaps_labels_and_rate_come_back(tmp_path, suffix, positions, gone, rate):
    positions = np.where(gone[:, :, None], np.nan, positions)
    recording = Recording(positions, NAMES, rate)
    path = tmp_path / f"walk.{suffix}"
    write(path, recording)
    back = read(path, vertical="z")
    order = [back.labels.index(name) for name in NAMES]
    np.testing.assert_allclose(back.positions[:, order], recording.positions, rtol=0, atol=TOLERANCE[suffix], equal_nan=True)
    assert back.rate == pytest.approx(rate, rel=1e-5)
    assert len(back.labels) == len(NAMES)


@pytest.mark.parametrize("suffix", ["csv", "tsv", "mat", "npz"])
def test_events_come_back_where_the_format_has_them(tmp_path, suffix):
    path = tmp_path / f"walk.{suffix}"
    write(path, body())
    (event,) = read(path).events
    assert event.time == pytest.approx(0.15, abs=1e-6)
    assert event.label.endswith("Foot Strike")
    if suffix in ("csv", "npz"):
        assert event.context == "Left"


@pytest.mark.parametrize("suffix", ["trc", "sto", "mot"])
def test_events_that_a_format_cannot_hold_are_reported(tmp_path, suffix):
    lost = write(tmp_path / f"walk.{suffix}", body())
    assert any("1 events" in sentence for sentence in lost)


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_nothing_is_lost_in_our_own_formats(tmp_path, suffix):
    path = tmp_path / f"walk.{suffix}"
    assert write(path, body()) == []
    back = read(path)
    np.testing.assert_array_equal(back.vertical, [0, 0, 1])
    assert back.metadata["subject"] == "Ann"
    assert back.first_frame == 11


def test_npz_is_bit_exact_and_plain(tmp_path):
    path = tmp_path / "walk.npz"
    write(path, body())
    np.testing.assert_array_equal(read(path).positions, body().positions)
    with np.load(path, allow_pickle=False) as held:
        assert int(held["asterism"]) == 1


@relaxed
@given(counts=st.lists(st.integers(0, 4), max_size=6), suffix=st.sampled_from(["npz", "csv"]), seed=st.integers(0, 99))
def test_clouds_come_back_bit_for_bit(tmp_path, counts, suffix, seed):
    rng = np.random.default_rng(seed)
    clouds = Clouds.from_points([rng.uniform(-1, 1, (n, 3)) for n in counts], rate=120.0, vertical="y")
    path = tmp_path / f"clouds.{suffix}"
    write(path, clouds)
    back = read_clouds(path)
    np.testing.assert_array_equal(back.xyz, clouds.xyz)
    np.testing.assert_array_equal(back.offsets, clouds.offsets)
    np.testing.assert_array_equal(back.vertical, clouds.vertical)
    assert back.rate == 120.0


def test_clouds_can_be_read_as_a_recording_with_unnamed_columns(tmp_path):
    clouds = Clouds.from_points([[[0, 0, 1], [0, 1, 1]], [[0, 0, 2]]], rate=50.0)
    write(tmp_path / "clouds.npz", clouds)
    recording = read(tmp_path / "clouds.npz")
    assert recording.labels == ("*1", "*2")
    np.testing.assert_array_equal(recording.clouds().xyz, clouds.xyz)


def test_long_csv_comes_back(tmp_path):
    path = tmp_path / "long.csv"
    assert write_long(path, body()) == []
    back = read(path)
    order = [back.labels.index(name) for name in NAMES]
    np.testing.assert_array_equal(back.positions[:, order], body().positions)
    assert back.metadata["format"] == "CSV long"
    assert back.rate == 100.0


def test_a_point_at_the_origin_is_not_taken_for_missing(tmp_path):
    recording = body()
    positions = recording.positions.copy()
    positions[2, 0] = 0.0
    for suffix in TOLERANCE:
        path = tmp_path / f"zero.{suffix}"
        write(path, Recording(positions, NAMES, 100.0))
        back = read(path, vertical="z")
        np.testing.assert_allclose(back.positions[2, back.labels.index("LASI")], 0.0, atol=1.01 * max(TOLERANCE[suffix], 1e-12) + 1e-8)


def test_computed_points_of_the_source_survive_though_they_are_no_markers(tmp_path):
    recording = Recording(np.concatenate([body().positions, body().positions[:, :1] + 0.1], axis=1), (*NAMES, "L_HJC"), 100.0)
    write(tmp_path / "in.trc", recording)
    physical = read(tmp_path / "in.trc")
    assert physical.labels == NAMES
    write(tmp_path / "out.trc", physical)
    write(tmp_path / "out.c3d", physical)
    for name in ("out.trc", "out.c3d"):
        assert "L_HJC" in read(tmp_path / name, markers=["L_HJC"]).labels
        assert "L_HJC" not in read(tmp_path / name).labels


def test_a_relabelled_recording_writes_every_sample_once(tmp_path):
    write(tmp_path / "in.trc", body())
    recording = read(tmp_path / "in.trc", markers=["RKNE", "LKNE"])
    assert recording.labels == ("RKNE", "LKNE")
    write(tmp_path / "out.trc", recording)
    assert sorted(read(tmp_path / "out.trc").labels) == sorted(NAMES)


TRC = """PathFileType\t4\t(X/Y/Z)\twalk.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
100\t100\t3\t2\tmm\t100\t1\t3
Frame#\tTime\tLKNE\t\t\tRKNE\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t100\t500\t200\t-100\t500\t200
2\t0.01\t101\t501\t201\t\t\t
3\t0.02\t102\t502\t202\tNaN\tnan\tNAN
"""
TRUTH = np.array([[[0.1, 0.5, 0.2], [-0.1, 0.5, 0.2]], [[0.101, 0.501, 0.201], [np.nan] * 3], [[0.102, 0.502, 0.202], [np.nan] * 3]])


@pytest.mark.parametrize(
    "text",
    [
        TRC,
        TRC.replace("\n", "\r\n"),
        TRC.replace("\n", "\r"),
        TRC.replace("\t", ","),
        TRC.replace("\t", ";").replace("0.0", "0,0"),
        "\ufeff" + TRC,
        TRC.replace("\n\n", "\n"),
        TRC.replace("3\t2\tmm", "900\t7\tmm"),
        TRC.replace("100\t100\t3\t2\tmm", "  100\t\t  100\t\t   3\t\t  2\t\t mm\t"),
        TRC.replace("LKNE\t\t\tRKNE\t\t", "LKNE\tRKNE"),
        TRC.replace("100\t500\t200\t-100", "1.00E+02\t5e2\t2.0E2\t-1.0e+2"),
        TRC.replace("\t\t\t\n3", "\n3"),
        TRC.replace("\t\t\t\n3", "\t0\t0\t0\n3"),
        TRC.replace("NaN\tnan\tNAN", "-nan(ind)\t NaN \t1.#QNAN"),
        TRC.rstrip("\n"),
    ],
    ids=[
        "plain",
        "crlf",
        "cr",
        "commas",
        "semicolons and decimal commas",
        "byte order mark",
        "no blank line",
        "header counts lie",
        "padded header",
        "names close together",
        "exponents",
        "short row",
        "zeros for missing",
        "other spellings of NaN",
        "no last line end",
    ],
)
def test_trc_in_every_dress(tmp_path, text):
    path = tmp_path / "walk.trc"
    path.write_bytes(text.encode())
    recording = read(path, vertical="y")
    assert recording.labels == ("LKNE", "RKNE")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)
    assert recording.rate == 100.0


def test_utf16_text_is_read(tmp_path):
    (tmp_path / "walk.trc").write_bytes(TRC.encode("utf-16"))
    np.testing.assert_allclose(read(tmp_path / "walk.trc", vertical="y").positions, TRUTH, equal_nan=True)


def test_a_file_cut_within_a_number_does_not_give_a_wrong_number(tmp_path):
    text = TRC.replace("102\t502\t202\tNaN\tnan\tNAN", "102.123\t502.123\t202.123\t1.123\t2.123\t3.123")
    text = text.replace("101\t501\t201\t\t\t", "101.123\t501.123\t201.123\t1.123\t2.123\t3.123").rstrip("\n")
    (tmp_path / "walk.trc").write_text(text[:-3])
    recording = read(tmp_path / "walk.trc", vertical="y")
    assert np.isnan(recording.positions[2, 1]).all()
    assert recording.positions[1, 1, 2] == pytest.approx(0.003123)


def test_the_time_column_is_believed_against_a_stale_rate(tmp_path):
    (tmp_path / "walk.trc").write_text(TRC.replace("\t0.00\t", "\t0.0\t").replace("\t0.01\t", "\t0.005\t").replace("\t0.02\t", "\t0.010\t"))
    recording = read(tmp_path / "walk.trc", vertical="y")
    assert recording.rate == pytest.approx(200.0)
    assert any("frames per second" in finding.sentence for finding in recording.metadata["findings"])


def test_frames_left_out_become_missing_frames(tmp_path):
    (tmp_path / "walk.trc").write_text(TRC.replace("\n3\t0.02", "\n5\t0.04"))
    recording = read(tmp_path / "walk.trc", vertical="y")
    assert len(recording) == 5
    assert np.isnan(recording.positions[2:4]).all()
    np.testing.assert_allclose(recording.positions[4, 0], TRUTH[2, 0])


@pytest.mark.parametrize(
    "said, unit",
    [
        *(
            ("mm", 0.001),
            ("cm", 0.01),
            ("dm", 0.1),
            ("m", 1.0),
            ("um", 1e-6),
            ("Meters", 1.0),
            ("millimetres", 0.001),
            ("centimeter", 0.01),
        ),
        *(("in", 0.0254), ("inches", 0.0254), ("ft", 0.3048), ("Feet", 0.3048), ("yards", 0.9144)),
        *(("\N{MICRO SIGN}m", 1e-6), ("\N{GREEK SMALL LETTER MU}m", 1e-6), ("microns", 1e-6)),
    ],
)
def test_units_become_metres(tmp_path, said, unit):
    recording = body(missing=False)
    write(tmp_path / "mm.trc", recording)
    lines = (tmp_path / "mm.trc").read_text().splitlines()
    lines[2] = lines[2].replace("\tmm\t", f"\t{said}\t")
    head, rows = lines[:6], lines[6:]
    rows = ["\t".join([*row.split("\t")[:2], *(f"{float(c) * 0.001 / unit:.9f}" for c in row.split("\t")[2:])]) for row in rows]
    (tmp_path / "walk.trc").write_text("\n".join(head + rows) + "\n")
    np.testing.assert_allclose(read(tmp_path / "walk.trc").positions, recording.positions, atol=1e-7)


def test_units_that_do_not_fit_a_body_are_refused_with_the_mend(tmp_path):
    write(tmp_path / "walk.trc", body())
    text = (tmp_path / "walk.trc").read_text().replace("\tmm\t", "\tm\t")
    (tmp_path / "walk.trc").write_text(text)
    with pytest.raises(AsterismError, match=r"walk\.trc gives its units as m.*probably mm"):
        read(tmp_path / "walk.trc")


WORN = ("RASI", "LASI", "SACR", "RTHI", "LTHI", "RKNE", "LKNE", "RTIB", "LTIB", "RANK", "LANK", "RHEE", "LHEE", "RTOE", "LTOE")


def declared(path, said, factor, names=WORN):
    """A TRC file of a standing person of 1.7 m, its numbers so many times those in metres, and what the header says of their unit."""
    rng = np.random.default_rng(3)
    positions = rng.uniform([-0.2, -0.3, 0.0], [0.2, 0.3, 1.5], (1, len(names), 3)) + rng.normal(0, 0.005, (30, len(names), 3))
    write(path, Recording(positions * factor, names, 100.0, metadata={"units": "m"}))
    path.write_text(path.read_text().replace("\tm\t", f"\t{said}\t"), encoding="utf-8")


@pytest.mark.parametrize("names", [WORN, tuple(f"*{i}" for i in range(15))], ids=["named", "nameless"])
@pytest.mark.parametrize(
    "said, factor, doubted",
    [("mm", 1000, False), ("cm", 100, False), ("cm", 1000, True), ("m", 10, True), ("dm", 100, True), ("mm", 10000, True)],
)
def test_a_person_of_seventeen_metres_is_doubted(tmp_path, names, said, factor, doubted):
    declared(tmp_path / "walk.trc", said, factor, names)
    for found in (read(tmp_path / "walk.trc", vertical="z").warnings, describe(tmp_path / "walk.trc")["findings"]):
        assert ("format-units-doubtful" in {finding.code for finding in found}) == doubted


def test_a_person_of_seventeen_centimetres_is_doubted_but_no_animal(tmp_path):
    declared(tmp_path / "walk.trc", "cm", 10)
    (doubt,) = read(tmp_path / "walk.trc", vertical="z").warnings
    assert doubt.code == "format-units-doubtful" and "with dm instead of cm" in doubt.sentence
    animal = ("left_hip", "right_hip", "left_knee", "right_knee", "left_ankle", "right_ankle", "tail", "nose")
    declared(tmp_path / "mouse.trc", "cm", 5, animal)
    assert read(tmp_path / "mouse.trc", vertical="z").warnings == ()


def test_two_people_far_apart_are_no_giant(tmp_path):
    one = body(missing=False)
    both = np.concatenate([one.positions, one.positions + np.array([6.0, 0.0, 0.0])], axis=1)
    names = (*(f"Ann:{name}" for name in one.labels), *(f"Ben:{name}" for name in one.labels))
    write(tmp_path / "both.trc", Recording(both, names, 100.0))
    assert "format-units-doubtful" not in {finding.code for finding in read(tmp_path / "both.trc", vertical="z").warnings}


def test_a_unit_that_nobody_knows_is_refused(tmp_path):
    declared(tmp_path / "walk.trc", "furlong", 8)
    with pytest.raises(AsterismError, match=r"walk\.trc: the units 'furlong' are not known.*units field"):
        read(tmp_path / "walk.trc")
    declared(tmp_path / "walk.trc", "furlong", 1000)
    (doubt,) = read(tmp_path / "walk.trc", vertical="z").warnings
    assert doubt.code == "format-units-unknown" and "mm fits the size of the body" in doubt.sentence


def test_units_in_the_wrong_field_are_found(tmp_path):
    write(tmp_path / "walk.trc", body())
    text = (tmp_path / "walk.trc").read_text().replace("20\t8\tmm\t100", "20\tmm\t8\t100")
    (tmp_path / "walk.trc").write_text(text)
    recording = read(tmp_path / "walk.trc")
    np.testing.assert_allclose(recording.positions, body().positions, atol=1e-7, equal_nan=True)
    assert any("another field" in finding.sentence for finding in recording.metadata["findings"])


def test_absent_units_are_told_from_the_body_and_said(tmp_path):
    write(tmp_path / "walk.trc", body())
    text = (tmp_path / "walk.trc").read_text().replace("\tmm\t", "\t\t")
    (tmp_path / "walk.trc").write_text(text)
    recording = read(tmp_path / "walk.trc")
    assert recording.metadata["units"] == "mm"
    assert any("size of the body" in finding.sentence for finding in recording.metadata["findings"])


@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_absent_units_are_told_from_hundreds_of_markers_too(tmp_path, unit):
    """A body of 1.7 m is as large with 300 markers as with eight."""
    positions = np.random.default_rng(0).uniform([-0.25, -0.25, 0.0], [0.25, 0.25, 1.7], (3, 300, 3))
    write(tmp_path / "dense.trc", Recording(positions, tuple(f"M{i}" for i in range(300)), 100.0, metadata={"units": unit}))
    text = (tmp_path / "dense.trc").read_text()
    assert f"\t{unit}\t" in text
    (tmp_path / "dense.trc").write_text(text.replace(f"\t{unit}\t", "\t\t"))
    recording = read(tmp_path / "dense.trc", vertical="z")
    assert recording.metadata["units"] == unit
    np.testing.assert_allclose(recording.positions, positions, atol=1e-7)


WIDE = {
    "underscore": "frame,time,LKNE_x,LKNE_y,LKNE_z,RKNE_x,RKNE_y,RKNE_z",
    "capital suffix": "Frame,Time,LKNE_X,LKNE_Y,LKNE_Z,RKNE_X,RKNE_Y,RKNE_Z",
    "dot": "frame,time,LKNE.x,LKNE.y,LKNE.z,RKNE.x,RKNE.y,RKNE.z",
    "blank": "frame,time,LKNE X,LKNE Y,LKNE Z,RKNE X,RKNE Y,RKNE Z",
    "colon": "frame,time,LKNE:X,LKNE:Y,LKNE:Z,RKNE:X,RKNE:Y,RKNE:Z",
    "axis first": "frame,time,X_LKNE,Y_LKNE,Z_LKNE,X_RKNE,Y_RKNE,Z_RKNE",
    "bare": "frame,time,LKNEX,LKNEY,LKNEZ,RKNEX,RKNEY,RKNEZ",
    "translation": "frame,time,LKNE_tx,LKNE_ty,LKNE_tz,RKNE_tx,RKNE_ty,RKNE_tz",
    "index": "frame,time,LKNE[0],LKNE[1],LKNE[2],RKNE[0],RKNE[1],RKNE[2]",
    "units": "frame,time (s),LKNE_x (m),LKNE_y (m),LKNE_z (m),RKNE_x (m),RKNE_y (m),RKNE_z (m)",
    "units row": "frame,time,LKNE_x,LKNE_y,LKNE_z,RKNE_x,RKNE_y,RKNE_z\n,s,m,m,m,m,m,m",
    "two rows": "frame,time,LKNE,,,RKNE,,\n,,X,Y,Z,X,Y,Z",
    "three rows": ",,LKNE,,,RKNE,,\nframe,time,X,Y,Z,X,Y,Z\n,s,m,m,m,m,m,m",
    "quoted": '"frame","time","LKNE_x","LKNE_y","LKNE_z","RKNE_x","RKNE_y","RKNE_z"',
}


@pytest.mark.parametrize("header", WIDE.values(), ids=WIDE.keys())
def test_wide_csv_in_every_dress(tmp_path, header):
    rows = "7,0.00,0.1,0.5,0.2,-0.1,0.5,0.2\n8,0.01,0.101,0.501,0.201,,,\n9,0.02,0.102,0.502,0.202,NaN,NaN,NaN\n"
    (tmp_path / "walk.csv").write_text(f"{header}\n{rows}")
    recording = read(tmp_path / "walk.csv", vertical="y")
    assert recording.labels == ("LKNE", "RKNE")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)
    assert recording.rate == pytest.approx(100.0)
    assert recording.first_frame == 7


def test_semicolons_with_decimal_commas(tmp_path):
    text = "frame;time;LKNE_x;LKNE_y;LKNE_z\n1;0,00;0,1;0,5;0,2\n2;0,01;0,101;0,501;0,201\n"
    (tmp_path / "walk.csv").write_text(text)
    np.testing.assert_allclose(read(tmp_path / "walk.csv", vertical="y").positions, TRUTH[:2, :1])


def test_a_column_of_text_does_not_stop_a_wide_csv(tmp_path):
    text = "subject,frame,time,LKNE_x,LKNE_y,LKNE_z\nAnn,1,0.00,0.1,0.5,0.2\nAnn,2,0.01,0.101,0.501,0.201\n"
    (tmp_path / "walk.csv").write_text(text)
    np.testing.assert_allclose(read(tmp_path / "walk.csv", vertical="y").positions, TRUTH[:2, :1])


def test_long_csv_with_its_columns_in_another_order_and_millimetres(tmp_path):
    text = "marker,x (mm),y (mm),z (mm),frame\nLKNE,100,500,200,4\nRKNE,-100,500,200,4\nLKNE,101,501,201,5\nLKNE,102,502,202,6\n"
    (tmp_path / "walk.csv").write_text("# rate=100\n" + text)
    recording = read(tmp_path / "walk.csv", vertical="y")
    assert recording.labels == ("LKNE", "RKNE")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)


def test_a_sample_given_twice_names_its_line(tmp_path):
    (tmp_path / "walk.csv").write_text("frame,time,marker,x,y,z\n1,0,LKNE,0,0,1\n1,0,RKNE,0,0,2\n1,0,LKNE,0,0,3\n")
    with pytest.raises(AsterismError, match=r"walk\.csv, line 4: LKNE occurs twice"):
        read(tmp_path / "walk.csv", vertical="z")


QTM = "\n".join(
    [
        "NO_OF_FRAMES\t3",
        "NO_OF_CAMERAS\t8",
        "NO_OF_MARKERS\t2",
        "FREQUENCY\t100",
        "NO_OF_ANALOG\t0",
        "ANALOG_FREQUENCY\t0",
        "DESCRIPTION\t--",
        "TIME_STAMP\t2020-01-01, 10:00:00\t123.4",
        "EVENT\tkick\t2\t0.01",
        "DATA_INCLUDED\t3D",
        "MARKER_NAMES\tLKNE\tRKNE",
        "100\t500\t200\t-100\t500\t200",
        "101\t501\t201\t0.000\t0.000\t0.000",
        "102\t502\t202\t\t\t",
        "",
    ]
)


@pytest.mark.parametrize("timed", [False, True], ids=["bare", "with frame and time"])
def test_qtm_tsv(tmp_path, timed):
    text = QTM
    if timed:
        head, rows = QTM.split("\n100\t500", 1)
        rows = ["100\t500" + rows.split("\n")[0], *rows.split("\n")[1:3]]
        text = "\n".join(
            [
                head,
                "Frame\tTime\tLKNE X\tLKNE Y\tLKNE Z\tRKNE X\tRKNE Y\tRKNE Z",
                *(f"{i + 1}\t{i / 100:.5f}\t{r}" for i, r in enumerate(rows)),
            ]
        )
    (tmp_path / "walk.tsv").write_text(text)
    recording = read(tmp_path / "walk.tsv", vertical="y")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)
    assert recording.events == (Event("kick", 0.01),)
    assert recording.rate == 100.0


def test_the_frame_column_of_a_qtm_export_places_its_rows(tmp_path):
    head, rows = QTM.split("\n100\t500", 1)
    rows = ["100\t500" + rows.split("\n")[0], *rows.split("\n")[1:3]]
    titles = "Frame\tTime\tLKNE X\tLKNE Y\tLKNE Z\tRKNE X\tRKNE Y\tRKNE Z"
    timed = [f"{frame}\t{frame / 100:.5f}\t{row}" for frame, row in zip((5, 6, 9), rows, strict=True)]
    (tmp_path / "framed.tsv").write_text("\n".join([head, titles, *timed]))
    framed = read(tmp_path / "framed.tsv", vertical="y")
    assert (framed.first_frame, len(framed)) == (5, 5)
    assert np.isnan(framed.positions[2:4]).all()
    np.testing.assert_allclose(framed.positions[[0, 1, 4]], TRUTH, equal_nan=True)
    (tmp_path / "bare.tsv").write_text(QTM)
    bare = read(tmp_path / "bare.tsv", vertical="y")
    assert (bare.first_frame, len(bare)) == (1, 3), "its first column is a coordinate, 100 mm and on"


def test_qtm_6d_is_refused(tmp_path):
    (tmp_path / "body.tsv").write_text(QTM.replace("DATA_INCLUDED\t3D", "DATA_INCLUDED\t6D"))
    with pytest.raises(AsterismError, match="6D"):
        read(tmp_path / "body.tsv")


@pytest.mark.parametrize("count", [1, 2], ids=["one marker", "two markers"])
def test_mat_with_few_trajectories(tmp_path, count):
    recording = Recording(body().positions[:, :count], NAMES[:count], 100.0)
    write(tmp_path / "walk.mat", recording)
    back = read(tmp_path / "walk.mat", vertical="z")
    np.testing.assert_allclose(back.positions, recording.positions, atol=1e-12, equal_nan=True)
    assert back.labels == NAMES[:count]


def test_vec3_sto_of_opensim_markers(tmp_path):
    head = "DataType=Vec3\nversion=3\nDataRate=100\nUnits=m\nendheader\ntime\tLKNE\tRKNE\n"
    rows = "0.00\t0.1,0.5,0.2\t-0.1,0.5,0.2\n0.01\t0.101,0.501,0.201\tNaN,NaN,NaN\n"
    (tmp_path / "walk.sto").write_text(head + rows)
    recording = read(tmp_path / "walk.sto", vertical="y")
    assert recording.labels == ("LKNE", "RKNE")
    np.testing.assert_allclose(recording.positions, TRUTH[:2], equal_nan=True)


@pytest.mark.parametrize("chain", [("mot", "sto"), ("mot", "csv"), ("sto", "csv", "mot"), ("csv", "sto")])
def test_tables_survive_any_chain_of_formats(tmp_path, chain):
    rng = np.random.default_rng(3)
    table = TimeSeriesTable(("hip_flexion_r", "knee_angle_r"), rng.normal(0, 40, (7, 2)), np.arange(7) / 60.0, "Coordinates", True)
    table.values[2, 1] = np.nan
    write_table(tmp_path / f"a.{chain[0]}", table)
    for before, after in itertools.pairwise(chain):
        assert convert(tmp_path / f"a.{before}", tmp_path / f"a.{after}") == []
    back = read_table(tmp_path / f"a.{chain[-1]}")
    np.testing.assert_array_equal(back.values, table.values)
    np.testing.assert_array_equal(back.times, table.times)
    assert (back.names, back.in_degrees, back.title) == (table.names, True, "Coordinates")
    assert back.rate == pytest.approx(60.0, rel=1e-5)


@pytest.mark.parametrize("suffix", ["mot", "sto", "csv"])
@pytest.mark.parametrize("units", ["mm", ""])
def test_a_table_keeps_its_unit_of_length_or_that_it_has_none(tmp_path, suffix, units):
    write_table(tmp_path / f"a.{suffix}", TimeSeriesTable(("a", "b"), np.ones((2, 2)), np.arange(2.0), units=units))
    assert read_table(tmp_path / f"a.{suffix}").units == units
    assert ("Units" in (tmp_path / f"a.{suffix}").read_text()) == (units != "")


def test_joint_angles_are_no_markers_and_the_sentence_says_what_they_are(tmp_path):
    write_table(
        tmp_path / "ik.mot",
        TimeSeriesTable(("pelvis_tx", "pelvis_ty", "pelvis_tz", "hip_flexion_r"), np.zeros((3, 4)), np.arange(3.0), "", True),
    )
    with pytest.raises(AsterismError, match=r"ik\.mot holds joint angles.*pelvis_tx"):
        read(tmp_path / "ik.mot")
    assert describe(tmp_path / "ik.mot")["columns"][0] == "pelvis_tx"


@pytest.mark.parametrize("source, target", [("trc", "csv"), ("csv", "trc"), ("npz", "sto"), ("tsv", "npz"), ("mat", "trc")])
def test_recordings_are_converted(tmp_path, source, target):
    write(tmp_path / f"a.{source}", body())
    convert(tmp_path / f"a.{source}", tmp_path / f"b.{target}", vertical="z")
    back = read(tmp_path / f"b.{target}", vertical="z")
    np.testing.assert_allclose(back.positions, body().positions, atol=2e-8, equal_nan=True)


def test_a_wrong_suffix_is_looked_through(tmp_path):
    write(tmp_path / "walk.trc", body())
    (tmp_path / "walk.txt").write_bytes((tmp_path / "walk.trc").read_bytes())
    (tmp_path / "walk.csv").write_bytes((tmp_path / "walk.trc").read_bytes())
    (tmp_path / "walk.c3d").write_bytes((tmp_path / "walk.trc").read_bytes())
    for suffix in ("txt", "csv", "c3d"):
        assert read(tmp_path / f"walk.{suffix}").metadata["format"] == "TRC"


@pytest.mark.parametrize("above", ["", "exported by somebody\n"], ids=["none", "a remark"])
@pytest.mark.parametrize("suffix", ["txt", "csv", "trc"])
def test_a_trc_without_its_first_line_is_known_by_the_second(tmp_path, suffix, above):
    (tmp_path / f"walk.{suffix}").write_text(above + TRC.partition("\n")[2])
    recording = read(tmp_path / f"walk.{suffix}", vertical="y")
    assert recording.metadata["format"] == "TRC"
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)


def test_markers_by_set_give_exactly_its_columns(tmp_path):
    write(tmp_path / "walk.trc", body())
    recording = read(tmp_path / "walk.trc", markers="helen-hayes")
    assert len(recording.labels) == 15
    np.testing.assert_allclose(recording.positions[0, recording.labels.index("RANK")], body().positions[0, 5], atol=1e-8)
    assert np.isnan(recording.positions[:, recording.labels.index("SACR")]).all()


def test_a_set_with_no_marker_in_the_file_is_refused(tmp_path):
    write(tmp_path / "walk.trc", body())
    with pytest.raises(AsterismError, match=r"walk\.trc has no marker of"):
        read(tmp_path / "walk.trc", markers=["nose", "tail"])


def test_a_wanted_marker_that_occurs_twice_is_refused_by_file_and_columns(tmp_path):
    write(tmp_path / "walk.trc", body())
    text = (tmp_path / "walk.trc").read_text().replace("RKNE", "LKNE")
    (tmp_path / "walk.trc").write_text(text)
    with pytest.raises(AsterismError, match=r"walk\.trc: points 3 and 4 are both labelled LKNE"):
        read(tmp_path / "walk.trc", markers="helen-hayes")
    assert read(tmp_path / "walk.trc").labels.count("LKNE") == 2


def test_a_set_s_own_name_goes_before_an_alias_of_it(tmp_path):
    recording = Recording(body().positions[:, :3], ("RLM", "RANK", "LKNE"), 100.0)
    write(tmp_path / "walk.npz", recording)
    found = read(tmp_path / "walk.npz", markers="helen-hayes")
    np.testing.assert_array_equal(found.positions[:, found.labels.index("RANK")], recording.positions[:, 1])


def test_a_common_subject_is_taken_off_the_labels(tmp_path):
    recording = Recording(body().positions, (*(f"Ann:{name}" for name in NAMES[:-1]), "*1"), 100.0)
    write(tmp_path / "walk.npz", recording)
    back = read(tmp_path / "walk.npz")
    assert back.labels == NAMES
    assert back.metadata["subject"] == "Ann"


def test_description_counts_what_is_there(tmp_path):
    write(tmp_path / "walk.csv", body())
    found = describe(tmp_path / "walk.csv")
    assert (found["frames"], found["rate"], found["duration"], found["gaps"]) == (20, 100.0, 0.2, 1)
    assert found["points"] == {"physical": list(NAMES[:-1]), "computed": [], "unnamed": ["*1"]}
    assert found["missing"] == pytest.approx(2 / (20 * 7))
    assert found["vertical"] == [0.0, 0.0, 1.0]
    assert found["events"] == [{"label": "Foot Strike", "context": "Left", "time": 0.15}]
    json.dumps(found)


def test_writing_replaces_a_file_at_once_and_leaves_nothing_else(tmp_path):
    (tmp_path / "walk.csv").write_text("old")
    write(tmp_path / "walk.csv", body())
    assert [entry.name for entry in tmp_path.iterdir()] == ["walk.csv"]
    with pytest.raises(AsterismError, match="cannot be written"):
        write(tmp_path / "nowhere" / "walk.csv", body())


@pytest.mark.parametrize("frames", [0, 1])
@pytest.mark.parametrize("suffix", sorted(TOLERANCE))
def test_no_frames_and_one_frame(tmp_path, suffix, frames):
    recording = body(1, missing=False)
    recording = Recording(recording.positions[:frames], NAMES, 100.0)
    write(tmp_path / f"walk.{suffix}", recording)
    try:
        back = read(tmp_path / f"walk.{suffix}", vertical="z")
    except AsterismError as problem:
        assert suffix in ("sto", "mot")
        assert "frames per second" in str(problem)
    else:
        assert len(back) == frames
        assert sorted(back.labels) == sorted(NAMES)


def test_unknown_suffixes_are_refused(tmp_path):
    with pytest.raises(AsterismError, match="no format has the suffix"):
        write(tmp_path / "walk.fbx", body())
    (tmp_path / "walk.fbx").write_text("; FBX 7.4.0 project file\n")
    with pytest.raises(AsterismError, match=r"walk\.fbx.*C3D, TRC"):
        read(tmp_path / "walk.fbx")


def test_paths_may_be_text(tmp_path):
    path: str = str(Path(tmp_path) / "walk.npz")
    write(path, body())
    assert read(path).metadata["file"] == path


def test_long_csv_is_written_by_its_double_suffix(tmp_path):
    write(tmp_path / "walk.long.csv", body())
    assert read(tmp_path / "walk.long.csv").metadata["format"] == "CSV long"


def test_a_wide_csv_of_one_marker_converts_as_a_recording(tmp_path):
    recording = Recording(body().positions[:, :1], NAMES[:1], 100.0)
    write(tmp_path / "one.csv", recording)
    convert(tmp_path / "one.csv", tmp_path / "one.npz")
    np.testing.assert_allclose(read(tmp_path / "one.npz").positions, recording.positions, atol=1e-9)


@pytest.mark.parametrize(("jitter", "even"), [(0.0, True), (0.0001, True), (0.0005, False)])
def test_times_that_jitter_by_less_than_two_percent_of_a_frame_are_evenly_spaced(jitter, even):
    """100 frames a second, printed to a microsecond; every other frame is late."""
    times = np.round(np.arange(21) / 100 + 0.000001 * (np.arange(21) % 3 == 1), 6) + jitter * (np.arange(21) % 2)
    rate, agrees = _timed_rate(times, 100.0)
    assert (rate is not None, agrees) == (even, even)
    assert rate is None or rate == pytest.approx(100.0, rel=0.001)
    assert not _timed_rate(times, 101.0)[1]


@pytest.mark.parametrize("rate", [59.94, 60.0, 100.0, 119.88012, 240.0, 1000.0])
@pytest.mark.parametrize("digits", [2, 3, 6])
def test_rounded_times_do_not_bend_the_rate(tmp_path, rate, digits):
    recording = body(12)
    write(tmp_path / "walk.trc", Recording(recording.positions, NAMES, rate, metadata={"units": "mm"}))
    lines = (tmp_path / "walk.trc").read_text().splitlines()
    rows = [line.split("\t") for line in lines[6:]]
    rows = ["\t".join([row[0], f"{float(row[1]):.{digits}f}", *row[2:]]) for row in rows]
    (tmp_path / "walk.trc").write_text("\n".join([*lines[:6], *rows]) + "\n")
    assert read(tmp_path / "walk.trc").rate == pytest.approx(rate, rel=1e-6)


names_of_people = st.text("abxyzLR0123456789_.-* +ä", min_size=1, max_size=12).map(str.strip).filter(lambda name: name.strip("*_.- +"))
labels_of_people = st.lists(names_of_people, min_size=1, max_size=5)


@relaxed
@pytest.mark.parametrize("suffix", ["trc", "csv", "tsv", "mat", "npz"])
@given(labels=st.one_of(labels_of_people, st.just(["force", "LKNE_", "pelvis", "x", "y_x", "F_1_v"])))
def test_labels_come_back_whatever_they_are(tmp_path, suffix, labels):
    labels = [f"M{i}{label}" if labels.count(label) > 1 or label.startswith("*") else label for i, label in enumerate(labels)]
    positions = np.arange(1.0, 1.0 + 2 * len(labels) * 3).reshape(2, len(labels), 3) / 100.0
    write(tmp_path / f"a.{suffix}", Recording(positions, tuple(labels), 100.0))
    found = describe(tmp_path / f"a.{suffix}")["points"]
    assert sorted(found["physical"] + found["computed"] + found["unnamed"]) == sorted(labels)


NEXUS = """Devices
1000
,,Force plate - Force,,
Frame,Sub Frame,Fx,Fy,Fz
,,N,N,N
1,0,1,2,3

Events
100
Subject,Context,Name,Time (s),Description
Ann,Left,Foot Strike,0.02,the heel touches

Trajectories
100
,,Ann:LKNE,,,Ann:RKNE,,
Frame,Sub Frame,X,Y,Z,X,Y,Z
,,mm,mm,mm,mm,mm,mm
7,0,100,500,200,-100,500,200
8,0,101,501,201,,,
9,0,102,502,202,,,
"""


def test_nexus_sections_in_any_order_with_events(tmp_path):
    (tmp_path / "walk.csv").write_text(NEXUS.replace("\n", "\r\n"), newline="")
    recording = read(tmp_path / "walk.csv", vertical="y")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)
    assert recording.labels == ("LKNE", "RKNE")
    assert (recording.metadata["subject"], recording.first_frame) == ("Ann", 7)
    assert recording.events == (Event("Foot Strike", 0.02, "Left"),)
    assert tuple(read(tmp_path / "walk.csv").vertical) == (0, 0, 1)


def test_nexus_events_may_come_first_and_without_a_rate(tmp_path):
    devices, events, trajectories = NEXUS.split("\n\n")
    (tmp_path / "walk.csv").write_text("\n\n".join([events.replace("Events\n100\n", "Events\n"), devices, trajectories]))
    recording = read(tmp_path / "walk.csv")
    assert recording.labels == ("LKNE", "RKNE") and [event.label for event in recording.events] == ["Foot Strike"]


@pytest.mark.parametrize("section", ["Joints", "Devices"])
def test_a_section_without_a_rate_makes_no_nexus_file(section):
    assert not is_nexus([section, "name,x,y,z"])
    assert is_nexus([section, "100"])


def test_motive_3_with_bones_and_millimetres(tmp_path):
    text = """Format Version,1.25,Take Name,walk,Export Frame Rate,100.000000,Total Exported Frames,3,Length Units,Millimeters

,Type,Bone,Bone,Bone,Bone,Bone,Bone,Bone,Marker,Marker,Marker,Marker,Marker,Marker
,Name,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:Hip,Ann:LKNE,Ann:LKNE,Ann:LKNE,Ann:RKNE,Ann:RKNE,Ann:RKNE
,ID,1,1,1,1,1,1,1,2,2,2,3,3,3
,Parent,0,0,0,0,0,0,0,1,1,1,1,1,1
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Position,Position,Position,Position,Position,Position
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z,X,Y,Z
0,0.00,0,0,0,1,0,900,0,100,500,200,-100,500,200
1,0.01,0,0,0,1,0,900,0,101,501,201,,,
2,0.02,0,0,0,1,0,900,0,102,502,202,,,
"""
    (tmp_path / "walk.csv").write_text(text)
    recording = read(tmp_path / "walk.csv")
    np.testing.assert_allclose(recording.positions, TRUTH, equal_nan=True)
    assert recording.labels == ("LKNE", "RKNE")
    assert tuple(recording.vertical) == (0, 1, 0)
    assert describe(tmp_path / "walk.csv")["points"]["computed"] == ["Hip"]


def test_clouds_and_tables_are_described(tmp_path):
    write(tmp_path / "clouds.npz", body().clouds())
    found = describe(tmp_path / "clouds.npz")
    assert (found["format"], found["frames"], found["points_per_frame"]["most"]) == ("NPZ clouds", 20, 8)
    write_table(tmp_path / "one.sto", TimeSeriesTable(("a",), np.zeros((1, 1)), np.zeros(1)))
    assert json.loads(json.dumps(describe(tmp_path / "one.sto"), allow_nan=False))["rate"] is None


def test_a_sample_without_one_coordinate_is_missing_and_an_infinite_one_refused() -> None:
    places = np.zeros((3, 2, 3))
    places[1, 1, 2] = np.nan
    recording = Recording(places, ("a", "b"), 100.0)
    assert np.isnan(recording.positions).sum() == 3 and np.isnan(recording.positions[1, 1]).all()
    assert np.isnan(places).sum() == 1, "what was given stays as it was"
    places[2, 0, 1] = -np.inf
    with pytest.raises(AsterismError, match=r"frame 2: a coordinate is infinite"):
        Recording(places, ("a", "b"), 100.0)
