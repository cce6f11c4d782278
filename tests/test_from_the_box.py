"""The road of docs/from-the-box.md, run as it stands on four small simulated cameras, and held against the truth."""

from __future__ import annotations

import csv
import re
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from models import trained

import asterism
from asterism.cameras import Rig
from asterism.cameras.files import read_rig
from asterism.cli import main
from asterism.labelling import group_tracklets, name_groups
from asterism.recording import Blobs, Recording
from asterism.simulation import simulate_standing, simulate_walks
from asterism.simulation.cameras import ImagingSettings, ring_rig, simulate_blobs, simulate_wand, walker_capsules
from asterism.simulation.comparison import compare_rigs

PAGE = Path(__file__).parent.parent / "docs" / "from-the-box.md"
SIZE = (480, 384)
RATE = 50.0
NOT_HERE = ("learn",)
"""Commands that take long and have tests of their own; `train` is done without mining."""


def commands() -> Iterator[list[str]]:
    """The page's commands in order, loops unrolled."""
    for block in re.findall(r"```sh\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        unrolled = re.sub(
            r"for (\w+) in (.*?); do\n(.*?)done\n",
            lambda loop: "".join(loop[3].replace(f"${loop[1]}", value) for value in loop[2].split()),
            block,
            flags=re.DOTALL,
        )
        yield from (shlex.split(line)[1:] for line in unrolled.splitlines())


def film(folder: Path, blobs: Blobs, rate: float) -> None:
    """A video for each camera; markers are 5 px wide."""
    folder.mkdir()
    dark = np.random.default_rng(0).normal(12.0, 1.0, (SIZE[1], SIZE[0])).astype(np.uint8)
    for c in range(len(blobs.cameras)):
        video = cv2.VideoWriter(str(folder / f"cam{c + 1}.avi"), cv2.VideoWriter_fourcc(*"MJPG"), rate, SIZE, isColor=False)
        for t in range(len(blobs)):
            image = dark.copy()
            for x, y in np.rint(64 * blobs.of(t, c)).astype(int).tolist():
                cv2.circle(image, (x, y), 160, 200, cv2.FILLED, cv2.LINE_AA, shift=6)
            video.write(image)
        video.release()


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Rig, dict[str, Recording]]:
    """Four cameras' videos of a wand, of the wand on the floor, and of two people, in the folder that is worked in."""
    monkeypatch.chdir(tmp_path)
    rig = ring_rig(4, radius=3.4, height=2.3, size=SIZE, focal=0.75 * SIZE[0], rng=np.random.default_rng(5))
    film(
        tmp_path / "wand",
        simulate_wand(rig, settings=ImagingSettings(noise=0.0, merging=False), frames=150, rate=5.0, rng=np.random.default_rng(6))[0],
        5.0,
    )
    along = np.array([0.0, 0.2, 0.6])[:, None]
    lying = np.concatenate([np.tile(along * [1.0, 0, 0], (12, 1, 1)), np.tile([0, 0.1, 0] + along * [0, 1.0, 0], (12, 1, 1))])
    film(tmp_path / "floor", simulate_blobs(rig, lying, ImagingSettings(noise=0.0), rng=np.random.default_rng(7))[0], RATE)
    people: dict[str, Recording] = {}
    standing, walks = simulate_standing(2, 20, RATE, seed=2), simulate_walks(2, 80, RATE, seed=2, trials=2)
    for person, name in enumerate(("ann", "ben")):
        people |= {f"{name}-static": standing[person]} | {f"{name}-walk{n + 1}": walks[2 * person + n] for n in range(2 - person)}
    for name, recording in people.items():
        rng = np.random.default_rng([8, *name.encode()])
        film(
            tmp_path / name,
            simulate_blobs(rig, recording.positions, ImagingSettings(noise=0.0, merging=False), body=walker_capsules(recording), rng=rng)[
                0
            ],
            RATE,
        )
    return rig, people


def name_them(path: str, truth: Recording, names: str) -> None:
    """Who is who in a recording, as somebody who was there tells it."""
    recording = asterism.read(path)
    groups = group_tracklets(recording.clouds())
    numbered = name_groups(recording, groups, {g: f"group {g + 1}" for g in range(groups.frequent)})
    with Path(names).open("w", newline="", encoding="utf-8") as stream:
        rows = csv.writer(stream)
        rows.writerow(["group", "marker"])
        for number in range(1, groups.frequent + 1):
            track = numbered.positions[:, numbered.labels.index(f"group {number}")]
            away = np.nanmedian(np.linalg.norm(truth.positions - track[:, None], axis=2), axis=0)
            rows.writerow([number, truth.labels[int(np.argmin(away))]])


def test_every_command_of_the_page_works_and_labels_are_right(
    session: tuple[Rig, dict[str, Recording]], capsys: pytest.CaptureFixture[str]
) -> None:
    rig, people = session
    done = 0
    for words in commands():
        verb = words[0]
        if verb in NOT_HERE:
            continue
        if "--names" in words:
            name_them(words[1], people[words[1].removesuffix(".c3d")], words[3])
        if verb == "train":
            trained([asterism.read(words[1], markers="helen-hayes")], miner=None).save(Path("mine.model"))
            continue
        given = [f"{SIZE[0]}x{SIZE[1]}" if word == "1280x1024" else word for word in words]
        expanded = [path for word in given for path in (sorted(map(str, Path().glob(word))) if "*" in word else [word])]
        status, said = main(expanded), capsys.readouterr().err
        # a model of one person says so where it labels another one
        foreign = verb in ("label", "review") and "ben-walk1.c3d" in said and "label-foreign-recording" in said
        assert status == 0 or verb == "audit" or (status == 1 and foreign), f"{shlex.join(words)}: {said}"
        done += 1
    assert done == 23
    errors = compare_rigs(read_rig("rig.toml"), Rig(tuple(replace(camera, name=f"cam{c + 1}") for c, camera in enumerate(rig))))
    assert errors.position.max() < 0.01 and errors.world[0] < 0.01, "m"
    truth, labelled = people["ann-walk2"], asterism.read("ann-walk2.trc")
    places = np.stack([labelled.positions[:, labelled.labels.index(name)] for name in truth.labels], axis=1)
    miss = np.linalg.norm(places - truth.positions, axis=2)
    given_labels = np.isfinite(miss)
    assert given_labels.mean() > 0.8
    assert (miss[given_labels] < 0.02).mean() > 0.99
    assert np.median(miss[given_labels]) < 0.002
