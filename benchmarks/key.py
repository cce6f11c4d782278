"""The key figures: which rows of which scripts stand for each capability, and which of them the README shows.

Every mission has at least one row here. A release measures these and nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Group:
    """Key figures that one script gives.

    title    of the section in which they stand
    rows     their names, as the script yields them
    minutes  about what it takes on one core: the longest begin first
    alone    whether it times things: it runs while no other does
    """

    title: str
    chapter: str
    script: str
    rows: tuple[str, ...]
    minutes: float
    alone: bool = False

    @property
    def name(self) -> str:
        """Chapter and script."""
        return f"{self.chapter} {self.script}"


_WALKS, _OTHERS, _WORTH = "Walks, people not seen", "Other laboratories and standing people", "What the confidence is worth"
_LIVE, _SPEED, _POINTS = "Live, and corrected by a person", "Speed and memory", "Calibration and points"
_VIEWS, _GARMENT, _MOTION, _FILES, _THESIS = "Few cameras", "Garments", "Motion", "Files", "The thesis' own tables"
_LOOP = "loop, 3 hidden + 3 ghosts, one trial labelled"
_LABS = "movement, 6 other laboratories, 3 hidden"
_WAND = "wand, 8 cameras, 2,000 frames, 0.2 px, cold start"
_PARTICLES = "particles-4cam, blobs against the peer's targets, the peer's thresholds"

KEY: tuple[Group, ...] = (
    Group(
        _WALKS,
        "recordings",
        "gaps",
        (
            "gaps, 1 hidden, whole recording: right",
            "gaps, 3 hidden, whole recording: right",
            "gaps, 3 hidden, whole recording: wrong",
            "gaps, 5 hidden, whole recording: right",
            "gaps, 5 hidden, whole recording: wrong",
            "gaps, 3 hidden + 3 ghosts, whole recording: right",
            "gaps, 3 hidden + 3 ghosts, whole recording: wrong",
        ),
        5,
    ),
    Group(
        _WALKS,
        "dirt",
        "flicker",
        (
            "clutter, 3 flickering, 30 mm, 3 hidden, whole recording: right",
            "clutter, 3 flickering, 30 mm, 3 hidden, whole recording: wrong",
        ),
        2,
    ),
    Group(
        _WALKS,
        "recordings",
        "full-body",
        (
            "59 markers, 3 hidden, whole recording, without parts whose hand labels contradict the standing trial or the body: right",
            "59 markers, 3 hidden, whole recording, without parts whose hand labels contradict the standing trial or the body: wrong",
        ),
        4,
    ),
    Group(
        _WALKS,
        "recordings",
        "bodies",
        ("two people, one model twice, 3 hidden of each: right", "two people, one model twice, 3 hidden of each: wrong"),
        2,
    ),
    Group(_OTHERS, "recordings", "laboratories", (f"{_LABS}: right", f"{_LABS}: wrong"), 5),
    Group(
        _OTHERS,
        "dirt",
        "standing",
        (
            "standing, simulated adults by a model of children: labels sure and wrong",
            "standing, real adults by a model of children: mostly wrong",
            "standing, real adults by a model of children: labels sure and wrong",
        ),
        2,
    ),
    Group(
        _WORTH,
        "dirt",
        "reliability",
        (
            "reliability, gait, ten taught, whole recording: right at 0.99 or more",
            "reliability, gait, ten taught, whole recording: right from 0.95 to 0.99",
            "reliability, gait, ten taught, stream, delay 10: right at 0.99 or more",
            "reliability, other laboratories, people not seen, whole recording: right at 0.99 or more",
            "reliability, other laboratories, people not seen, whole recording: right from 0.95 to 0.99",
        ),
        6,
    ),
    Group(
        _LIVE,
        "recordings",
        "stream",
        (
            "stream, 15 markers, 3 hidden + 3 ghosts, delay 10: right",
            "stream, 15 markers, 3 hidden + 3 ghosts, delay 10: wrong",
            "stream, 59 markers, 3 hidden, delay 0: p99.9 of a push",
        ),
        3,
        alone=True,
    ),
    Group(
        _LIVE,
        "recordings",
        "loop",
        (f"{_LOOP}: labels touched by hand", f"{_LOOP}: right, the worst subject of all starts", f"{_LOOP}: answers for a start"),
        5,
    ),
    Group(
        _SPEED,
        "recordings",
        "speed",
        (
            "reference: fixed NumPy and Numba loop, one core",
            "speed, 15 markers, 3 hidden, whole recording, one core",
            "speed, 39 markers, 3 hidden, whole recording, one core",
            "speed, 59 markers, 3 hidden, whole recording, one core",
        ),
        3,
        alone=True,
    ),
    Group(
        _SPEED,
        "hostile",
        "long-recordings",
        (
            "long recordings, an hour of 39 markers read, labelled and written (`asterism label`): memory at most",
            "long recordings, 48,000 frames of 39 markers in gaps against 6,000: time",
            "long recordings, 48,000 frames of 39 markers in gaps against 6,000: right, less",
        ),
        4,
    ),
    Group(_SPEED, "cameras", "speed", ("composition + merging, 8 cameras 50 markers, one core",), 1, alone=True),
    Group(
        _POINTS,
        "cameras",
        "wand",
        (f"{_WAND}: focal length, RMS", f"{_WAND}: 3D of unseen points, their blobs with noise, RMS"),
        1,
    ),
    Group(
        _POINTS,
        "cameras",
        "wand-rigs",
        ("wand, cold starts of 60 random rigs of 3 to 12 cameras, 5 % outliers: converge to the right rig",),
        2,
    ),
    Group(_POINTS, "cameras", "stereo", ("chessboard-stereo, the pair, RMS",), 0.1),
    Group(_POINTS, "cameras", "charuco", ("charuco-4cam, all four together, RMS",), 0.7),
    Group(_POINTS, "cameras", "ghosts", ("ghosts, 8 cameras 50 markers 0.3 px, all seen, global choice",), 1),
    Group(_POINTS, "cameras", "vicon-rig-walk", ("vicon-rig-walk, 0.3 px, body, strays: the same, smoothed along paths",), 0.5),
    Group(_POINTS, "cameras", "particles", (f"{_PARTICLES}: recall", f"{_PARTICLES}: precision"), 0.1),
    Group(
        _VIEWS,
        "views",
        "gait",
        ("gait, 15 markers, 4 cameras: right", "gait, 15 markers, 4 cameras: wrong", "gait, 15 markers, 2 cameras: right"),
        2,
    ),
    Group(
        _GARMENT,
        "garment",
        "hard-images",
        (
            "wrong identities, rendered suits",
            "read of circles of 6 px within 60 degrees, rendered suits, lamps all around",
            "read of circles of 6 px within 60 degrees, prints through OpenCV warps",
        ),
        2,
    ),
    Group(_GARMENT, "garment", "points", ("suit, 8 cameras: points per frame, fewest", "suit: 3D error (RMS)"), 0.5),
    Group(
        _MOTION,
        "motion",
        "sparse",
        ("sparse: points on the right limb", "sparse, robust: angle error, mean"),
        1,
    ),
    Group(
        _MOTION,
        "motion",
        "coverage",
        ("sparse: 95 % interval holds the true angle, >=", "sparse: 95 % interval holds the true angle, <="),
        4,
    ),
    Group(
        _MOTION,
        "motion",
        "knee",
        ("gait, clusters, functional axis: knee flexion, RMS to Plug-in-Gait, worst subject",),
        0.3,
    ),
    Group(
        _FILES,
        "hostile",
        "damaged-files",
        ("damaged files: read, or a sentence that names the file",),
        1,
    ),
    Group(_FILES, "labelling", "conformance", ("conformance: C3D files read",), 0.2),
    Group(_THESIS, "labelling", "thesis-main", ("tables 5.4 and 5.5, target 99.99 %: cells at or better than printed",), 4),
    Group(_THESIS, "labelling", "full-solver", ("full solver, no occlusion: feature evaluations per frame to the right labelling",), 0.2),
)


@dataclass(frozen=True)
class Shown:
    """A line of the README's table: what it says, and the rows whose numbers it shows, each with the word after it."""

    text: str
    rows: tuple[tuple[str, str], ...]


def _right_and_wrong(start: str) -> tuple[tuple[str, str], ...]:
    return ((f"{start}: right", "right"), (f"{start}: wrong", "wrong"))


README: tuple[Shown, ...] = (
    Shown("walks, 3 of 15 markers hidden", _right_and_wrong("gaps, 3 hidden, whole recording")),
    Shown("walks, 3 hidden and 3 ghosts that move along", _right_and_wrong("gaps, 3 hidden + 3 ghosts, whole recording")),
    Shown("six other laboratories, 3 hidden", _right_and_wrong(_LABS)),
    Shown("labels given at a confidence of 0.99 or more", ((KEY[6].rows[3], "right"),)),
    Shown("live, 3 hidden and 3 ghosts, 0.1 s late", _right_and_wrong("stream, 15 markers, 3 hidden + 3 ghosts, delay 10")),
    Shown("four cameras, labels in their images", _right_and_wrong("gait, 15 markers, 4 cameras")),
    Shown("a rig from a waved wand: points of unseen markers", ((f"{_WAND}: 3D of unseen points, their blobs with noise, RMS", "off"),)),
)
