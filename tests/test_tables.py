"""Tables as people have them: other separators and decimal signs, points without names, damaged rows: read right, or said, never wrong."""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

import numpy as np
import pytest

from asterism.errors import AsterismError, NoMarkers
from asterism.formats import describe, read, write
from asterism.formats._tables import decimal_points, separator_of
from asterism.recording import Event, Labelling, Recording, as_vertical

NAMES = ("LASI", "RASI", "LKNE", "RKNE", "LANK", "RANK", "C7", "SACR")


def body(frames: int = 24, missing: bool = True) -> Recording:
    """Somebody of 1.7 m who sways by 30 mm along x, each marker a little otherwise; one marker is missing in frames 3 and 4."""
    heights = np.array([1.0, 1.0, 0.5, 0.5, 0.1, 0.1, 1.5, 1.1])
    positions = np.zeros((frames, 8, 3))
    sway = 0.03 * np.sin(np.arange(frames)[:, None] / 7.0 + np.arange(8))
    positions[:, :, 0] = 1.3 + sway
    positions[:, :, 1] = np.array([0.1, -0.1, 0.1, -0.1, 0.1, -0.1, 0.01, 0.02])
    positions[:, :, 2] = heights
    if missing:
        positions[3:5, 2] = np.nan
    return Recording(positions.round(5), NAMES, 100.0, as_vertical("z"), (Event("Foot Strike", 0.15, "Left"),), {"units": "mm"})


def text_of(tmp_path: Path, suffix: str, recording: Recording | None = None) -> str:
    write(tmp_path / f"plain{suffix}", body() if recording is None else recording)
    return (tmp_path / f"plain{suffix}").read_text()


def codes(recording: Recording) -> set[str]:
    return {finding.code for finding in recording.metadata.get("findings", ())}


def with_commas(text: str) -> str:
    return re.sub(r"(?<=\d)\.(?=\d)", ",", text)


def quoted(text: str) -> str:
    return "\n".join(
        line if line.startswith("#") else ",".join(f'"{with_commas(cell)}"' for cell in line.split(","))
        for line in text.split("\n")
        if line
    )


MOTIVE = """Format Version,1.24,Take Name,T1,Export Frame Rate,100.000000,Total Exported Frames,24,Length Units,Meters

,Type{types}
,Name{names}
,ID{ids}
,,{what}
Frame,Time (Seconds),{axes}
{rows}
"""


def motive(recording: Recording) -> str:
    """The recording as Motive exports it, Y up."""
    thrice = "".join(f",Ann:{name}" * 3 for name in recording.labels)
    turned = recording.positions[:, :, [1, 2, 0]].reshape(len(recording), -1)
    rows = [
        f"{t},{t / 100:.6f}," + ",".join("" if np.isnan(value) else f"{value:.6f}" for value in row)
        for t, row in enumerate(turned.tolist())
    ]
    count = len(recording.labels)
    return MOTIVE.format(
        types=",Marker" * 3 * count,
        names=thrice,
        ids=",00" * 3 * count,
        what=",".join(["Position"] * 3 * count),
        axes=",".join("XYZ" * count),
        rows="\n".join(rows),
    )


def optitrack(recording: Recording, version: str, hand: str = "righthanded") -> str:
    """The recording as the programs before Motive 1.8 export it: Y up, one rigid body, points without a name behind the markers."""
    lines = [
        'comment,"OptiTrack Export Data"',
        f"info,version,{version}",
        f"info,framecount,{len(recording)}",
        "info,rigidbodycount,1",
        hand,
    ]
    sign = -1 if hand == "lefthanded" else 1
    for t, places in enumerate(recording.positions[:, :, [1, 2, 0]].tolist()):
        cells = []
        for k, (x, y, z) in enumerate(places):
            if x == x:
                cells += [f"{x:.5f},{y:.5f},{sign * z:.5f},{k}" + (f',"{recording.labels[k]}"' if version == "1.1" else "")]
        cells += ["0.1,0.2,0.3,99" + ("," if version == "1.1" else "")] * (t % 2)
        lines.append(f"frame,{t},{t / 100:.6f},1,1,0.1,0.2,0.3,0,0,0,1,0,0,0,{len(cells)}," + ",".join(cells))
        lines.append(f'rigidbody,{t},{t / 100:.6f},"Body",1,0,0')
    return "\n".join(lines) + "\n"


