"""From no label at all: a recording's tracklets joined to markers by their own motion, named once by a person, learned from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import trained

from asterism import formats
from asterism.cli import main
from asterism.errors import AsterismError
from asterism.labelling import MarkerGroups, MarkerModel, group_tracklets, name_groups
from asterism.labelling.naming import locate_groups
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Floats, Ints, Recording
from asterism.simulation import simulate_walks


@pytest.fixture(scope="module")
def walk() -> Recording:
    return simulate_walks(subjects=1, frames=250, markers="helen-hayes", seed=5)[0]


def in_columns(clouds: Clouds) -> Recording:
    """The clouds as a camera system would write them: a column per track, nameless."""
    assert clouds.tracks is not None
    positions = np.full((len(clouds), int(clouds.tracks.max()) + 1, 3), np.nan)
    positions[np.repeat(np.arange(len(clouds)), clouds.counts), clouds.tracks] = clouds.xyz
    return Recording(positions, tuple(f"*{i + 1}" for i in range(positions.shape[1])), clouds.rate, clouds.vertical)


def table(groups: MarkerGroups, clouds: Clouds, truth: Ints) -> Floats:
    """(groups, 1 + M) how many samples of each group are a ghost (first), or each marker."""
    frames, markers = np.nonzero(truth >= 0)
    marker_of = np.full(len(clouds.xyz), -1)
    marker_of[clouds.offsets[frames] + truth[frames, markers]] = markers
    counts = np.zeros((len(groups), truth.shape[1] + 1))
    np.add.at(counts, (groups.of_point, marker_of + 1), 1.0)
    return counts


def names_needed(counts: Floats, share: float = 0.99) -> int:
    """How many groups a person names, the longest first, until so many of the markers' samples have their right name."""
    order = np.argsort(-counts.sum(axis=1), kind="stable")
    right = np.where(counts.argmax(axis=1) > 0, counts.max(axis=1), 0.0)[order]
    return int(np.searchsorted(np.cumsum(right) / counts[:, 1:].sum(), share)) + 1


@pytest.mark.parametrize("hidden", [0, 1, 3])
def test_pieces_of_a_marker_are_joined_and_no_two_markers_are(hidden: int, walk: Recording) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden, 0, seed=3)
    counts = table(group_tracklets(clouds), clouds, truth)
    wrong = counts.sum() - counts.max(axis=1).sum()
    assert wrong <= 0.002 * counts.sum(), f"{wrong:.0f} of {counts.sum():.0f} samples in a group of another marker"
    assert names_needed(counts) <= 15 + hidden


def test_real_walks(data: Path) -> None:
    wrong, total, needed = 0.0, 0.0, []
    for number, (subject, trial) in enumerate([("HC002", "straight"), ("HC055", "turn"), ("HC039", "straight"), ("HC030", "turn")]):
        recording = formats.read(data / "gait" / subject / f"{trial}.c3d", markers="helen-hayes")
        clouds, truth = simulate_gaps_and_ghosts(recording, 3, 0, seed=number)
        counts = table(group_tracklets(clouds), clouds, truth)
        wrong, total = wrong + counts.sum() - counts.max(axis=1).sum(), total + counts.sum()
        needed.append(names_needed(counts))
    assert wrong <= 0.003 * total, f"{wrong:.0f} of {total:.0f} samples in a group of another marker"
    assert max(needed) <= 20 and np.mean(needed) <= 17, needed


def test_two_markers_that_exchange_places_are_not_joined() -> None:
    """A stranger who appears after a marker has gone, elsewhere on the same rigid body, is somebody else."""
    rng = np.random.default_rng(0)
    body = rng.uniform(-0.3, 0.3, size=(6, 3))
    path = np.cumsum(np.full((200, 3), [0.01, 0.0, 0.0]), axis=0)
    positions = path[:, None] + body
    positions[100:, 0] = np.nan
    positions[:110, 1] = np.nan
    clouds = Recording(positions, tuple("ABCDEF"), 100.0).clouds()
    assert len(group_tracklets(clouds)) == 6
    positions[110:, 1] = path[110:] + body[0]
    assert len(group_tracklets(Recording(positions, tuple("ABCDEF"), 100.0).clouds())) == 5, "the same place is the same marker"


