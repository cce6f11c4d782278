"""A folder in; one small whole file of every kind that Asterism reads, and what reads it, out."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import asterism
from asterism.recording import Blobs, Event, MarkerSet, Recording
from asterism.simulation import simulate_walks

FRAMES, MARKERS = 24, ("LKNE", "LANK", "RKNE", "RANK", "SACR", "*1")


@dataclass(frozen=True)
class Specimen:
    """A whole file, as a damaged copy of it is read.

    kind   what is damaged, for the list of what was found
    name   of the file
    reads  calls of the library on the path of a copy
    packed whether it is a zip archive
    beside files that must stand beside it
    """

    kind: str
    name: str
    content: bytes
    reads: tuple[Callable[[Path], Any], ...]
    packed: bool = False
    beside: tuple[tuple[str, bytes], ...] = ()


def specimens(folder: Path, model: bool = True) -> list[Specimen]:
    """All of them, written into a folder; with `model` also a model, whose training takes some seconds."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    found = [*_recordings(folder), *_tables(folder), *_rigs(folder), *_texts(folder), *_images(folder)]
    return found + ([_model(folder)] if model else [])


def _specimen(path: Path, kind: str, *reads: Callable[[Path], Any], packed: bool = False) -> Specimen:
    for read in reads:
        read(path)
    return Specimen(kind, path.name, path.read_bytes(), reads, packed)


def _walk() -> Recording:
    rng = np.random.default_rng(0)
    places = rng.normal([0.0, 0.0, 1.0], 0.3, (1, len(MARKERS), 3))
    positions = places + np.linspace(0.0, 1.0, FRAMES)[:, None, None] * [1.0, 0.2, 0.0] + rng.normal(0.0, 0.01, (FRAMES, len(MARKERS), 3))
    positions[5:9, 1] = np.nan
    events = (Event("Foot Strike", 0.05, "Left"), Event("Foot Off", 0.1, "Right"))
    return Recording(positions, MARKERS, 100.0, events=events)


def _read_recording(path: Path) -> None:
    asterism.read(path)


def _describe(path: Path) -> None:
    asterism.formats.describe(path)


def _with_markers(path: Path) -> None:
    asterism.read(path, markers=["LKNE", "LANK"])


def _recordings(folder: Path) -> list[Specimen]:
    walk, found = _walk(), []
    reads = (_read_recording, _describe, _with_markers)
    for suffix in ("c3d", "trc", "csv", "long.csv", "tsv", "mat", "mot", "sto", "npz"):
        path = folder / f"walk.{suffix}"
        asterism.write(path, walk)
        found.append(_specimen(path, suffix, *reads, packed=suffix == "npz"))
    clouds = walk.clouds()
    for suffix in ("npz", "csv"):
        path = folder / f"clouds.{suffix}"
        asterism.write(path, clouds)
        found.append(_specimen(path, f"clouds {suffix}", asterism.formats.read_clouds, _describe, packed=suffix == "npz"))
    motive, nexus = folder / "motive.csv", folder / "nexus.csv"
    motive.write_text(_motive(walk), encoding="utf-8")
    nexus.write_text(_nexus(walk), encoding="utf-8")
    return [*found, _specimen(motive, "Motive CSV", *reads), _specimen(nexus, "Nexus CSV", *reads)]


def _cells(values: Any) -> str:
    return ",".join("" if value != value else f"{value:.5f}" for value in values)


def _motive(walk: Recording) -> str:
    columns = [label for label in walk.labels for _ in range(3)]
    head = [
        "Format Version,1.23,Take Name,walk,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Total Exported Frames,"
        f"{len(walk)},Length Units,Meters",
        "",
        ",".join(["", "", *["Marker"] * len(columns)]),
        ",".join(["", "", *columns]),
        ",".join(["", "", *[str(i) for i in range(len(columns))]]),
        ",".join(["", "", *["Position"] * len(columns)]),
        ",".join(["Frame", "Time", *"XYZ" * len(walk.labels)]),
    ]
    return "\n".join([*head, *(f"{i},{i / 100:.4f},{_cells(row.ravel())}" for i, row in enumerate(walk.positions))]) + "\n"


