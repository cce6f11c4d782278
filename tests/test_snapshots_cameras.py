"""What the commands on cameras print, beside what was reviewed; see `snapshot.py`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import snapshot

from asterism.cameras.files import write_rig
from asterism.formats import write_blobs
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, simulate_wand

CASES = {
    "detect": ["detect cam1 cam2 -o images.csv", "detect cam1 -o images.csv"],
    "calibrate-wand": ["calibrate wand wand.csv --wand 0.0 0.2 0.6 --image-size 1280x1024 -o waved.toml"],
    "calibrate-refine": ["calibrate refine body.csv --rig bumped.toml -o refined.toml"],
    "reconstruct": ["reconstruct body.csv --rig rig.toml -o body.npz"],
    "info-rig": ["info rig.toml"],
    "rig-report": ["rig report rig.toml --volume 2x2x2 --noise 0.2"],
    "errors-cameras": [
        "rig plan --volume 2x2 --cameras 4 --image-size 1280x1024 --fov 60 -o plan.toml",
        "calibrate wand rig.toml --wand 0 0.2 0.6 --image-size 1280x1024 -o none.toml",
        "calibrate wand wand.csv --wand 0.6 --image-size 1280x1024 -o none.toml",
        "reconstruct body.csv --rig wand.csv -o out.npz",
        "reconstruct missing.csv --rig rig.toml -o out.npz",
        "detect missing -o out.csv",
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What four cameras saw of a wand and of a walker, their rig, the rig before one was bumped, and images of two cameras."""
    place = tmp_path_factory.mktemp("snapshots")
    rig = ring_rig(4, rng=np.random.default_rng(1))
    write_rig(rig, place / "rig.toml")
    bumped = replace(rig[1], translation=np.add(rig[1].translation, [0.02, 0.0, 0.0]))
    write_rig(replace(rig, cameras=(rig[0], bumped, *rig.cameras[2:])), place / "bumped.toml")
    write_blobs(
        simulate_wand(rig, settings=ImagingSettings(noise=0.2, outliers=0.01), frames=250, rng=np.random.default_rng(2), rate=20.0)[0],
        place / "wand.csv",
    )
    [walk] = simulate_walks(subjects=1, frames=100, markers="helen-hayes", seed=3)
    write_blobs(simulate_blobs(rig, walk.positions, ImagingSettings(noise=0.2), rng=np.random.default_rng(3))[0], place / "body.csv")
    for camera in ("cam1", "cam2"):
        (place / camera).mkdir()
        for frame in range(5):
            image = np.zeros((120, 160), dtype=np.uint8)
            for x in (30, 75, 120):
                cv2.circle(image, (x + frame, 60), 5, 255, -1)
            cv2.imwrite(str(place / camera / f"{frame:03d}.png"), image)
    return place


@pytest.mark.parametrize("name", CASES)
def test_a_command_prints_what_was_reviewed(name: str, folder: Path, record_snapshots: bool, capsys: pytest.CaptureFixture[str]) -> None:
    snapshot.compare(name, snapshot.output(CASES[name], folder, capsys), record_snapshots)
