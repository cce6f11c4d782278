"""`asterism demo garment`: a suit is designed, worn, photographed, read and captured, and compared with where its circles were."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.cli import _console
from asterism.cli._criteria import criterion_row, missed_criteria, print_criteria
from asterism.findings import exit_status

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from asterism.garment.capture import Reader
    from asterism.report.garment import Picture
    from asterism.simulation.garment.pipeline import GarmentResult, Views
    from asterism.simulation.garment.session import GarmentSession

_POSES, _FRAMES = 24, 6
_TARGET_ROWS, _TARGET_COLUMNS, _TARGET_PITCH, _TARGET_DIAMETER = 9, 12, 0.068, 0.038
_QUALITY = 95
_WORKERS = 2


def demo_garment(output: Path, seed: int, json: str | None) -> int:
    """Run it, print the table, leave the files. Returns the exit status: 0 where every criterion is met, else 1."""
    _console.check_new(json, overwrite=True)
    output.mkdir(parents=True, exist_ok=True)
    say = _console.result if json != "-" else _console.error
    started = time.perf_counter()
    session = _session(seed)
    suit, sheet = session.worn.pattern, session.target.pattern
    files = {"garment": suit.save(output / "suit.toml"), "target": sheet.save(output / "target.toml")}
    say(
        f"Designed a suit of {len(suit.known):,} coded circles in {len(suit.pieces)} pieces, and a calibration target; photographing "
        f"{_POSES} poses of the target and {_FRAMES} frames of a walker with {len(session.rig)} cameras ..."
    )
    views = _photograph(session, output)
    say("Reading, calibrating, capturing ...")
    result, pictures = _run(session, output, views)
    seconds = time.perf_counter() - started
    files |= _written(output, session, result, pictures)
    criteria = result.criteria()
    if json != "-":
        print_criteria(criteria, seconds)
    say(f"Look at {files['report']} and {files['rig_report']} in a browser, and at {files['surface']} in any 3D viewer. The same by hand:")
    say(f"  asterism garment calibrate {output / 'target'} --target {files['target']} -o {output / 'my-rig.toml'}")
    say(f"  asterism garment capture {output / 'walk'} --rig {files['rig']} --garment {files['garment']} -o {output / 'my-dense.npz'}")
    findings = missed_criteria(criteria)
    for finding in findings:
        _console.report(finding)
    content = {
        "criteria": [{**vars(criterion), "met": criterion.met} for criterion in criteria],
        **result.facts(),
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(json, {"command": "demo garment", "seed": seed, "seconds": seconds, **content, **files})
    return exit_status(findings)


def _session(seed: int) -> GarmentSession:
    """The suit of a walker, the target, and the cameras that see both."""
    from asterism.garment.design import design_pattern
    from asterism.simulation.garment import Wearer, suit_masks
    from asterism.simulation.garment.session import simulate_garment_session

    # the cloth is cut for the wearer, so that the person comes first
    wearer = Wearer(seed=seed)
    suit = design_pattern(suit_masks(wearer), seed=seed)
    # another seed: suit and target must not share a code
    sheet = design_pattern((_TARGET_ROWS, _TARGET_COLUMNS), seed=seed + 1, size=(_TARGET_PITCH, _TARGET_DIAMETER))
    return simulate_garment_session(suit, sheet, wearer, seed, poses=_POSES)


def _photograph(session: GarmentSession, output: Path) -> Views:
    """Take all pictures, as files in a folder for each camera."""
    from asterism.simulation.garment.pipeline import Views

    views = Views()
    with _console.progress("photographing") as progress:
        parts = (("target", session.calibration(_WORKERS), _POSES), ("walk", session.film(_FRAMES, _WORKERS, views.add), _FRAMES))
        for name, moments, count in parts:
            folders = [output / name / camera for camera in session.rig.names]
            for folder in folders:
                folder.mkdir(parents=True, exist_ok=True)
                # pictures of an earlier demo would be read as further frames
                for old in folder.glob("*.jpg"):
                    old.unlink()
            for t, images in moments:
                for folder, image in zip(folders, images, strict=True):
                    if image is not None:
                        _write_picture(folder / f"{t:04d}.jpg", image)
                if progress is not None:
                    progress((t + 1) / count, f"{name}, {t + 1} of {count}")
    return views


def _write_picture(path: Path, image: NDArray[np.uint8]) -> None:
    import cv2

    from asterism.files.atomic import write_atomically

    # JPEG halves the resolution of colour unless told otherwise, and colours are the code
    whole_colour = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
    write_atomically(path, cv2.imencode(".jpg", image, whole_colour)[1].tobytes())


def _run(session: GarmentSession, output: Path, views: Views) -> tuple[GarmentResult, list[Picture]]:
    """Read the files as the commands do, and compare with the truth."""
    from asterism.garment.footage import colour_footage
    from asterism.garment.read import read_image
    from asterism.report.garment import Picture
    from asterism.simulation.garment.pipeline import run_garment_session

    patterns = {"target": session.target.pattern, "suit": session.worn.pattern}

    def readers(which: str) -> Reader:
        return lambda image: read_image(image, patterns[which])

    # from the files, as the commands have them: what writing loses counts
    target, film = colour_footage([output / "target"]), colour_footage([output / "walk"], session.rig)
    with _console.progress("working") as progress:
        result = run_garment_session(session, target, film, views, readers, frames=_FRAMES, workers=_WORKERS, progress=progress)
    _, images = next(iter(film))
    # cameras that do not see the walker yet have no picture of the frame
    first = next(image for image in images if image is not None)
    _, shown = next(_first_with_images(target))
    pictures = [
        Picture(f"What camera {session.rig.names[0]} saw in the first frame", first, read_image(first, patterns["suit"])),
        Picture("A view of the calibration target", shown, read_image(shown, patterns["target"])),
    ]
    return result, pictures


def _first_with_images(moments: Iterable[tuple[int, list[NDArray[np.uint8] | None]]]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    for number, images in moments:
        for image in images:
            if image is not None:
                yield number, image


def _written(output: Path, session: GarmentSession, result: GarmentResult, pictures: list[Picture]) -> dict[str, Path]:
    """Everything as files, those of an earlier demo replaced."""
    from asterism.cameras.files import write_rig
    from asterism.garment.surface import surface, write_surface
    from asterism.report import board_report
    from asterism.report.garment import garment_report
    from asterism.report.page import Cell, Table

    # the true rig stands beside the one that was found, for whoever wants to compare
    files = {key: output / name for key, name in (("rig", "rig.toml"), ("true_rig", "true-rig.toml"), ("rig_report", "rig.html"))}
    files |= {"dense": output / "dense.npz", "surface": output / "frame-0000.ply", "report": output / "report.html"}
    write_rig(session.rig, files["true_rig"])
    write_rig(result.calibration.rig, files["rig"])
    board_report(files["rig_report"], result.calibration, settings={"target": "target.toml"})
    made, pattern = result.captured, session.worn.pattern
    made.trajectories.save(files["dense"])
    write_surface(files["surface"], surface(made.trajectories.points(0), pattern), pattern)
    rows: list[list[str | Cell]] = [
        [name, value, limit, Cell(kept, 0.0 if kept == "kept" else 1.0, "bad")]
        for name, value, limit, kept in map(criterion_row, result.criteria())
    ]
    table = Table(["", "measured", "promised", ""], rows)
    settings: dict[str, Any] = {"garment": "suit.toml", "rig": "rig.toml", "cameras": len(session.rig), "seed": session.seed}
    garment_report(files["report"], made, pattern, result.calibration.rig, pictures=pictures, criteria=table, settings=settings)
    return files