NEXUS = """Events
100
Subject;Context;Name;Time (s);Description
Ann;Left;Foot Strike;0,1;x
Ann;Right;Foot Off;0,2;x
Ann;Right;Foot Strike;soon;x

Trajectories
100
;;Ann:LKNE;;;Ann:RKNE;;
Frame;Sub Frame;X;Y;Z;X;Y;Z
;;mm;mm;mm;mm;mm;mm
7;0;100,5;500;200,25;-100,5;500;200
8;0;101,5;501;201,25;;;

Unlabeled Trajectories
100
;;1936;;
Frame;Sub Frame;X;Y;Z
;;mm;mm;mm
8;0;300,5;900;100,5
"""


@pytest.mark.parametrize("mark", ["", "\ufeff"], ids=["", "byte order mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("suffix", [".trc", ".tsv", ".mot", ".sto"])
def test_beside_tabs_a_comma_is_the_decimal_sign(tmp_path, suffix, end, mark):
    (tmp_path / f"walk{suffix}").write_text(mark + with_commas(text_of(tmp_path, suffix)).replace("\n", end), "utf-8", newline="")
    plain, back = read(tmp_path / f"plain{suffix}", vertical="z"), read(tmp_path / f"walk{suffix}", vertical="z")
    np.testing.assert_array_equal(back.positions, plain.positions)
    assert (back.labels, back.rate, back.events, back.first_frame) == (plain.labels, plain.rate, plain.events, plain.first_frame)
    assert codes(back) == codes(plain)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_csv_with_decimal_commas_quoted_or_between_semicolons(tmp_path, encoding):
    text = text_of(tmp_path, ".csv")
    plain = read(tmp_path / "plain.csv")
    (tmp_path / "quoted.csv").write_text(quoted(text), encoding)
    (tmp_path / "semicolons.csv").write_text(with_commas(re.sub(r"(?m)^(?!#).*", lambda line: line[0].replace(",", ";"), text)), encoding)
    for name in ("quoted.csv", "semicolons.csv"):
        back = read(tmp_path / name, vertical="z")
        np.testing.assert_allclose(back.positions, plain.positions)
        assert (back.labels, back.rate) == (plain.labels, plain.rate)


@pytest.mark.parametrize("delimiter", [";", "\t"])
@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_motive_export_that_a_german_spreadsheet_saved_again(tmp_path, delimiter, encoding):
    text = motive(body())
    (tmp_path / "motive.csv").write_text(text)
    again = with_commas(text.replace(",", delimiter)).replace("1,24", "1.24")
    # A spreadsheet fills each row to the width of the widest.
    again = "\r\n".join(line + delimiter * 3 for line in again.split("\n"))
    (tmp_path / "again.csv").write_text(again, encoding, newline="")
    plain, back = read(tmp_path / "motive.csv"), read(tmp_path / "again.csv")
    np.testing.assert_allclose(plain.positions, body().positions[:, :, [1, 2, 0]], atol=1e-12)
    np.testing.assert_array_equal(back.positions, plain.positions)
    assert (back.labels, back.rate, codes(back)) == (NAMES, 100.0, codes(plain))


def test_a_motive_export_with_timecodes_poses_and_errors(tmp_path):
    path = tmp_path / "take.csv"
    path.write_text(
        "Format Version,1.24,Take Name,T1,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Length Units,Centimeters\n\n"
        ",Type,,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Marker,Marker,Marker\n"
        ",Name,,Box,Box,Box,Box,Box,Box,Box,Box,Box:Marker 001,Box:Marker 001,Box:Marker 001\n"
        ",ID,,1,1,1,1,1,1,1,1,2,2,2\n"
        ",,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,Position,Position,Position\n"
        "Frame,Time (Seconds),TimeCode,X,Y,Z,W,X,Y,Z,,X,Y,Z\n"
        + "".join(f"{t},{t / 100:.6f},15:26:46:{t:02}.02,0,0,0,1,10,20,30,0.1,{90 + t},100,130\n" for t in range(4))
    )
    back = read(path)
    assert back.labels == ("Box:Marker 001",), "its own name says nothing without the body"
    np.testing.assert_allclose(back.positions[:, 0], [[0.9 + t / 100, 1.0, 1.3] for t in range(4)])


@pytest.mark.parametrize(
    "text", [motive(body()).replace(",", ";"), NEXUS, optitrack(body(), "1.1").replace(",", ";")], ids=["Motive", "Nexus", "OptiTrack"]
)
def test_the_line_by_which_a_spreadsheet_reads_is_passed_over(tmp_path, text):
    (tmp_path / "plain.csv").write_text(text)
    (tmp_path / "walk.csv").write_text("sep=;\n" + text)
    plain, back = read(tmp_path / "plain.csv", vertical="z"), read(tmp_path / "walk.csv", vertical="z")
    np.testing.assert_array_equal(back.positions, plain.positions)
    assert (back.labels, back.events, back.metadata["format"]) == (plain.labels, plain.events, plain.metadata["format"])


def test_events_and_points_without_labels_of_a_german_nexus_export(tmp_path):
    (tmp_path / "walk.csv").write_text(NEXUS)
    back = read(tmp_path / "walk.csv")
    assert back.events == (Event("Foot Strike", 0.1, "Left"), Event("Foot Off", 0.2, "Right"))
    assert "format-events-unread" in codes(back), "the third event has no time"
    assert (back.labels, back.first_frame) == (("LKNE", "RKNE", "*1"), 7)
    expected = [
        [[0.1005, 0.5, 0.20025], [-0.1005, 0.5, 0.2], [np.nan] * 3],
        [[0.1015, 0.501, 0.20125], [np.nan] * 3, [0.3005, 0.9, 0.1005]],
    ]
    np.testing.assert_allclose(back.positions, expected)


def test_exports_that_a_spreadsheet_saved_with_semicolons_keep_their_events(tmp_path):
    for suffix, between in ((".csv", ","), (".tsv", "\t")):
        text = text_of(tmp_path, suffix)
        (tmp_path / "walk.csv").write_text(with_commas(text.replace(between, ";")))
        plain, back = read(tmp_path / f"plain{suffix}"), read(tmp_path / "walk.csv", vertical="z")
        np.testing.assert_allclose(back.positions, plain.positions)
        assert (back.labels, back.rate, back.events) == (plain.labels, plain.rate, plain.events)


def test_long_csv_with_decimal_commas(tmp_path):
    rows = "\n".join(f"{t}\tLKNE\t0,{t}5\t1,25\t-0,5" for t in range(3))
    (tmp_path / "walk.csv").write_text("# rate=100\n# units=m\nframe\tmarker\tx\ty\tz\n" + rows)
    np.testing.assert_allclose(read(tmp_path / "walk.csv", vertical="z").positions[:, 0, 0], [0.05, 0.15, 0.25])


def test_the_decimal_sign_is_told_by_the_numbers(tmp_path):
    def spelled(line: str, delimiter: str | None = "\t") -> str:
        turn = decimal_points(tmp_path, [line], delimiter)
        return line if turn is None else turn(line)

    assert spelled("1,5\t-0,25") == "1.5\t-0.25"
    assert spelled("1.234,5\t2.000") == "1234.5\t2000"
    assert spelled("1,234.5\t2,000\t7.25") == "1234.5\t2000\t7.25"
    assert spelled("1,234,567\t2,000") == "1234567\t2000"
    assert spelled("0,123\t2,000") == "0.123\t2.000"
    assert spelled("1234,567\t2,000") == "1234.567\t2.000"
    assert spelled('"1,5","2,25"', ",") == '"1.5"."2.25"', "only cells are turned, which were split before"
    assert spelled("1,5", ",") == "1,5"
    for doubtful in ("1,234\t987", "1,5\t2.5", "1,234\t12.5"):
        with pytest.raises(AsterismError, match="decimal sign"):
            spelled(doubtful)


@pytest.mark.parametrize(
    ("line", "header", "separator"),
    [("1\t2", "\t", "\t"), ("1 0,5 2,5", "\t", None), ("1 0.5", "\t", None), ("1;2", None, ";"), ("1, 2", None, ","), ("1,2", "\t", ",")],
)
def test_data_lines_may_be_separated_otherwise_than_their_header(line, header, separator):
    assert separator_of(line, header) == separator


def trc(tmp_path: Path) -> tuple[list[str], list[str]]:
    """Header and body of a TRC file without missing samples."""
    lines = text_of(tmp_path, ".trc", body(missing=False)).strip("\n").split("\n")
    return lines[:6], lines[6:]


def saved(tmp_path: Path, header: list[str], rows: list[str]) -> Path:
    path = tmp_path / "walk.trc"
    path.write_text("\n".join([*header, *rows]) + "\n")
    return path


@pytest.mark.parametrize("said", ["8", "0", "11"])
@pytest.mark.parametrize("between", ["\t", " "])
@pytest.mark.parametrize("varying", [False, True])
def test_points_without_a_name_behind_the_named_ones(tmp_path, said, between, varying):
    header, rows = trc(tmp_path)
    header[2] = header[2].replace("\t8\tmm", f"\t{said}\tmm")
    counts = [(t * 2) % 4 if varying else 3 for t in range(len(rows))]
    rows = [row + "".join(f"\t{100 * k + t + 0.5}\t800.25\t{90 + k}" for k in range(counts[t])) for t, row in enumerate(rows)]
    back = read(saved(tmp_path, header, [row.replace("\t", between) for row in rows]), vertical="z")
    np.testing.assert_allclose(back.positions[:, :8], body(missing=False).positions, atol=1e-12)
    unnamed = max(counts)
    assert back.labels == (*NAMES, *(f"*{k + 1}" for k in range(unnamed)))
    for t, count in enumerate(counts):
        np.testing.assert_allclose(back.positions[t, 8 : 8 + count, 0], [(100 * k + t + 0.5) / 1000 for k in range(count)])
        assert np.isnan(back.positions[t, 8 + count :]).all()
    assert "format-point-names" in codes(back)
    assert "format-moved-cells" not in codes(back)


def test_a_file_of_points_without_any_name(tmp_path):
    header, rows = trc(tmp_path)
    header[2] = header[2].replace("\t8\tmm", "\t0\tmm")
    rows = [row if t % 2 else row.rsplit("\t", 6)[0] for t, row in enumerate(rows)]
    back = read(saved(tmp_path, [*header[:3], "Frame#\tTime", ""], rows), vertical="z")
    assert back.labels == tuple(f"*{k}" for k in range(1, 9))
    assert back.clouds().counts.tolist() == [8 if t % 2 else 6 for t in range(24)]
    np.testing.assert_allclose(back.positions[1::2], body(missing=False).positions[1::2], atol=1e-12)


DRESSES = {
    "body in blanks": lambda header, rows: (header, [row.replace("\t", " ") for row in rows]),
    "body in columns of blanks": lambda header, rows: (header, [" ".join(f"{c:>12}" for c in row.split("\t")) for row in rows]),
    "body in commas": lambda header, rows: (header, [row.replace("\t", ",") for row in rows]),
    "header in blanks": lambda header, rows: ([re.sub(r"\t+", " ", line) for line in header], rows),
    "all in blanks": lambda header, rows: ([re.sub(r"\t+", " ", line) for line in header], [row.replace("\t", " ") for row in rows]),
    "named second row": lambda header, rows: (
        [*header[:4], "\t\t" + "\t".join(f"{name}_{axis}" for name in NAMES for axis in "XYZ"), ""],
        rows,
    ),
    "only a row of names and axes": lambda header, rows: (
        [*header[:3], "Frame#\tTime\t" + "\t".join(f"{name}_{axis}" for name in NAMES for axis in "XYZ")],
        rows,
    ),
    "each name thrice": lambda header, rows: (
        [*header[:3], "Frame#\tTime\t" + "\t".join(name for name in NAMES for axis in "XYZ"), *header[4:]],
        rows,
    ),
    "a row of units": lambda header, rows: ([*header[:5], "\ts" + "\tmm" * 24], rows),
    "trailing tabs": lambda header, rows: ([line + "\t\t" for line in header], [row + "\t\t" for row in rows]),
    "a tab too many in the names": lambda header, rows: ([*header[:3], header[3].replace("LKNE", "\tLKNE"), *header[4:]], rows),
    "names between blanks behind tabs": lambda header, rows: ([*header[:3], "Frame#\tTime\t" + " ".join(NAMES), *header[4:]], rows),
    "Frame# and Time in one cell": lambda header, rows: (
        [*header[:3], header[3].replace("Frame#\tTime", "Frame# Time"), *header[4:]],
        rows,
    ),
    "two names in a cell": lambda header, rows: ([*header[:3], header[3].replace("C7\t\t\tSACR", "C7        SACR"), *header[4:]], rows),
    "a second row of names": lambda header, rows: ([*header[:4], "\t\t" + "\t\t\t".join(NAMES), *header[4:]], rows),
    "coordinates in the order X, Z, Y": lambda header, rows: (
        [*header[:4], re.sub(r"(Y\d)\t(Z\d)", r"\2\t\1", header[4]), ""],
        [
            "\t".join([*cells[:2], *(cells[i + k] for i in range(2, 26, 3) for k in (0, 2, 1))])
            for cells in (row.split("\t") for row in rows)
        ],
    ),
    "twice as many tabs between the names": lambda header, rows: ([*header[:3], header[3].replace("\t\t\t", "\t" * 6), *header[4:]], rows),
    "no row of axes": lambda header, rows: (header[:4], rows),
}


@pytest.mark.parametrize("dress", DRESSES)
def test_trc_headers_that_programs_write(tmp_path, dress):
    back = read(saved(tmp_path, *DRESSES[dress](*trc(tmp_path))), vertical="z")
    assert back.labels == NAMES
    np.testing.assert_allclose(back.positions, body(missing=False).positions, atol=1e-12)
    assert not codes(back), [finding.sentence for finding in back.metadata["findings"]]


def test_names_with_blanks_between_blanks(tmp_path):
    header, rows = trc(tmp_path)
    sides = [f"{side} {place}" for place in ("ASI", "KNE", "ANK", "HEE") for side in "RL"]
    for between in (" ", "   "):
        back = read(saved(tmp_path, [*header[:3], "Frame# Time " + between.join(sides)], rows), vertical="z")
        assert back.labels == tuple(sides)
        assert "format-point-names" in codes(back)
    # Words that do not show where a name begins are not shared out by luck.
    doubtful = "R ASI Head L ASI C7 Left Knee Right Knee SACR T10 X Y"
    with pytest.raises(AsterismError, match=r"14 words for 8 markers.*separate the names with tabs"):
        read(saved(tmp_path, [*header[:3], f"Frame# Time {doubtful}"], rows), vertical="z")


def test_a_trc_without_a_column_of_times_is_refused(tmp_path):
    header, rows = trc(tmp_path)
    header[3] = header[3].replace("\tTime", "")
    with pytest.raises(AsterismError, match="'LASI' stands where the column Time belongs"):
        read(saved(tmp_path, header, [re.sub(r"\t[\d.]+", "", row, count=1) for row in rows]))


def test_names_that_stand_over_no_column_are_refused_where_points_have_none(tmp_path):
    header, rows = trc(tmp_path)
    header[2] = header[2].replace("\t8\tmm", "\t0\tmm")
    header[3] = header[3].replace("LKNE", "").replace("LANK", "\tLANK")
    with pytest.raises(AsterismError, match="7 names and 8 points"):
        read(saved(tmp_path, header, rows), vertical="z")


@pytest.mark.parametrize("suffix", [".trc", ".tsv", ".csv"])
def test_a_lost_or_doubled_separator_costs_its_frame_and_is_said(tmp_path, suffix):
    text = text_of(tmp_path, suffix)
    between = "," if suffix == ".csv" else "\t"
    plain = read(tmp_path / f"plain{suffix}", vertical="z")
    lines = text.split("\n")
    at = len(lines) - 12
    cells = lines[at].split(between)
    # The last point is missing in every row, so that a cell too many leaves no number behind the last column.
    doubled = [between.join([*line.split(between)[:-3], "", "", ""]) if re.match(r"\d+\W0", line) else line for line in lines]
    for damaged in (
        [*lines[:at], between.join([*cells[:6], *cells[7:]]), *lines[at + 1 :]],
        [*doubled[:at], between.join([*cells[:6], "", *cells[6:-3], "", "", ""]), *doubled[at + 1 :]],
    ):
        (tmp_path / f"walk{suffix}").write_text("\n".join(damaged))
        back = read(tmp_path / f"walk{suffix}", vertical="z")
        row = 24 - 11
        assert np.isnan(back.positions[row]).all()
        assert "format-moved-cells" in codes(back)
        seen = np.isfinite(back.positions)
        np.testing.assert_array_equal(back.positions[seen], plain.positions[seen])


@pytest.mark.parametrize("suffix", [".sto", ".csv"])
def test_lines_left_out_are_told_by_the_times(tmp_path, suffix):
    text = text_of(tmp_path, suffix, body(missing=False))
    # The CSV loses its column of frames, the other has none.
    if suffix == ".csv":
        text = "\n".join(line if line.startswith("#") else line.partition(",")[2] for line in text.split("\n"))
    lines = text.replace("DataRate=100\n", "").replace("# rate=100.0\n", "").strip("\n").split("\n")
    (tmp_path / f"walk{suffix}").write_text("\n".join([*lines[:-9], *lines[-7:]]) + "\n")
    back = read(tmp_path / f"walk{suffix}", vertical="z")
    assert (back.rate, len(back)) == (100.0, 24)
    assert np.isnan(back.positions[15:17]).all() and "format-frame-numbers" in codes(back)
    np.testing.assert_allclose(np.delete(back.positions, [15, 16], axis=0), np.delete(body(missing=False).positions, [15, 16], axis=0))


def test_a_lost_separator_in_a_file_with_confidence_costs_its_frame(tmp_path):
    recording = body(missing=False)
    indices = np.tile(np.arange(8), (24, 1))
    labelling = Labelling(indices, np.full((24, 8), 0.75), NAMES)
    write(tmp_path / "plain.csv", recording, labelling=labelling)
    lines = (tmp_path / "plain.csv").read_text().split("\n")
    at = len(lines) - 12
    cells = lines[at].split(",")
    lines[at] = ",".join([*cells[:6], *cells[7:]])
    (tmp_path / "walk.csv").write_text("\n".join(lines))
    back = read(tmp_path / "walk.csv")
    assert np.isnan(back.positions[13]).all() and "format-moved-cells" in codes(back)
    np.testing.assert_array_equal(np.delete(back.positions, 13, axis=0), np.delete(read(tmp_path / "plain.csv").positions, 13, axis=0))


@pytest.mark.parametrize("suffix", [".trc", ".tsv", ".csv", ".sto", ".motive", ".optitrack"])
def test_random_damage_is_read_right_or_refused_or_said(tmp_path, suffix):
    random = Random(34)
    others = {".motive": motive(body()), ".optitrack": optitrack(body(), "1.1")}
    text = others[suffix] if suffix in others else text_of(tmp_path, suffix)
    path = tmp_path / f"walk{'.csv' if suffix in others else suffix}"
    path.write_text(text)
    plain = read(path, vertical="z")
    between = "," if path.suffix == ".csv" else "\t"
    quiet = 0
    for _ in range(60):
        lines = text.split("\n")
        kind, at = random.choice(("delete", "double", "cut", "lose", "stop")), random.randrange(len(lines) - 1)
        places = [i for i, sign in enumerate(lines[at]) if sign == between] or [0]
        place = random.choice(places)
        if kind == "delete":
            del lines[at]
        elif kind == "double":
            lines[at] = lines[at][:place] + between + lines[at][place:]
        elif kind == "lose":
            lines[at] = lines[at][:place] + lines[at][place + 1 :]
        elif kind == "cut":
            lines[at] = lines[at][:place] + lines[at][place + random.randrange(1, 40) :]
        else:
            lines = [*lines[:at], lines[at][:place]]
        path.write_text("\n".join(lines))
        try:
            back = read(path, vertical="z")
        except AsterismError as problem:
            assert str(problem).count(str(path)) == 1 and "\n" not in str(problem)
            continue
        if codes(back) <= codes(plain):
            quiet += 1
            same = back.labels == plain.labels and back.rate == plain.rate and back.events == plain.events
            assert same and len(back) == len(plain), (kind, at, lines[at - 1 : at + 1])
            seen = np.isfinite(back.positions)
            assert (seen == np.isfinite(plain.positions)).all(), (kind, at, lines[at - 1 : at + 1])
            np.testing.assert_array_equal(back.positions[seen], plain.positions[seen], str((kind, at)))
    assert quiet < 45, "most damage must show"


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda text: text.replace("Unlabeled Trajectories", "Unlabeled"), "format-header-conflict"),
        (lambda text: text.replace("8;0;300,5;900;100,5\n", ""), "format-cut-off"),
        (lambda text: text.replace("Context;Name;", "Context;"), "format-events-unread"),
        (lambda text: text.replace("0,1;x\n", "0,1;x;"), "format-events-unread"),
        (lambda text: text.replace("8;0;101,5", "7;0;101,5"), "format-frame-numbers"),
        (lambda text: text.replace("Ann:RKNE", ""), "format-point-names"),
        (lambda text: text.replace("Description\n", "Description;"), "format-events-unread"),
    ],
    ids=[
        "unknown section",
        "no rows",
        "no names of events",
        "two events in a line",
        "a frame twice",
        "a name lost",
        "an event behind the names",
    ],
)
def test_damage_in_a_nexus_export_is_said(tmp_path, damage, told):
    text = NEXUS.replace("Ann;Right;Foot Strike;soon;x\n", "")
    (tmp_path / "plain.csv").write_text(text)
    (tmp_path / "walk.csv").write_text(damage(text))
    assert told not in codes(read(tmp_path / "plain.csv"))
    assert told in codes(read(tmp_path / "walk.csv"))


