"""What the commands on recordings print, beside what was reviewed; see `snapshot.py`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import snapshot
from models import SHORT, examining_briefly, trained, training_with

from asterism import formats
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Recording
from asterism.simulation import simulate_walks

CASES = {
    "train": ["train walk-0.c3d walk-1.c3d walk-2.c3d -o trained.model --markers helen-hayes"],
    "info": ["info walk-0.c3d", "info nameless.c3d broken.c3d", "info walk-0.c3d --json -"],
    "label": ["label nameless.c3d gaps.c3d -m walks.model -o labelled"],
    "label-json": ["label gaps.c3d -m walks.model -o labelled-json --json -"],
    "label-batch": ["label walk-3.c3d broken.c3d missing.c3d -m walks.model -o labelled-batch"],
    "label-subject": ["label gaps.c3d -m walks.model -o labelled-subject --subject walk-0.c3d"],
    "evaluate": ["evaluate walk-3.c3d -m walks.model --occlusions 0 2 --ghosts 0 1"],
    "review": ["review gaps.c3d -m walks.model --top 5"],
    "learn": ["learn walks.model walk-3.c3d -o learned.model"],
    "audit": ["audit walk-0.c3d walk-1.c3d", "audit swapped.c3d walk-0.c3d walk-1.c3d"],
    "capturability": ["capturability walk-0.c3d walk-1.c3d --markers RASI,LASI,SACR,RKNE,RANK,RTOE,LTOE"],
    "name": ["name nameless.c3d"],
    "convert": ["convert walk-0.c3d walk-0.trc", "convert walk-0.c3d walk-0.trc", "convert walk-0.c3d knees.csv --markers LKNE,RKNE"],
    "errors-usage": [
        "lable",
        "label walk-3.c3d",
        "info",
        "train walk-0.c3d -o m --target-hit-rate 99.9",
        "train walk-0.c3d -o m --features g2,g77",
        "evaluate walk-3.c3d",
        "evaluate walk-3.c3d -m some.model --leave-one-subject-out",
        "convert walk-0.c3d up.trc --vertical 1,2,up",
    ],
    "errors-files": [
        "info missing.c3d",
        "info broken.c3d",
        "info text.c3d",
        "train walk-0.c3d -o no/such/folder/m.model",
        "train walk-0.c3d legless.c3d -o m.model --markers helen-hayes",
        "label walk-3.c3d -m missing.model -o out",
        "label walk-3.c3d -m broken.model -o out",
        "label walk-3.c3d -m walks.model -o .",
        "evaluate walk-3.c3d -m walks.model --occlusions 16",
        "convert walk-0.c3d walk.docx",
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Walks of four people, and what can be wrong with files."""
    place = tmp_path_factory.mktemp("snapshots")
    walks = simulate_walks(subjects=4, frames=100, markers="helen-hayes", seed=3)
    for i, walk in enumerate(walks):
        formats.write(place / f"walk-{i}.c3d", walk)
    formats.write(place / "nameless.c3d", Recording.from_clouds(walks[3].clouds()))
    formats.write(place / "gaps.c3d", Recording.from_clouds(simulate_gaps_and_ghosts(walks[3], 2, 1, seed=1)[0]))
    formats.write(place / "legless.c3d", walks[1].select(walks[1].labels[:3]))
    swapped = walks[2].positions.copy()
    thigh, knee = walks[2].labels.index("LTHI"), walks[2].labels.index("LKNE")
    swapped[40:60, [thigh, knee]] = swapped[40:60, [knee, thigh]]
    formats.write(place / "swapped.c3d", replace(walks[2], positions=swapped))
    (place / "broken.c3d").write_bytes((place / "walk-0.c3d").read_bytes()[:300])
    (place / "text.c3d").write_text("not a C3D file\n", encoding="utf-8")
    (place / "broken.model").write_text("not a model\n", encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def model(folder: Path) -> None:
    """walks.model, which the cases take: of the first three people."""
    trained([formats.read(folder / f"walk-{i}.c3d", markers="helen-hayes") for i in range(3)], miner=None).save(folder / "walks.model")


@pytest.mark.parametrize("name", CASES)
def test_a_command_prints_what_was_reviewed(
    name: str, folder: Path, request: pytest.FixtureRequest, record_snapshots: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    if any("walks.model" in line for line in CASES[name]):
        request.getfixturevalue("model")
    with examining_briefly(), training_with(SHORT):
        snapshot.compare(name, snapshot.output(CASES[name], folder, capsys), record_snapshots)


def test_every_snapshot_belongs_to_a_case() -> None:
    from test_snapshots_cameras import CASES as CAMERA_CASES

    assert {path.stem for path in snapshot.SNAPSHOTS.glob("*.txt")} == {*CASES, *CAMERA_CASES}
