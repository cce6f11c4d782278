"""The Python of README.md and docs/*.md, run as it stands on simulated files; and its command lines, as far as parsing goes.

The blocks of a page run in their order, in one namespace, in a folder that holds the files which the pages read. A block that needs
real photographs runs where `ASTERISM_DATA` names their folder. Programs that do not end by themselves run in test_page_receivers.py;
whole command lines in test_from_the_box.py, test_cli.py and test_demo_cameras.py.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main
from models import trained
from receivers import ENDLESS

import asterism
from asterism.cameras import Rig
from asterism.cameras.files import write_rig
from asterism.cli import command_line
from asterism.formats import write_blobs, write_skeleton
from asterism.labelling import MarkerModel
from asterism.simulation import simulate_walks
from asterism.simulation.cameras import ImagingSettings, render_images, ring_rig, simulate_blobs, simulate_wand, walker_capsules
from tests.characters import character, stepping_person

ROOT = Path(__file__).parent.parent
PAGES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")} - {ROOT / "docs" / "index.md"})  # a copy of README.md, for the site
PHOTOGRAPHS = Path(os.environ.get("ASTERISM_DATA", "nowhere")) / "cameras" / "chessboard-stereo"
NEEDS_PHOTOGRAPHS = ("find_board",)
OF_ANOTHER_PROGRAM = "import opensim\n"
"""OpenSim's own Python, which is not installed here."""


def blocks_of(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def called(rig: Rig, *names: str) -> Rig:
    return Rig(tuple(replace(camera, name=name) for camera, name in zip(rig, names, strict=True)), rig.vertical)


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the pages' examples read: labelled walks, bones, rigs, a wand, what cameras saw of a walk, two folders of photographs."""
    folder = tmp_path_factory.mktemp("examples")
    for name, walk in zip(("ann", "ben", "cem", "walk"), simulate_walks(4, frames=60, markers="helen-hayes", seed=3), strict=True):
        asterism.write(folder / f"{name}.c3d", walk)
    asterism.write(folder / "walk.npz", walk)
    write_skeleton(folder / "walk.bvh", stepping_person(seconds=0.6))
    write_skeleton(folder / "troll.bvh", character(0.7, 1.4))
    rig = called(ring_rig(3, rng=np.random.default_rng(1)), "left", "middle", "right")
    write_rig(rig, folder / "rig.toml")
    write_rig(called(ring_rig(2), "8", "9"), folder / "walking.xcp")
    write_blobs(simulate_wand(rig, frames=250, rate=20.0, rng=np.random.default_rng(2))[0], folder / "wand.csv")
    walk = simulate_walks(1, frames=60)[0]
    seen, _ = simulate_blobs(rig, walk.positions, ImagingSettings(noise=0.2), body=walker_capsules(walk), rng=np.random.default_rng(3))
    for name in ("walk.csv", "2d.csv"):
        write_blobs(seen, folder / name)
    for side in ("left", "right"):
        (folder / side).mkdir()
        for path in sorted(PHOTOGRAPHS.glob(f"{side}0[1-9].jpg")):
            shutil.copy(path, folder / side)
    return folder


@pytest.fixture(scope="session")
def model(files: Path) -> MarkerModel:
    recordings = [asterism.read(files / f"{name}.c3d", markers="helen-hayes") for name in ("ann", "ben", "cem")]
    return trained(recordings, seed=0, miner=None)


@pytest.fixture
def trained_at_once(model: MarkerModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """`fit` takes what it would take, and gives a model that was trained once for all pages, on little."""
    arguments = inspect.signature(MarkerModel.fit)

    def fit(*args: Any, **options: Any) -> MarkerModel:
        arguments.bind(*args, **options)
        return model

    monkeypatch.setattr(MarkerModel, "fit", fit)


@pytest.mark.usefixtures("trained_at_once")
@pytest.mark.parametrize("page", [page for page in PAGES if blocks_of(page, "python")], ids=lambda page: page.name)
def test_the_examples_of_a_page_run_one_after_the_other(page: Path, files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    dot, _ = simulate_blobs(ring_rig(1), np.zeros((1, 3)), rng=np.random.default_rng(4))
    known: dict[str, Any] = {"image": next(render_images(dot, 0, (1280, 1024), rng=np.random.default_rng(5)))}
    for number, block in enumerate(blocks_of(page, "python"), 1):
        if block.startswith((OF_ANOTHER_PROGRAM, ENDLESS)):
            continue
        if PHOTOGRAPHS.exists() or not any(name in block for name in NEEDS_PHOTOGRAPHS):
            exec(compile(block, f"{page.name}, example {number}", "exec"), known)


def command_lines(page: Path) -> Iterator[list[str]]:
    """The words of each command line of a page that calls `asterism`, without comments and what follows `&&`, `|` and `;`."""
    for block in blocks_of(page, "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            for part in _parts(words):
                if "asterism" in part[:1]:
                    yield part[1:]


def _parts(words: list[str]) -> Iterator[list[str]]:
    part: list[str] = []
    for word in words:
        if word in ("&&", "|", ";", "do"):
            yield part
            part = []
        else:
            part.append(word)
    yield part


def unknown_words(words: list[str]) -> list[str]:
    """The verbs and options of a command line that `asterism` does not have."""
    command: Any = typer.main.get_command(command_line(words))
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        if words[0] not in command.commands:
            return [words[0]]
        command, words = command.commands[words[0]], words[1:]
    known = {"-h", "--help"} | {option for parameter in command.params for option in [*parameter.opts, *parameter.secondary_opts]}
    return [word for word in words if re.match(r"--?[A-Za-z]", word) and word.split("=")[0] not in known]


@pytest.mark.parametrize("page", [page for page in PAGES if blocks_of(page, "sh")], ids=lambda page: page.name)
def test_the_commands_of_a_page_exist_with_their_options(page: Path) -> None:
    wrong = [f"asterism {shlex.join(words)}: {unknown}" for words in command_lines(page) if (unknown := unknown_words(words))]
    assert not wrong, f"{page.name}: {wrong}"


def test_a_command_or_option_that_does_not_exist_is_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("```sh\nasterism demo && asterism label x --modell y  # why\nasterism rig look\n```\n", encoding="utf-8")
    assert [unknown_words(words) for words in command_lines(page)] == [[], ["--modell"], ["look"]]