@pytest.mark.parametrize(
    ("whole", "shorter"), [(";;Ann:LKNE", ";Ann:LKNE"), ("Frame;Sub Frame;X;Y;Z\n;;mm;mm;mm\n8", "Frame;X;Y;Z\n;;mm;mm;mm\n8")]
)
def test_a_nexus_header_that_lost_a_cell_is_refused(tmp_path, whole, shorter):
    (tmp_path / "walk.csv").write_text(NEXUS.replace(whole, shorter))
    with pytest.raises(AsterismError, match="does not stand over an X"):
        read(tmp_path / "walk.csv")


VALUES = {
    "inertial sensors": "time,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z",
    "an accelerometer": "time,AccX,AccY,AccZ",
    "inertial sensors by number": "time,IMU1_acc_x,IMU1_acc_y,IMU1_acc_z,IMU1_gyro_x,IMU1_gyro_y,IMU1_gyro_z",
    "letters": "time,ax,ay,az,gx,gy,gz,mx,my,mz",
    "a force plate": "time,Fx,Fy,Fz,Mx,My,Mz",
    "force plates": "time,FP1_Fx,FP1_Fy,FP1_Fz,FP1_Mx,FP1_My,FP1_Mz",
    "joint angles": "time,LKneeAngles_x,LKneeAngles_y,LKneeAngles_z",
}