def _nexus(walk: Recording) -> str:
    head = ["Trajectories", "100", ",".join(["", "", *(f"Ann:{label},," for label in walk.labels)])]
    head += [",".join(["Frame", "Sub Frame", *["X,Y,Z"] * len(walk.labels)]), ",".join(["", "", *["mm,mm,mm"] * len(walk.labels)])]
    return "\n".join([*head, *(f"{i + 1},0,{_cells(1000 * row.ravel())}" for i, row in enumerate(walk.positions))]) + "\n"


def _tables(folder: Path) -> list[Specimen]:
    from asterism.detection.times import read_times
    from asterism.formats import TimeSeriesTable, read_blobs, read_table, write_blobs, write_table

    rng = np.random.default_rng(1)
    angles = folder / "angles.sto"
    write_table(
        angles, TimeSeriesTable(("hip", "knee"), rng.normal(0, 20, (FRAMES, 2)), np.arange(FRAMES) / 100, title="angles", in_degrees=True)
    )
    frame, camera = np.divmod(np.arange(2 * FRAMES), 2)
    blobs, times = folder / "2d.csv", folder / "times.csv"
    write_blobs(Blobs.from_rows(frame, camera, rng.uniform(0, 500, (2 * FRAMES, 2)), ("left", "right"), rate=50.0), blobs)
    times.write_text("camera,frame,time\n" + "".join(f"{c},{f},{f / 50:.3f}\n" for f, c in zip(frame, camera, strict=True)))
    return [
        _specimen(angles, "table", read_table, _describe),
        _specimen(blobs, "2D CSV", read_blobs, _describe),
        _specimen(times, "frame times", read_times),
    ]


def _rigs(folder: Path) -> list[Specimen]:
    from asterism.cameras.files import describe_rig, read_rig, write_rig
    from asterism.simulation.cameras import ring_rig

    def read(path: Path) -> None:
        describe_rig(read_rig(path))

    rig = ring_rig(2)
    found = []
    for name in ("rig.toml", "anipose.toml", "camera_array.toml", "rig.yml", "rig.xml", "rig.xcp", "rig.qca.txt"):
        path = folder / name
        write_rig(rig, path)
        found.append(_specimen(path, f"rig {name}", read))
    lens = {"calibration_matrix": [[1000, 0, 500], [0, 1000, 500], [0, 0, 1]], "distortion": [0.1, 0, 0, 0, 0]}
    pose = {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [[1.0], [2.0], [3000.0]]}
    human, shelf = folder / "human.json", folder / "shelf.json"
    human.write_text(json.dumps({"intrinsics": {"1": lens}, "extrinsics": {"S1": {"1": pose}, "S5": {"1": pose}}}))
    flat = {"fx": 1000, "fy": 1000, "cx": 500, "cy": 400, "k": [0.1, 0, 0], "p": [0, 0], "R": pose["R"], "T": [1, 2, 3000]}
    shelf.write_text(json.dumps({"0": flat, "1": flat}))
    found += [_specimen(human, "rig Human3.6M", read), _specimen(shelf, "rig Shelf", read)]
    return [*found, *_openptv(folder, rig, read)]


