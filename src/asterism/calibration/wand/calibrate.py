"""Wand calibration from nothing: blobs, image sizes and wand lengths in; a rig, what it was made of and whether to trust it out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from asterism.calibration.wand.adjustment import adjusted, inner_place
from asterism.calibration.wand.checks import Finding, judge
from asterism.calibration.wand.clock import common_clock
from asterism.calibration.wand.drift import lost_shares
from asterism.calibration.wand.identify import Wand, identify, wand_of
from asterism.calibration.wand.initialise import cold_start
from asterism.calibration.wand.inputs import check_distance, check_found, lenses_of, why_no_start, why_not
from asterism.calibration.wand.synchronise import in_step
from asterism.calibration.wand.world import default_world
from asterism.cameras.bundle import Sightings, locate
from asterism.cameras.rig import Rig
from asterism.detection.static_lights import without_static_lights
from asterism.errors import AsterismError
from asterism.progress import Progress
from asterism.recording import Blobs, Floats, Ints


@dataclass(frozen=True)
class WandCalibration:
    """A rig from a waved wand, and what speaks for and against it.

    rig           the cameras that could be calibrated; its world is level by the cameras' own sense of up until a floor is given
    wand          what was waved
    frames        how many the recording has
    sightings     the wand's markers in the images that were used: frames are those of the recording (of the common clock, where
                  cameras were not triggered together), cameras are places in the rig
    residuals     (n, 2) px, seen minus projected, per sighting
    positions     (m, K, 3) m, the markers of the wand in `used`, each triangulated by itself, without knowing the wand; NaN where only
                  one camera saw it
    used          (m,) the frames that were used
    sigma         (C, 15) standard deviation of each camera's parameters, see `bundle.PARAMETERS`
    place_sigma   (C,) m, of where it stands, relative to all cameras
    noise         px, standard deviation of one coordinate of a blob
    late          (C,) by how many frames each camera started late; its images were moved by as many
    lost          (C,) share of each camera's images of the wand that did not fit those of the others and were left out
    lost_parts    (C, 10) the same of each tenth of the recording; NaN where it hardly shows the wand
    lights        (C,) how many lights of each camera never moved; they were left out
    inner         m, where the inner one of three markers sits by all images that show it, used or not; NaN for other wands
    left_out      cameras that could not be calibrated, with the reason
    findings      what to know before using the rig, gravest first
    """

    rig: Rig
    wand: Wand
    frames: int
    sightings: Sightings
    residuals: Floats
    positions: Floats
    used: Ints
    sigma: Floats
    place_sigma: Floats
    noise: float
    late: Ints
    lost: Floats
    lost_parts: Floats
    lights: Ints
    inner: float
    left_out: Mapping[str, str]
    findings: tuple[Finding, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether nothing speaks against using the rig."""
        return not any(finding.grave for finding in self.findings)

    @property
    def lengths(self) -> Floats:
        """(m,) m, the whole wand as measured in each frame without knowing it; NaN where an end was seen by fewer than two cameras."""
        return np.asarray(np.linalg.norm(self.positions[:, -1] - self.positions[:, 0], axis=1), dtype=np.float64)

    @property
    def rejected(self) -> float:
        """The mean share of the wand's images that did not fit and were left out."""
        return float(self.lost.mean())

    @property
    def rms(self) -> float:
        """px, the reprojection error: root of the mean squared distance."""
        return float(np.sqrt(np.square(self.residuals).sum(axis=1).mean()))

    def moved(self, rig: Rig, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> WandCalibration:
        """The same in another world frame, of which `rig` is the rig: X becomes scale rotation X + translation (3,) m."""
        positions = scale * self.positions @ np.asarray(rotation).T + np.asarray(translation)
        findings = tuple(finding for finding in self.findings if not finding.of_world and (scale == 1.0 or not finding.of_scale))
        return replace(self, rig=rig, positions=positions, place_sigma=scale * self.place_sigma, findings=findings)


def calibrate_wand(
    blobs: Blobs,
    lengths: ArrayLike,
    *,
    sizes: Mapping[str, tuple[int, int]] | tuple[int, int] | None = None,
    known: Rig | None = None,
    distance: tuple[str, str, float] | None = None,
    progress: Progress | None = None,
) -> WandCalibration:
    """Calibrate cameras by a waved wand (thesis 3.3, eq. 3.10), from nothing but image sizes and its lengths.

    blobs     what the cameras saw of the wand, strays among it; `blobs.times` where they are not triggered together
    lengths   m, the places of three or two markers along the wand; one number for a single moved marker
    sizes     (width, height) px of the images, one for all or by camera name; not needed where `known` has them
    known     a rig whose lenses are known, more or less: they are where it begins; poses are not used
    distance  two cameras' names and the metres between them: the scale, where a single marker was moved

    Returns a `WandCalibration`; ask its `usable` and `findings` before using its rig. Deterministic. Raises AsterismError where lengths or
    sizes make no sense, and where no two cameras can be posed at all.
    """
    wand = wand_of(lengths)
    told = progress or (lambda fraction, doing: None)
    lenses, extents = lenses_of(blobs, sizes, known)
    if len(blobs.cameras) < 2:
        raise AsterismError("a wand is seen by one camera only; calibration needs two that look at the same place.")
    if len(wand.lengths) == 1 and distance is not None:
        check_distance(blobs.cameras, distance)
    told(0.0, "looking for the wand")
    blobs, lights = without_static_lights(blobs)
    chosen = identify(blobs, wand)
    check_found(blobs, chosen, wand, lights)
    frames = len(blobs)
    blobs, chosen = common_clock(blobs, chosen, wand)
    told(0.1, "posing cameras")
    start = cold_start(blobs, chosen, wand, extents, lenses, progress)
    if start is None:
        raise AsterismError(why_no_start(blobs, chosen, wand))
    cameras = list(start.cameras)
    told(0.6, "comparing clocks")
    blobs, chosen, cameras, clocks = in_step(blobs, chosen, wand, cameras, lenses, extents)
    told(0.7, "adjusting")
    result, sightings, used, offered = adjusted(blobs, chosen, wand, cameras, lenses, start.noise)
    posed = np.array([c for c, camera in enumerate(cameras) if camera is not None])
    told(0.9, "measuring the wand")
    positions = locate(result.cameras, sightings, len(used), len(wand.lengths))
    left_out = {
        blobs.cameras[c]: why_not(blobs, chosen, wand, cameras, c, lenses[c] is not None) for c in range(len(cameras)) if c not in posed
    }
    sightings = replace(sightings, frame=used[sightings.frame])
    made = WandCalibration(
        Rig(result.cameras), wand, frames, sightings, result.residuals, positions, used,
        result.sigma, result.place_sigma, result.noise, clocks.late[posed],
        *lost_shares(chosen[offered][:, posed], offered, sightings, len(blobs)),
        lights[posed], inner_place(blobs, chosen[used][:, posed], wand, result.cameras, positions), left_out,
    )  # fmt: skip
    if len(wand.lengths) == 1 and distance is not None:
        here = np.linalg.norm(made.rig[distance[0]].position - made.rig[distance[1]].position)
        scale = distance[2] / float(here)
        made = made.moved(made.rig.moved(np.eye(3), np.zeros(3), scale), np.eye(3), np.zeros(3), scale)
    turn, shift = default_world(made.rig, made.positions)
    made = made.moved(made.rig.moved(turn, shift), turn, shift)
    made = replace(made, findings=judge(made, clocks.of(posed), scaled=distance is not None))
    told(1.0, "done")
    return replace(made, rig=replace(made.rig, metadata=_about(made)))


def _about(made: WandCalibration) -> dict[str, object]:
    finite = made.lengths[np.isfinite(made.lengths)]
    return {
        "calibrated_by": "wand",
        "wand_m": [float(length) for length in made.wand.lengths],
        "frames": made.frames,
        "frames_used": len(made.used),
        "reprojection_rms_px": round(made.rms, 4),
        "noise_px": round(made.noise, 4),
        "wand_length_mean_m": round(float(finite.mean()), 6) if len(finite) else None,
        "wand_length_std_m": round(float(finite.std()), 6) if len(finite) else None,
        "usable": made.usable,
        "world": "level by the cameras' own sense of up, origin below the middle of the waved volume",
    }