@pytest.mark.parametrize("header", VALUES.values(), ids=list(VALUES))
@pytest.mark.parametrize("two_rows", [False, True])
def test_forces_and_inertial_sensors_are_no_markers(tmp_path, header, two_rows):
    columns = header.count(",")
    rows = [f"{t / 100}," + ",".join(f"{0.1 * k + 0.01 * t:.3f}" for k in range(columns)) for t in range(12)]
    units = ["", "s" + ",N" * columns] if two_rows else [""]
    path = tmp_path / "values.csv"
    path.write_text("\n".join([header, *units[1:], *rows]) + "\n")
    with pytest.raises(NoMarkers, match=r"is a table of values .* and no recording"):
        read(path)
    assert two_rows or describe(path)["format"] == "CSV table"


@pytest.mark.parametrize("between", [",", ";", "\t"])
def test_lines_above_the_header_of_a_table_give_rate_and_unit(tmp_path, between):
    head = ["Number of frames: 4", "Frequency: 100", "Units: mm", ""]
    rows = [between.join(map(str, (t + 1, 100 + t, 500, 1000, 120, 520, 1700))) for t in range(4)]
    names = between.join(["Frame", *(f"Marker_{k} {axis}" for k in (1, 2) for axis in "xyz")])
    (tmp_path / "take_3d.csv").write_text("\n".join([*head, names, *rows]) + "\n")
    back = read(tmp_path / "take_3d.csv", vertical="z")
    assert (back.labels, back.rate) == (("Marker_1", "Marker_2"), 100.0)
    np.testing.assert_allclose(back.positions[:, 0, 0], [0.1, 0.101, 0.102, 0.103])
    assert not codes(back)