@settings(deadline=None, max_examples=8)
@given(st.integers(0, 2**31), st.integers(0, 2))
def test_every_point_is_in_one_group_which_has_it_once_a_frame(seed: int, ghosts: int) -> None:
    short = simulate_walks(subjects=1, frames=60, markers="helen-hayes", seed=1)[0]
    clouds, _ = simulate_gaps_and_ghosts(short, 3, ghosts, seed)
    groups = group_tracklets(clouds)
    frame_of = np.repeat(np.arange(len(clouds)), clouds.counts)
    assert len(np.unique(groups.of_point * len(clouds) + frame_of)) == len(clouds.xyz)
    np.testing.assert_array_equal(np.bincount(groups.of_point, minlength=len(groups)), groups.frames)
    often = groups.frames >= 0.1 * len(clouds)
    assert groups.frequent == often.sum() and often[: groups.frequent].all(), "the often seen groups come first"


def test_the_same_groups_again_and_however_the_recording_lies(walk: Recording) -> None:
    clouds, _ = simulate_gaps_and_ghosts(walk, 2, 1, seed=4)
    groups = group_tracklets(clouds)
    np.testing.assert_array_equal(group_tracklets(clouds).of_point, groups.of_point)
    moved = replace(clouds, xyz=clouds.xyz[:, [2, 0, 1]] + np.array([1.0, 2.0, 0.5]), vertical=np.array([1.0, 0.0, 0.0]))
    np.testing.assert_array_equal(group_tracklets(moved).of_point, groups.of_point)


def test_places_say_where_a_group_sits(walk: Recording) -> None:
    clouds = walk.clouds()
    groups = group_tracklets(clouds)
    assert len(groups) == 15
    where = {
        walk.labels[int(clouds.columns[np.argmax(groups.of_point == g)])]: place for g, place in enumerate(locate_groups(clouds, groups))
    }
    assert where["LASI"].left > 0.05 and where["RASI"].left < -0.05 and abs(where["SACR"].left) < 0.03
    assert where["LTOE"].height < where["LKNE"].height < where["LASI"].height
    assert where["SACR"].ahead < where["LASI"].ahead
    near = where["LASI"].nearest[0]
    assert near[1] < 0.3 and near[0] != int(groups.of_point[np.argmax(clouds.columns == walk.labels.index("LASI"))])


def test_the_nearest_groups_are_such_as_are_listed(walk: Recording) -> None:
    blinks = np.full((len(walk.positions), 4, 3), np.nan)
    for k in range(4):
        blinks[20 * k : 20 * k + 3, k] = walk.positions[20 * k : 20 * k + 3, walk.labels.index("LASI")] + [0.03, 0.01, 0.02]
    positions = np.concatenate([walk.positions, blinks], axis=1)
    clouds = Recording(positions, (*walk.labels, "*1", "*2", "*3", "*4"), walk.rate, walk.vertical).clouds()
    groups = group_tracklets(clouds)
    assert len(groups) > groups.frequent
    assert all(near < groups.frequent for place in locate_groups(clouds, groups) for near, _ in place.nearest)


def test_of_a_standing_subject_no_side_is_told() -> None:
    clouds = Recording(np.tile(np.random.default_rng(0).normal(size=(1, 6, 3)), (50, 1, 1)), tuple("ABCDEF"), 100.0).clouds()
    assert all(np.isnan(place.left) for place in locate_groups(clouds, group_tracklets(clouds)))


def test_names_make_a_labelled_recording(walk: Recording) -> None:
    clouds, truth = simulate_gaps_and_ghosts(walk, 2, 1, seed=3)
    raw = in_columns(clouds)
    own = raw.clouds()
    groups = group_tracklets(own)
    column_truth = {tuple(np.round(p, 9)): name for t in range(len(walk)) for name, p in zip(walk.labels, walk.positions[t], strict=True)}
    names = {}
    for g in range(len(groups)):
        found = [column_truth.get(tuple(np.round(own.xyz[p], 9))) for p in np.nonzero(groups.of_point == g)[0]]
        most = max(set(found), key=lambda name: (found.count(name), name or ""))
        if most is not None and len(found) > 5:
            names[g] = most
    labelled = name_groups(raw, groups, names)
    chosen = labelled.select(walk.labels)
    right = np.linalg.norm(chosen.positions - walk.positions, axis=2) < 1e-9
    assert right[chosen.visible].mean() >= 0.998
    assert right.sum() >= 0.98 * (truth >= 0).sum()
    assert labelled.visible.sum() == len(own.xyz), "a sample was lost"


def test_names_that_cannot_be_are_refused(walk: Recording) -> None:
    groups = group_tracklets(walk.clouds())
    with pytest.raises(AsterismError, match=r"groups 1 and 2 are both named LKNE .* frame 0"):
        name_groups(walk, groups, {0: "LKNE", 1: "LKNE"})
    with pytest.raises(AsterismError, match="no group 99"):
        name_groups(walk, groups, {98: "LKNE"})
    with pytest.raises(AsterismError, match=r"'\*3' is not a marker's name"):
        name_groups(walk, groups, {0: "*3"})
    with pytest.raises(AsterismError, match="no group has a name"):
        name_groups(walk, groups, {})
    with pytest.raises(AsterismError, match="group these clouds"):
        name_groups(walk.frames(slice(0, 10)), groups, {0: "LKNE"})


