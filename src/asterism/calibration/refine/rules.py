"""The numbers by which a rig is refined."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RefineRules:
    """When a camera counts as moved, and how its new pose is found.

    frames        of the recording that are used, evenly spread
    certain       standard deviations by which a view must have moved, or a focal length have changed
    by_two        so many times as uncertain are points of two cameras
    same_pose     rad and m, within which two cameras stand in one place
    least_zoom    the least change of a focal length that counts
    least_points  of the other cameras that a camera needs to be compared with them
    noise_frames  frames, and noise_groups groups of cameras, from which the pixel noise is estimated
    usual_noise   px: a group with less ends the search
    most_noise    px: with more in every group this is not the rig of the recording
    reach, bin    how far the images of a moved camera are searched, and how finely, in widths of the image
    least_shown   share of its points that a camera must show again with its new pose

    Checked on the simulated rigs with moved cameras of tests/test_refine.py.
    """

    frames: int = 80
    certain: float = 4.0
    by_two: float = 2.0
    same_pose: tuple[float, float] = (0.05, 0.1)
    least_zoom: float = 0.001
    least_points: int = 40
    noise_frames: int = 16
    noise_groups: int = 30
    usual_noise: float = 0.5
    most_noise: float = 3.0
    reach: float = 0.25
    bin: float = 0.004
    least_shown: float = 0.15


RULES = RefineRules()
