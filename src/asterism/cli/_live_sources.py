"""What a live session was asked to read in; the source of its frames, open, out: an address, a recording, or cameras by their rig."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.cli._live_options import LiveOptions
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cameras import Rig
    from asterism.live import LiveSource


def open_live_source(options: LiveOptions) -> LiveSource:
    """The source that is asked for, open. Raises AsterismError where none or several are, or it cannot be opened."""
    from asterism.formats import is_recording_file
    from asterism.live import open_source
    from asterism.live.replay import Replay

    beside = next((word for word in options.source or [] if options.replay is not None and "://" in word), None)
    if beside is not None:
        raise AsterismError(f"{beside} and --replay are two sources; give one of them.")
    given = (bool(options.source) and options.replay is None, options.replay is not None, options.cameras is not None)
    if given.count(True) != 1:
        raise AsterismError(
            "give one source: an address such as udp://127.0.0.1:5000, a recording with --replay FILE, or cameras with --cameras FILE."
        )
    if options.replay is None and (options.loop or options.speed != 1.0):
        raise AsterismError("--speed and --loop are of recordings that are played; a camera system has its own time: leave them out.")
    if options.empty and options.cameras is None and len(played_files(options)) < 2:
        raise AsterismError("--empty is of images, in which lights are masked; leave it out, or give --cameras or several videos.")
    if options.stream is not None and (options.replay is None or options.rig is not None):
        raise AsterismError("--stream chooses among those of an XDF that is played; leave it out, or give --replay FILE.xdf.")
    if options.rig is not None:
        return _of_cameras(options, options.rig)
    several = played_files(options)[1:]
    if any(is_recording_file(path) for path in several):
        raise AsterismError(f"{several[0]}: one recording is played at a time; give it alone with --replay.")
    if options.cameras is not None or several:
        raise AsterismError("points are made of several cameras' images by their rig; add --rig FILE.")
    if options.replay is not None:
        if options.rate is not None:
            raise AsterismError(f"{options.replay} has its own rate, and --rate would change its times; play it faster with --speed.")
        try:
            return Replay(options.replay, speed=options.speed, loop=options.loop, stream=options.stream)
        except AsterismError as problem:
            if _is_of_cameras(options.replay):
                sentence = f"{options.replay} holds what cameras saw, and points are made of that by their rig; add --rig FILE"
                others = ", and the videos of the other cameras behind it" if _is_of_one_camera(options.replay) else ""
                raise AsterismError(f"{sentence}{others}.") from problem
            raise
    return open_source(_address(options), math.nan if options.rate is None else options.rate)


def played_files(options: LiveOptions) -> list[Path]:
    """What is to be played: the file of --replay, and those behind it."""
    return [] if options.replay is None else [options.replay, *(Path(word) for word in options.source or [])]


def cameras_beside(options: LiveOptions) -> Path | None:
    """Where it is written what was set on cameras, and what they had; None where none are set, or nothing is recorded."""
    return None if options.output is None or options.cameras is None else options.output.with_suffix(".cameras.toml")


def _address(options: LiveOptions) -> str:
    """The one address that is given."""
    first, *others = options.source or [""]
    if others:
        raise AsterismError(f"{others[0]}: give one source; several videos are played with --replay.")
    return first


def _of_cameras(options: LiveOptions, rig_file: Path) -> LiveSource:
    """Points of what several cameras see: of their blobs, or of images."""
    from asterism.cameras.files import read_rig
    from asterism.live.blobs import ReplayBlobs, RigProcess, RigSource
    from asterism.live.sources import blobs_of

    rig, played = read_rig(rig_file), played_files(options)
    if options.cameras is not None or len(played) > 1:
        return _of_images(options, rig, played)
    if played and _is_of_one_camera(played[0]):
        raise AsterismError(f"{played[0]} is of one camera, and points need two; add the videos of the others behind it.")
    if played:
        try:
            blobs = ReplayBlobs(played[0], rig.names, rate=options.rate, speed=options.speed, loop=options.loop)
        except AsterismError as problem:
            if _has_points(played[0]):
                raise AsterismError(f"{played[0]} holds points already, of which no rig is needed; leave --rig out.") from problem
            raise
        return RigSource(blobs, rig, waits=True, speed=options.speed)
    opened = blobs_of(_address(options), rig.names, math.nan if options.rate is None else options.rate)
    return RigProcess(opened, rig, keep=_kept_blobs(options))


def _of_images(options: LiveOptions, rig: Rig, played: list[Path]) -> LiveSource:
    """Points of images: of cameras, or of their videos."""
    _console.silence_opencv()
    from asterism.live.blobs import RigSource
    from asterism.live.cameras import load_cameras, with_settings
    from asterism.live.images import CameraWorkers, WorkerSettings, videos_together

    specs = videos_together(played, rig, options.speed, options.loop) if options.cameras is None else load_cameras(options.cameras)
    if options.rate is not None:
        specs = with_settings(specs, {"rate": options.rate})
    sizes = {camera.name: camera.size for camera in rig if camera.size is not None}
    settings = WorkerSettings(empty=options.empty, sizes=sizes, by_number=bool(played))
    try:
        workers = CameraWorkers(specs, settings, numbered_together=bool(played))
    except AsterismError as problem:
        # Of videos the problem names the file.
        raise AsterismError(f"{problem}" if options.cameras is None else f"{options.cameras}: {problem}") from problem
    beside = cameras_beside(options)
    try:
        if beside is not None:
            workers.save(beside)
        if played:
            return RigSource(workers, rig, waits=True, speed=options.speed)
        return RigSource(workers, rig, keep=_kept_blobs(options))
    except BaseException:
        workers.close()
        raise


def _is_of_one_camera(path: Path) -> bool:
    """Whether a path is a video or a folder of images."""
    from mimetypes import guess_type

    names = [each.name for each in path.iterdir()] if path.is_dir() else [path.name]
    return any(str(guess_type(name)[0]).startswith(("video/", "image/")) for name in names)


def _is_of_cameras(path: Path) -> bool:
    """Whether a file holds images or blobs."""
    from asterism.formats.blobs_2d import read_2d

    if _is_of_one_camera(path):
        return True
    try:
        read_2d(path)
    except AsterismError:
        return False
    return True


def _has_points(path: Path) -> bool:
    """Whether a file is a recording."""
    from asterism.formats import read

    try:
        read(path)
    except AsterismError:
        return False
    return True


def _kept_blobs(options: LiveOptions) -> Path | None:
    """Where blobs are kept beside what is recorded; a file that is there is overwritten only where that was asked for."""
    if options.output is None:
        return None
    from asterism.formats.kept_blobs import KEPT_SUFFIX

    kept = options.output.with_suffix(KEPT_SUFFIX)
    _console.check_new(kept, options.overwrite)
    kept.unlink(missing_ok=True)
    return kept
