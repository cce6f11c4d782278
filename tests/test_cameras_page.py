"""The Python of docs/cameras.md, run as it stands."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.formats import write_blobs
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import images_of, render, ring_rig, walker_capsules, wave_wand

PAGE = Path(__file__).parent.parent / "docs" / "cameras.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def called(rig: Rig, *names: str) -> Rig:
    return Rig(tuple(replace(camera, name=name) for camera, name in zip(rig, names, strict=True)), rig.vertical)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the page's examples read: a rig, another one as `.xcp`, a wand, a walk."""
    folder = tmp_path_factory.mktemp("page")
    rig = called(ring_rig(3, rng=np.random.default_rng(1)), "left", "middle", "right")
    write_rig(rig, folder / "rig.toml")
    write_rig(called(ring_rig(2), "8", "9"), folder / "walking.xcp")
    write_blobs(wave_wand(rig, frames=250, rate=20.0, rng=np.random.default_rng(2))[0], folder / "wand.csv")
    walk = simulate_walks(1, frames=60)[0]
    seen, _ = images_of(rig, walk.positions, 0.2, walker_capsules(walk), rng=np.random.default_rng(3))
    for name in ("walk.csv", "2d.csv"):
        write_blobs(seen, folder / name)
    return folder


def test_the_examples_of_the_page_run_one_after_the_other(files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(files)
    photographs = Path(os.environ.get("ASTERISM_DATA", "nowhere")) / "cameras" / "chessboard-stereo"
    for side in ("left", "right"):
        (files / side).mkdir()
        for path in sorted(photographs.glob(f"{side}0[1-9].jpg")):
            shutil.copy(path, files / side)
    dot, _ = images_of(ring_rig(1), np.zeros((1, 3)), rng=np.random.default_rng(4))
    known = {"image": next(render(dot, 0, (1280, 1024), rng=np.random.default_rng(5)))}
    for number, block in enumerate(BLOCKS):
        if photographs.exists() or "Board" not in block:
            exec(compile(block, f"{PAGE.name}, example {number}", "exec"), known)


def test_every_fence_of_the_page_is_closed() -> None:
    fences = re.findall(r"^```(\w*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert all(opening and not closing for opening, closing in zip(fences[::2], fences[1::2], strict=True)), fences
