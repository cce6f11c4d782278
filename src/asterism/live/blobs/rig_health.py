"""What is known of each camera of a rig while it runs in; how it does, and what a person should know of it, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from asterism.findings import Finding, Severity
from asterism.live.blobs.gathering.arrivals import FEWEST, CameraArrivals
from asterism.reconstruction.camera_fit import CameraFit
from asterism.recording.display import counted, how_often, listed, significant

_AWAY_TOLD = ("live-camera-silent", "live-camera-not-opened", "live-camera-size", "live-camera-ended", "live-camera-reopened")
"""Why a source says itself that a camera gave nothing for a while: that it fell silent is the same, and is not told again."""
_NOT_COME = (*_AWAY_TOLD, "live-camera-lost", "live-camera-dropped")
"""What it says itself of images that did not come."""


@dataclass(frozen=True)
class RigCameraHealth:
    """How one camera does.

    name                  in the rig
    received, lost, late  images that came, never came by their numbers, and came when their frame had gone on
    repeated              images that came twice or after a later one, by their numbers
    untimed               images whose time is not after that of the one before
    without               frames that went on without it
    unlinked              blobs that could not be followed to the instant of a frame
    times_away, away      how often it fell silent, and whether it is silent now
    jumps                 times that its clock was set
    offset, offset_sd     s, its clock against this machine's, its fastest way here included
    drift_ppm, drift_sd_ppm  by how many millionths this machine's clock is faster
    wait                  s that a frame waits for it at most
    seen                  the share of the others' points in its image that it shows; NaN where unknown
    systematic            px by which its whole image is off; NaN where unknown
    """

    name: str
    received: int
    lost: int
    late: int
    repeated: int
    untimed: int
    without: int
    unlinked: int
    times_away: int
    away: bool
    jumps: int
    offset: float
    offset_sd: float
    drift_ppm: float
    drift_sd_ppm: float
    wait: float
    seen: float
    systematic: float


def health_of(name: str, state: CameraArrivals, fit: CameraFit) -> RigCameraHealth:
    """How a camera does, by its images as they came and by how they fit those of the others."""
    count, clock = state.count, state.clock
    return RigCameraHealth(
        name=name,
        received=count.received,
        lost=count.lost,
        late=count.late + state.late + state.untimed,
        repeated=count.late,
        untimed=state.untimed,
        without=state.without,
        unlinked=state.unlinked,
        times_away=state.times_away,
        away=state.away,
        jumps=clock.jumps,
        offset=clock.offset(clock.last_time),
        offset_sd=clock.offset_sd(clock.last_time),
        drift_ppm=clock.drift_ppm,
        drift_sd_ppm=clock.drift_sd_ppm,
        wait=state.wait,
        seen=fit.seen,
        systematic=fit.systematic,
    )


def rig_camera_findings(
    cameras: Sequence[RigCameraHealth], expected: Sequence[str], own: Sequence[Finding], *, busy: bool
) -> list[Finding]:
    """What was counted of cameras, but for those whose images or silence their source tells itself.

    expected  names of the cameras that should send
    own       what the source says itself
    busy      whether images were lost in this machine
    """
    found, warning = list[Finding](), Severity.WARNING
    # What a camera or its process left out never came either, and is told once, by who knows why.
    told = {finding.where for finding in own if finding.code in _NOT_COME}
    away = {finding.where for finding in own if finding.code in _AWAY_TOLD}
    cable = "Close other programs, or lower the rate." if busy else "Look at cables and at the network, or lower the rate."
    # Those too of which the source does not know.
    known = {*told, *(camera.name for camera in cameras if camera.received)}
    silent = [name for name in expected if name not in known]
    if silent:
        mend = "Look whether it is switched on, and whether it has this name in the rig."
        found.append(Finding("live-camera-silent", warning, listed(silent), f"camera {listed(silent)} sent nothing.", mend))
    unlike = {camera.name for camera in cameras if _numbers_are_none(camera) or _times_are_none(camera)}
    cameras = [camera for camera in cameras if camera.name not in unlike]
    totals = [(camera, camera.received + camera.lost) for camera in cameras]
    if lost := _shares([(camera.name, camera.lost, total) for camera, total in totals if camera.name not in told]):
        where, said = lost
        found.append(Finding("live-camera-lost", warning, where, f"images never arrived: {said}.", cable))
    if late := _shares([(camera.name, camera.late, total) for camera, total in totals]):
        where, said = late
        found.append(Finding("live-camera-late", warning, where, f"images came too late for their frame: {said}.", cable))
    for camera in cameras:
        where = camera.name
        if camera.times_away and where not in away and where not in silent:
            sentence = f"camera {where} fell silent {how_often(camera.times_away)}{', and is silent now' if camera.away else ''}."
            found.append(Finding("live-camera-away", warning, where, sentence, "Look at its cable; frames went on without it."))
        if camera.jumps:
            sentence = f"camera {where}: its clock was set {how_often(camera.jumps)}."
            found.append(Finding("live-camera-clock", Severity.NOTE, where, sentence, "It takes part again after 20 images."))
    return found


def stamp_findings(cameras: Sequence[RigCameraHealth]) -> list[Finding]:
    """Cameras whose images have numbers or times that are none: nothing is made of them, and no network or clock can have done it."""
    found = list[Finding]()
    if some := [camera for camera in cameras if _numbers_are_none(camera)]:
        names, count = listed([camera.name for camera in some]), sum(camera.repeated for camera in some)
        sentence = f"camera {names}: {counted(count, 'image')} with the number of an earlier one: not used."
        mend = "Number each image of a camera one higher than the last, and give each camera a name of its own."
        found.append(Finding("live-camera-stamps", Severity.WARNING, names, sentence, mend))
    if some := [camera for camera in cameras if _times_are_none(camera)]:
        names = listed([camera.name for camera in some])
        sentence = f"camera {names}: the times of its images do not go as a clock does."
        found.append(Finding("live-camera-stamps", Severity.WARNING, names, sentence, "Send times in seconds, of when an image is taken."))
    return found


def _numbers_are_none(camera: RigCameraHealth) -> bool:
    return camera.repeated > FEWEST and 2 * camera.repeated > camera.received


def _times_are_none(camera: RigCameraHealth) -> bool:
    return camera.received > FEWEST and 2 * max(camera.untimed, camera.jumps) > camera.received


def _shares(counts: Sequence[tuple[str, int, int]]) -> tuple[str, str] | None:
    """The cameras (name, how many, of how many) that have some, and what is said of them; None where none has."""
    some = [(name, count, total) for name, count, total in counts if count]
    if not some:
        return None
    names = listed([name for name, _, _ in some])
    return names, listed([f"{count} of camera {name} ({significant(100 * count / total, 2)} %)" for name, count, total in some])