@pytest.mark.parametrize(
    "points",
    [[], [np.zeros((0, 3))] * 3, [np.zeros((1, 3))], [np.zeros((3, 3))] * 20, [np.eye(3)] * 2],
    ids=["no-frame", "no-point", "one-point", "coincident", "two-frames"],
)
def test_odd_clouds_have_groups_too(points: list[Floats]) -> None:
    clouds = Clouds.from_points(points, 100.0)
    groups = group_tracklets(clouds)
    assert len(groups.of_point) == len(clouds.xyz) == groups.frames.sum()
    assert len(locate_groups(clouds, groups)) == len(groups)


# The command and its page


def run(*args: object) -> int:
    return main([str(arg) for arg in args])


@pytest.fixture
def first(walk: Recording, tmp_path: Path) -> Path:
    formats.write(tmp_path / "first.c3d", in_columns(simulate_gaps_and_ghosts(walk, 1, 0, seed=2)[0]))
    return tmp_path / "first.c3d"


def test_numbers_then_names_then_a_model(
    first: Path, walk: Recording, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    place = first.parent
    assert run("name", first, "--json", place / "n.json", "--report", place / "n.html") == 0
    told = json.loads((place / "n.json").read_text())
    often = [group for group in told["groups"] if group["frames"] >= 0.1 * told["frames"]]
    assert 15 <= len(often) <= 17 and f"{len(often)} groups hold" in capsys.readouterr().out
    assert "Frame " in (place / "n.html").read_text(encoding="utf-8")
    (place / "names.csv").write_text("group,marker\n" + "".join(f"{g['group']},M{g['group']}\n" for g in often))
    out = place / "labelled.c3d"
    assert run("name", first, "--names", place / "names.csv", "-o", out, "--report", place / "n.html", "--overwrite") == 0
    assert "Named: " in capsys.readouterr().out and "1 M1" in (place / "n.html").read_text(encoding="utf-8")
    labelled = formats.read(out)
    assert {f"M{g['group']}" for g in often} <= set(labelled.labels)
    assert labelled.visible.sum() == formats.read(first).visible.sum()
    taught = trained([formats.read(out, markers=[f"M{g['group']}" for g in often])], miner=None)
    assert (taught.label_frames(walk.clouds()).indices >= 0).mean() > 0.9
    monkeypatch.setattr(MarkerModel, "fit", lambda *given, **settings: taught)
    capsys.readouterr()
    assert run("train", out, "-o", place / "mine.model") == 0
    said = capsys.readouterr()
    assert "from 1 recording of 1 subject (" in said.out and "one person shows little of how others differ" in said.err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("group,marker\nseven,LKNE\n", "line 2: 'seven,LKNE' is not group,marker"),
        ("1,LKNE\n1,RKNE\n", "line 2: group 1 already has a name"),
        ("0,LKNE\n", "line 1"),
        ("1,LKNE,left\n", "line 1"),
        ("group,marker\n1,\n", "gives no name"),
        ("", "gives no name"),
        ("1,LKNE\n2,LKNE\n", "both named LKNE"),
        ("400,LKNE\n", "no group 400"),
    ],
)
def test_names_that_make_no_sense(text: str, said: str, first: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (first.parent / "names.csv").write_text(text)
    assert run("name", first, "--names", first.parent / "names.csv", "-o", first.parent / "out.c3d") == 2
    shown = capsys.readouterr()
    assert said in shown.err and shown.err.count("\n") == 1 and shown.out == ""
    assert not (first.parent / "out.c3d").exists()


def test_a_file_without_points_has_nothing_to_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formats.write(tmp_path / "none.npz", Recording(np.full((9, 2, 3), np.nan), ("A", "B"), 100.0))
    assert run("name", tmp_path / "none.npz") == 2
    shown = capsys.readouterr()
    assert "none.npz has no point in any frame" in shown.err and shown.out == ""


def test_names_need_an_output_that_is_new(first: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (first.parent / "names.csv").write_text("1,LKNE\n")
    assert run("name", first, "--names", first.parent / "names.csv") == 2
    assert "belong together" in capsys.readouterr().err
    assert run("name", first, "--names", first.parent / "names.csv", "-o", first) == 2
    assert "exists" in capsys.readouterr().err
    assert run("name", first, "--names", first.parent / "no.csv", "-o", first.parent / "out.c3d") == 2
    assert "no.csv" in capsys.readouterr().err