def test_three_rows_of_names_of_a_network_for_poses(tmp_path):
    rows = "".join(f"{t},0.1,0.5,{t / 100},0.2,0.6,1.7\n" for t in range(4))
    head = "scorer,net,net,net,net,net,net\nbodyparts,nose,nose,nose,tail,tail,tail\ncoords,x,y,z,x,y,z\n"
    (tmp_path / "pose.csv").write_text(head + rows)
    with pytest.raises(AsterismError, match="how many frames per second"):
        read(tmp_path / "pose.csv")
    (tmp_path / "pose.csv").write_text("# rate=30\n" + head + rows)
    back = read(tmp_path / "pose.csv", vertical="z")
    assert (back.labels, back.rate) == (("nose", "tail"), 30.0)
    np.testing.assert_allclose(back.positions[:, 0], [[0.1, 0.5, t / 100] for t in range(4)])


def test_orientations_of_opensim_are_named(tmp_path):
    rows = "".join(f"{t / 100}\t0.9{t},0.01,-0.02,0.1\n" for t in range(4))
    (tmp_path / "imu.sto").write_text(f"DataRate=100\nDataType=Quaternion\nversion=3\nendheader\ntime\tpelvis_imu\n{rows}")
    with pytest.raises(NoMarkers, match=r"type Quaternion .* no marker positions"):
        read(tmp_path / "imu.sto")


