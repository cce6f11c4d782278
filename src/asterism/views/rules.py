"""The constants of labelling in images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.recording import Floats
from asterism.views.arrays import Observing


@dataclass(frozen=True)
class ViewsRules:
    """How bodies are fitted to blobs, and blobs labelled. Chosen on simulated walks (`simulate_walks`), on none of the recordings.

    noise         px, standard deviation of a blob's x and y
    strays        blobs of an image that show no marker, as many as are thought usual
    doubt         m, what a capsule hides by less counts as visible; above 0: in doubt a marker is visible, as the paper has it. Below 0
                  agrees best with bodies other than the model's, and gives as many right labels (a row of the benchmark)
    softness      m, how fast the probability falls around that
    hidden, shown  probability of a blob of a marker that the body hides, and of one that it does not
    clearance     m, how far markers are above the surface of the body
    blur          px, standard deviations at which blobs are compared, from stage to stage, from a given start
    steps         tries of Levenberg-Marquardt in each stage
    coarse        px, blurs of the many starts when nothing is known
    coarse_steps  tries in each of these stages
    going_on      share of the starts that goes on to the next coarse stage
    headings      how many directions are tried when nothing is known
    kept          how many of the starts are fitted to the end
    enough_shown  share of the expected sightings below which more starts are tried
    follow        px, blurs with which the next frame follows
    follow_steps  tries in each of these stages
    rounds        how often each camera assigns its blobs
    turns         how often labels and pose take turns
    label_steps   tries of Levenberg-Marquardt in each turn
    tilt          rad, standard deviation of the body's tilt
    joints        whether joint angles are free
    occlusion     whether the body hides markers (the ablation's switch)
    together      whether cameras inform each other when blobs are assigned (the ablation's switch)
    personal      whether the person's own body is learned first
    turn_frames   frames after which the followed body is compared with one that is found without a start
    window        frames on both sides whose gains decide together between the two directions of time
    lost          nats per sighting that the body lets expect, below which it counts as lost and no label is given
    least_shown   share of the expected sightings that must be there, or the body counts as lost too
    longest_wait  frames until a body that was not found is sought again, at most
    slope, offset  of the logistic that turns the worth of a label (nats) into its probability
    """

    noise: float = 0.8
    strays: float = 2.0
    doubt: float = -0.003
    softness: float = 0.004
    hidden: float = 0.1
    shown: float = 0.97
    clearance: float = 0.007
    blur: tuple[float, ...] = (40.0, 20.0, 10.0, 5.0, 2.5)
    steps: int = 6
    coarse: tuple[float, ...] = (50.0, 25.0, 12.0)
    coarse_steps: int = 3
    going_on: float = 0.4
    headings: int = 8
    kept: int = 3
    enough_shown: float = 0.85
    follow: tuple[float, ...] = (6.0, 2.5)
    follow_steps: int = 4
    rounds: int = 3
    turns: int = 2
    label_steps: int = 4
    tilt: float = 0.2
    joints: bool = True
    occlusion: bool = True
    together: bool = True
    personal: bool = True
    turn_frames: int = 20
    window: int = 5
    lost: float = 3.0
    least_shown: float = 0.65
    longest_wait: int = 32
    slope: float = 0.5
    offset: float = 1.0

    def confidence(self, worth: Floats, quality: float, leads: Floats) -> Floats:
        """(N,) the probability that labels are right, by their worth (N,) nats, the frame's quality and its lead over a rival (nats)."""
        raw = 1.0 / (1.0 + np.exp(-np.clip(self.slope * worth + self.offset, -30.0, 30.0)))
        whole = 1.0 / (1.0 + np.exp(-np.clip(leads, -30.0, 30.0)))
        share: Floats = raw * whole
        return share

    def observing(self, area: float) -> Observing:
        """The model of observation for images of this mean area (px2)."""
        doubt = self.doubt if self.occlusion else float("inf")
        return Observing(
            self.noise, max(self.strays, 0.2) / area, doubt, self.softness, self.hidden, self.shown, self.clearance, 40.0, False
        )


RULES = ViewsRules()
