"""A recording with the markers of a gait laboratory in; anatomical frames of pelvis, thigh and shank out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.motion.rigid.rotations import unit_vectors
from asterism.recording import Floats, Recording

HIP_SHARES = (-0.22, -0.30, 0.14)
"""Of the distance between the anterior iliac spines: the hip joint centre behind, below and medial of the spine (Bell et al. 1990)."""
MARKER_RADIUS = 0.007


@dataclass(frozen=True)
class AnatomicalFrames:
    """Axes x forward, y up, z to the right (ISB; Wu et al. 2002), as columns in the world, NaN where markers are missing.

    pelvis, thigh, shank  (T, 3, 3); hip, knee, ankle (T, 3) m, joint centres
    """

    pelvis: Floats
    thigh: Floats
    shank: Floats
    hip: Floats
    knee: Floats
    ankle: Floats


def leg_frames(recording: Recording, side: str = "L", *, knee_width: float = 0.10, ankle_width: float = 0.07) -> AnatomicalFrames:
    """Anatomical frames of one leg from the markers of Helen Hayes or Plug-in-Gait: ASIS, sacrum (or PSIS), THI, KNE, TIB, ANK.

    side "L" or "R"; knee_width, ankle_width m. The hip centre is Bell's (1990); knee and ankle centres lie half a joint's width and a
    marker's radius medial of their markers, in the plane of the wand (Davis et al. 1991; Kadaba et al. 1990). Wands that are turned
    about the limb turn the frame with them: offsets of rotation are the laboratory's, as in Plug-in-Gait. NaN where a marker is missing,
    and where markers in one place or in a line leave the axes open.
    Raises AsterismError where the recording lacks a marker, or the side is neither L nor R.
    """
    if side not in ("L", "R"):
        raise AsterismError(f"{side} is no side; give L or R.")
    right = 1.0 if side == "R" else -1.0
    of_leg = {name: _marker(recording, f"{side}{name}") for name in ("THI", "KNE", "TIB", "ANK")}
    spines = [_marker(recording, name) for name in ("LASI", "RASI")]
    back = np.mean([_marker(recording, name) for name in sacrum_markers(recording)], axis=0)
    z = unit_vectors(spines[1] - spines[0])
    front = (spines[0] + spines[1]) / 2
    y = unit_vectors(np.cross(z, front - back))
    pelvis = np.stack([np.cross(y, z), y, z], axis=2)
    widths = np.linalg.norm(spines[1] - spines[0], axis=1)
    # One width for the whole recording: the pelvis does not change, a noisy frame would move the hip.
    width = float(np.median(widths[np.isfinite(widths)])) if np.isfinite(widths).any() else np.nan
    spine = spines[1] if side == "R" else spines[0]
    shares = np.array([HIP_SHARES[0], HIP_SHARES[1], -right * HIP_SHARES[2]])
    # Bell's shares, from the spine of the same side.
    hip = spine + width * pelvis @ shares
    knee = _chord(hip, of_leg["KNE"], of_leg["THI"], knee_width / 2 + MARKER_RADIUS)
    ankle = _chord(knee, of_leg["ANK"], of_leg["TIB"], ankle_width / 2 + MARKER_RADIUS)
    thigh, shank = _segment(hip, knee, of_leg["KNE"], right), _segment(knee, ankle, of_leg["ANK"], right)
    return AnatomicalFrames(pelvis, thigh, shank, hip, knee, ankle)


def _marker(recording: Recording, name: str) -> Floats:
    if name not in recording.labels:
        raise AsterismError(f"{recording.metadata.get('file', 'the recording')} has no marker {name}, which the leg's axes need.")
    return recording.positions[:, recording.labels.index(name)]


def sacrum_markers(recording: Recording) -> tuple[str, ...]:
    """The markers whose mean is the sacrum: SACR; or LPSI and RPSI, where there is no SACR, or it is never seen."""
    labels = recording.labels
    seen = "SACR" in labels and bool(recording.visible[:, labels.index("SACR")].any())
    if seen or "LPSI" not in labels or ("SACR" in labels and "RPSI" not in labels):
        return ("SACR",)
    return ("LPSI", "RPSI")


def _chord(upper: Floats, marker: Floats, wand: Floats, offset: float) -> Floats:
    """(T, 3) m: the joint centre in the plane of upper joint, marker and wand, `offset` medial of the marker, where upper joint, centre and
    marker make a right angle (the chord function of Davis et al. 1991)."""
    length = np.linalg.norm(marker - upper, axis=1, keepdims=True)
    along = unit_vectors(marker - upper)
    lateral = wand - upper
    lateral = unit_vectors(lateral - np.einsum("ti,ti->t", lateral, along)[:, None] * along)
    # A joint nearer than its own half width would have no such triangle; nine tenths still have one.
    sine = np.clip(offset / np.maximum(length, 1e-12), 0.0, 0.9)
    inward = sine * along + np.sqrt(1 - sine**2) * lateral
    return np.asarray(marker - offset * inward)


def _segment(upper: Floats, lower: Floats, marker: Floats, right: float) -> Floats:
    """(T, 3, 3): y from the lower to the upper joint, z to the right in the plane of the lateral marker, x forward."""
    y = unit_vectors(upper - lower)
    outward = right * (marker - lower)
    x = unit_vectors(np.cross(y, outward))
    return np.stack([x, y, np.cross(x, y)], axis=2)