def test_units_tell_which_columns_are_positions(tmp_path):
    rows = "\n".join(f"{t / 100},0.5,{t},1.0,10,20,{700 + t}" for t in range(12))
    (tmp_path / "both.csv").write_text(f"time,P_x,P_y,P_z,R_x,R_y,R_z\ns,m,m,m,N,N,N\n{rows}\n")
    back = read(tmp_path / "both.csv", vertical="z")
    assert back.labels == ("P",)
    left_out = next(f for f in back.metadata["findings"] if f.code == "format-values-left-out")
    assert "R_x (n)" in left_out.sentence


def test_points_that_are_only_numbered(tmp_path):
    rows = "\n".join(f"{t / 100},0.5,{t / 10},1.0,0.5,0.6,1.7" for t in range(12))
    (tmp_path / "walk.csv").write_text(f"time,X1,Y1,Z1,X2,Y2,Z2\n{rows}\n")
    back = read(tmp_path / "walk.csv", vertical="z")
    assert back.labels == ("1", "2")
    np.testing.assert_allclose(back.positions[:, 0, 1], np.arange(12) / 10)


@pytest.mark.parametrize("name", ["ACC", "ASIS_R", "KNEE_V", "PROTUB"])
def test_markers_with_names_near_those_of_values_stay(tmp_path, name):
    rows = "\n".join(f"{t / 100},0.5,{t / 10},1.0,0.5,0.6,1.7" for t in range(12))
    (tmp_path / "walk.csv").write_text(f"time,{name}_x,{name}_y,{name}_z,C7_x,C7_y,C7_z\n{rows}\n")
    assert read(tmp_path / "walk.csv", vertical="z").labels == (name, "C7")