def _openptv(folder: Path, rig: Any, read: Callable[[Path], Any]) -> list[Specimen]:
    """The orientation of a camera, its lens, and the parameters, each damaged beside the other two, which are whole."""
    from asterism.cameras.files import write_rig

    place = folder / "openptv"
    place.mkdir(exist_ok=True)
    write_rig(rig, place / "rig.ori")
    names = sorted(path.relative_to(place).as_posix() for path in place.rglob("*") if path.is_file())
    first = next(name for name in names if name.endswith(".ori"))
    chosen = [first, first.removesuffix(".ori") + ".addpar", "parameters/ptv.par"]
    whole = {name: (place / name).read_bytes() for name in chosen}

    def read_first(path: Path) -> None:
        read(path if path.suffix == ".ori" else path.parent.parent / first if path.suffix == ".par" else path.parent / first)

    return [
        Specimen(f"rig {Path(name).suffix}", name, whole[name], (read_first,), beside=tuple((n, whole[n]) for n in chosen if n != name))
        for name in chosen
    ]


def _texts(folder: Path) -> list[Specimen]:
    from asterism.calibration.boards import Board

    sets, own, peer = folder / "set.toml", folder / "board.toml", folder / "charuco.toml"
    sets.write_text(
        'title = "Legs"\nmarkers = ["LKNE", "LANK", "RKNE", "RANK"]\npairs = [["LKNE", "RKNE"], ["LANK", "RANK"]]\n\n'
        '[aliases]\nLKNE = ["L.Knee", "left_knee"]\n\n[segments]\nleft = ["LKNE", "LANK"]\n'
    )
    own.write_text('kind = "charuco"\ncolumns = 5\nrows = 7\nsquare = 0.03\ndictionary = "DICT_4X4_50"\nmarker = 0.02\n')
    peer.write_text('columns = 4\nrows = 5\nboard_height = 11.0\nboard_width = 8.5\ndictionary = "DICT_4X4_50"\nunits = "inch"\n')

    def points(path: Path) -> None:
        _ = Board.from_toml(path).points

    return [_specimen(sets, "marker set", MarkerSet.load), _specimen(own, "board", points), _specimen(peer, "board of caliscope", points)]


def _images(folder: Path) -> list[Specimen]:
    import cv2

    from asterism.detection.sources import images, open_source, some_images

    def read(path: Path) -> None:
        source = open_source(path)
        some_images(source, 3)
        for place, _ in images(source):
            if place > 30:
                break

    image = np.zeros((40, 60), np.uint8)
    cv2.circle(image, (20, 15), 4, 255, -1)
    found = []
    for suffix in ("png", "jpg", "bmp", "pgm", "tif", "webp", "jp2"):
        path = folder / f"image.{suffix}"
        cv2.imwrite(str(path), image)
        found.append(_specimen(path, f"image {suffix}", read))
    pages = folder / "pages.tif"
    cv2.imwritemulti(str(pages), [image, image.T.copy(), image])
    found.append(_specimen(pages, "image pages", read))
    for suffix, code in (("avi", "MJPG"), ("mp4", "mp4v"), ("mkv", "MJPG")):
        path = folder / f"film.{suffix}"
        film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), 25.0, (64, 48))
        for shift in range(6):
            film.write(np.full((48, 64, 3), 20 * shift, np.uint8))
        film.release()
        found.append(_specimen(path, f"film {suffix}", read))
    return found


def _model(folder: Path) -> Specimen:
    from asterism.labelling import TrainingRules
    from asterism.labelling.training.trials import TrainingTrial

    path = folder / "walks.model"
    walks = simulate_walks(subjects=3, frames=60, rate=50.0)
    rules = TrainingRules(
        virtual_people=0,
        trial_frames=8,
        folds=2,
        trials=(TrainingTrial(),),
        time_trials=(TrainingTrial(0.2),),
        stretches=1,
        stretch_frames=30,
    )
    asterism.MarkerModel.fit(walks, seed=0, miner=None, training=rules).save(path)
    clouds = walks[0].frames(slice(0, 3)).clouds()

    def label(copy: Path) -> None:
        asterism.MarkerModel.load(copy).label(clouds)

    return _specimen(path, "model", label, packed=True)


def place_beside(specimen: Specimen, folder: Path) -> Path:
    """Where a damaged copy goes, with the whole files that it needs beside it."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, content in specimen.beside:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    path = folder / specimen.name
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
