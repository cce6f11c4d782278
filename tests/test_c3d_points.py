"""Markers are told from computed and unnamed points: by truth over all real files, and rule by rule on simulated ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from asterism.formats import read
from asterism.formats._physical import COMPUTED, MARKER, UNNAMED, kinds_by_name, point_kinds
from asterism.formats.c3d._file import open_c3d
from asterism.formats.c3d._reader import in_metres, kinds_of_points

BODY = "LFHD RFHD LBHD RBHD C7 T2 T6 T10 T12 RBAK CLAV STRN LASI RASI SACR"
SIDES = "SHO ELB WRA WRB FIN THI KNE TIB ANK HEE TOE HFB TUB SHN CPG LCA STL NAV P1M P5M D5M HLX"
STATIC = "MMA PCA D1M"
GAIT = set(BODY.split()) | {side + name for side in "LR" for name in f"{SIDES} {STATIC}".split()}

# Where the index (made by name suffix) is not the truth, with what was looked at.
TRUTH = {
    ("sub_labels.c3d", "RCLA"): MARKER,  # beside C7, moves with noise against every other point: a clavicle marker
    ("sub_labels.c3d", "LCLA"): MARKER,
    ("fmc_static.c3d", "LKNE"): COMPUTED,  # the file lists it under POINT:MODELED_MARKERS
    ("fmc_static.c3d", "RKNE"): COMPUTED,
    ("sydney_static.c3d", "LKNE"): COMPUTED,
    ("sydney_static.c3d", "RKNE"): COMPUTED,
}

COMPUTED_NAMES = (
    "LHipAngles LKneeAngles RGroundReactionForce LHipMoment LAnklePower CentreOfMass CenterOfMass COM CentreOfMassFloor LHJC R_HJC "
    "L_HJC_reg RAJC LKneeJointCentre KJC_L HipJC_R Ann:LHJC VMID VRKN V_Mid_ASIS V.R.Hip virtual1 LNormalisedGRF LFemurProjections"
)
MARKER_NAMES = (
    "LKNE V.Sacral VSAC R.ASIS r_asis U X UPA LUPA L5 Marker1 P12 Channel101 LTIA LFOA RCLA SACR LLFE LMFE LMAL Knee_Marker1 VRTX Comb "
    "LHEE RankleLat hip_l Triangle Rectangle2 LTH0 LTH1 C7 Ann:LTOP Probe1 NAR GloveL1 TRXP HEDO"
)


def files_with_truth(data: Path) -> list[tuple[Path, dict | None]]:
    index = json.loads((data / "movement" / "index.json").read_text(encoding="utf-8"))
    found: list[tuple[Path, dict | None]] = [(path, None) for path in sorted((data / "gait").rglob("*.c3d"))]
    for name, entry in index.items():
        if name.lower().endswith(".c3d") and "error" not in entry and entry["frames"]:
            folder = data if name.startswith("conformance") else data / "cameras" if name.startswith("vicon-rig") else data / "movement"
            found.append((folder / name, entry))
    return found


def true_kind(path: Path, entry: dict | None, label: str) -> str:
    name = label.rpartition(":")[2]
    if (path.name, name) in TRUTH:
        return TRUTH[path.name, name]
    if entry is None:
        return UNNAMED if label.startswith("*") else MARKER if label in GAIT else COMPUTED
    if label in entry["markers"]:
        return MARKER
    return UNNAMED if label.startswith("*") or entry["computed"] == 0 else COMPUTED


def test_markers_of_all_real_files_are_told_and_none_is_lost(data: Path) -> None:
    right, total, lost = 0, 0, []
    for path, entry in files_with_truth(data):
        file = open_c3d(path)
        kinds = kinds_of_points(file, in_metres(file)[0])
        for label, kind in zip(file.labels, kinds, strict=True):
            truth = true_kind(path, entry, label)
            total += 1
            right += kind == truth
            if truth == MARKER and kind != MARKER:
                lost.append(f"{path.name}: {label} taken for {kind}")
    assert total > 10_000
    assert lost == []
    assert right / total >= 0.995, f"{right} of {total}"


def test_names_alone_lose_no_marker(data: Path) -> None:
    for path, entry in files_with_truth(data):
        file = open_c3d(path)
        for label, kind in zip(file.labels, kinds_by_name(file.labels), strict=True):
            assert true_kind(path, entry, label) != MARKER or kind == MARKER, f"{path.name}: {label} taken for {kind}"


def test_a_label_that_the_marker_set_names_is_read_even_where_the_file_calls_it_computed(data: Path) -> None:
    path = data / "movement/clinical-lower/fmc_static.c3d"
    assert "LKNE" not in read(path).labels
    assert read(path, markers=("LASI", "LKNE")).visible[:, 1].all()


@pytest.mark.parametrize(
    "label",
    COMPUTED_NAMES.split(),
)
def test_families_of_computed_names(label: str) -> None:
    assert kinds_by_name([label]) == [COMPUTED]


@pytest.mark.parametrize(
    "label", ["", " ", "*", "*12", "20100", "U4", "uname12", "Unlabeled:108", "Unlabelled 3", "unidentified", "Ann:*7"]
)
def test_families_of_unnamed_points(label: str) -> None:
    assert kinds_by_name([label]) == [UNNAMED]


@pytest.mark.parametrize(
    "label",
    MARKER_NAMES.split(),
)
def test_names_of_markers_that_look_like_others(label: str) -> None:
    assert kinds_by_name([label]) == [MARKER]


def wandering(frames: int = 60, points: int = 10, seed: int = 0) -> np.ndarray:
    """Markers of a body that walks 3 m and turns while its skin moves by 2 mm: (frames, points, 3) m, as float32 holds millimetres."""
    rng = np.random.default_rng(seed)
    body = rng.uniform([-0.25, -0.25, 0.05], [0.25, 0.25, 1.7], size=(points, 3))
    return stored(turned(body, frames) + rng.normal(scale=0.002, size=(frames, points, 3)))


def turned(body: np.ndarray, frames: int) -> np.ndarray:
    angles = np.linspace(0, 1.5, frames)
    turn = np.zeros((frames, 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(angles)
    turn[:, 1, 0], turn[:, 0, 1] = np.sin(angles), -np.sin(angles)
    turn[:, 2, 2] = 1
    return body @ turn.transpose(0, 2, 1) + np.linspace(0, 3, frames)[:, None, None] * [1, 0, 0] + [1, 1, 0]


def stored(positions: np.ndarray) -> np.ndarray:
    return (positions * 1000).astype(np.float32).astype(np.float64) / 1000


def names(count: int) -> list[str]:
    return [f"LM{chr(65 + i)}K" for i in range(count)]


def kinds_of(added: np.ndarray, labels: list[str]) -> list[str]:
    markers = wandering()
    return point_kinds([*names(10), *labels], np.concatenate([markers, stored(added)], axis=1))


def test_unit_axes_of_a_segment_are_computed_whatever_their_names() -> None:
    frame = np.array([[0.1, 0.0, 1.0], [0.2, 0.0, 1.0], [0.1, 0.1, 1.0], [0.1, 0.0, 1.1]])
    kinds = kinds_of(turned(frame, 60), ["SEGQ", "FOO", "BARR", "QUXX"])
    assert kinds[:10] == [MARKER] * 10
    assert kinds[11:] == [COMPUTED] * 3
    skewed = frame + np.array([[0, 0, 0], [0, 0.02, 0], [0, 0, 0.01], [0.01, 0, 0]])
    assert kinds_of(turned(skewed, 60), ["SEGQ", "FOO", "BARR", "QUXX"]) == [MARKER] * 14, "a stiff plate of markers is no frame"


def test_a_point_half_way_between_two_markers_is_computed() -> None:
    markers = wandering()
    between = (markers[:, :1] + markers[:, 3:4]) / 2
    assert kinds_of(between, ["MIDD"]) == [MARKER] * 10 + [COMPUTED]
    near = between + np.random.default_rng(1).normal(scale=0.0005, size=between.shape)
    assert kinds_of(near, ["MIDD"]) == [MARKER] * 11


def test_a_point_set_off_from_a_marker_is_computed_but_a_solved_rigid_body_is_not() -> None:
    markers = wandering()
    offset = turned(np.zeros((1, 3)), 60) - turned(np.array([[0.0, 0.05, 0.0]]), 60)
    assert kinds_of(markers[:, :1] + offset, [names(1)[0] + "1"]) == [MARKER] * 10 + [COMPUTED]
    plate = np.array([[0.1, 0.0, 1.0], [0.17, 0.01, 1.0], [0.12, 0.08, 1.03], [0.1, 0.03, 1.12]])
    assert kinds_of(turned(plate, 60), ["Hand", "HandOut", "HandIn", "Hand2"]) == [MARKER] * 14


def test_undeclared_angles_stay_near_the_origin_and_powers_fill_one_coordinate() -> None:
    time = np.linspace(0, 6, 60)[:, None, None]
    angles = np.sin(time) * [[[0.06, 0.02, 0.01]]]
    power = np.cos(time) * [[[0.0, 0.0, 1.2]]]
    moment = np.sin(time) * [[[40.0, 90.0, 20.0]]] + 60.0
    kinds = kinds_of(np.concatenate([angles, power, moment], axis=1), ["LFFHFA", "LWRK", "LMOM"])
    assert kinds == [MARKER] * 10 + [COMPUTED] * 3
    still = np.tile(np.array([[[0.01, 0.02, 0.0]]]), (60, 1, 1)) + np.random.default_rng(0).normal(scale=1e-4, size=(60, 1, 3))
    assert kinds_of(still, ["CORN"])[-1] == MARKER, "a marker on the corner of a force plate stands still"


def test_one_frame_and_no_positions_leave_it_to_the_names() -> None:
    labels = [*names(10), "LHJC"]
    assert point_kinds(labels) == [MARKER] * 10 + [COMPUTED]
    assert point_kinds(labels, wandering(points=11)[:1]) == [MARKER] * 10 + [COMPUTED]
    assert point_kinds([]) == []
    assert point_kinds(labels, np.full((20, 11, 3), np.nan)) == [MARKER] * 10 + [COMPUTED]
    assert point_kinds(labels, np.zeros((20, 11, 3))) == [MARKER] * 10 + [COMPUTED]


def test_declared_labels_are_computed_with_and_without_a_subject() -> None:
    assert point_kinds(["Ann:LFTA", "Ann:LKNE", "*3"], declared={"LFTA", "*3"}) == [COMPUTED, MARKER, UNNAMED]