def test_markers_beside_forces_of_a_treadmill(tmp_path):
    header = "Time,LHEE.PosX,LHEE.PosY,LHEE.PosZ,FP1.ForX,FP1.ForY,FP1.ForZ,FP1.MomX,FP1.MomY,FP1.MomZ"
    rows = "\n".join(f"{t / 100},0.5,0.{t},1.0,1,2,700,4,5,6" for t in range(12))
    (tmp_path / "walk.txt").write_text((header + "\n" + rows).replace(",", "\t") + "\n")
    back = read(tmp_path / "walk.txt", vertical="y")
    assert back.labels == ("LHEE",)
    assert "format-values-left-out" in codes(back)


QTM_OTHERS = {
    "6D data": "NO_OF_BODIES\t1\nFREQUENCY\t100\nDATA_INCLUDED\t6D\nBODY_NAMES\tB\n\nB X\tY\tZ\tRoll\tPitch\tYaw\n1\t2\t3\t0\t0\t0",
    "force plate": "NO_OF_SAMPLES\t1\nFREQUENCY\t1000\nFORCE_PLATE_NAME\tKistler\nFORCE_PLATE_LENGTH\t600\n\nForce_X\tForce_Y\n1\t2",
    "analog data": "NO_OF_SAMPLES\t1\nNO_OF_CHANNELS\t1\nFREQUENCY\t1000\nCHANNEL_NAMES\tEMG1\n\n1",
}


@pytest.mark.parametrize("what", QTM_OTHERS)
def test_other_exports_of_qtm_are_named(tmp_path, what):
    (tmp_path / "walk.tsv").write_text(f"NO_OF_FRAMES\t1\n{QTM_OTHERS[what]}\n")
    with pytest.raises(NoMarkers, match=rf"{what}.*no trajectories of markers"):
        read(tmp_path / "walk.tsv")


@pytest.mark.parametrize("hand", ["righthanded", "lefthanded"])
def test_optitrack_1_1(tmp_path, hand):
    path = tmp_path / "take.csv"
    path.write_text(optitrack(body(), "1.1", hand))
    back = read(path)
    assert (back.labels, back.rate, tuple(back.vertical)) == ((*NAMES, "*1"), 100.0, (0.0, 1.0, 0.0))
    np.testing.assert_allclose(back.positions[:, :8], body().positions[:, :, [1, 2, 0]], atol=1e-9)
    assert np.isfinite(back.positions[1::2, 8]).all() and np.isnan(back.positions[::2, 8]).all()
    assert ("format-header-conflict" in codes(back)) == (hand == "lefthanded")
    assert "format-values-left-out" in codes(back), "the rigid body"


def test_optitrack_1_0_has_points_without_names(tmp_path):
    (tmp_path / "take.csv").write_text(optitrack(body(), "1.0"))
    back = read(tmp_path / "take.csv")
    assert set(back.labels) == {f"*{k}" for k in range(1, 10)}
    assert back.clouds().counts.tolist() == [8 - (t in (3, 4)) + t % 2 for t in range(24)]


def test_an_optitrack_row_that_does_not_come_out_even_is_named(tmp_path):
    lines = optitrack(body(), "1.1").split("\n")
    lines[9] = lines[9].rsplit(",", 2)[0]
    (tmp_path / "take.csv").write_text("\n".join(lines))
    with pytest.raises(AsterismError, match=r"line 10: a row of a frame"):
        read(tmp_path / "take.csv")
    (tmp_path / "take.csv").write_text("\n".join(line for line in lines if not line.startswith("frame")))
    with pytest.raises(NoMarkers, match="no marker"):
        read(tmp_path / "take.csv")
