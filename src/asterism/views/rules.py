"""The constants of labelling in images."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from asterism.recording import Floats
from asterism.views.arrays import Observing


@dataclass(frozen=True)
class ViewsRules:
    """How bodies are fitted to blobs, and blobs labelled. Chosen on simulated walks (`simulate_walks`), on none of the recordings.

    noise         px, standard deviation of a blob's x and y
    strays        blobs of an image that show no marker, as many as are thought usual
    occlusion_tolerance  m: occlusions shallower than this do not hide. Above 0 as the paper has it; below 0 agrees best with bodies
                  other than the model's, and gives as many right labels
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
    enough_gain   gain of an expected sighting, as a share of the most it can be, below which more starts are tried
    sure_gain     the same share, below which limbs are exchanged, and a given start is doubted
    exchange      px, blurs at which exchanged labels are fitted
    follow        px, blurs with which the next frame follows
    follow_steps  tries in each of these stages
    carry         px, how far a blob may be from where the last frame's blob is expected to have its label at first
    drop          nats of gain below the last frame's from which labels that were carried over are tried against a fit without them
    rounds        how often each camera assigns its blobs
    turns         how often labels and pose take turns
    label_steps   tries of Levenberg-Marquardt in each turn
    tilt          rad, standard deviation of the body's tilt
    joints        whether joint angles are free
    occlusion     whether the body hides markers (the ablation's switch)
    together      whether cameras inform each other when blobs are assigned (the ablation's switch)
    personal      whether the person's own body is learned first
    both_ways     whether the frames are followed in both directions of time
    turn_frames   frames after which the followed body is compared with one that is found without a start
    taken_over    nats by which the body found without a start must be better than the followed one
    window        frames on both sides over which the margin of one direction of time over the other is averaged
    jump          nats that it costs to go over from one direction to the other where they differ
    lost          nats per sighting that the body lets expect, below which it counts as lost and no label is given
    least_shown   share of the expected sightings that must be there, or the body counts as lost too
    longest_wait  frames until a body that was not found is sought again, at most
    slope, offset  of the logistic that turns the margin of a label (nats) into its probability
    single        what is added to its offset where no other camera has a blob of the marker
    rival_slope   of the logistic that turns the margin of a frame over another explanation (nats) into a probability
    whole_slope, whole_middle, whole_noise  of the logistic that turns the share of the gain that the blobs let expect (see
                  `FrameLabeller.explained`) into the probability that the body is there as it was fitted; the odds fall with this power
                  of the noise over the usual one, since as many more blobs lie near a wrong body's markers by chance
    usual_noise   px, noise where the rig is right

    jump, carry, drop and taken_over were chosen on simulated motion of 26 markers. slope, offset, single and rival_slope were the most
    likely ones for 91371 labels, 185 of them wrong, of 72 simulated recordings before the labels of a frame were carried to the next: 36
    people of 12 seeds, 90 frames each, before two and before three cameras, with the mean body of four other simulated people. With
    constants from one half of the seeds the labels of the other half were right as often as said: 0.916 of 369 labels at 0.90 to 0.95,
    0.987 of 1424 at 0.98 to 0.99, 0.9968 of 6889 at 0.995 to 0.999, 0.9999 of 79335 above. whole_slope and
    whole_middle were the most likely ones for 34000 labels of two simulated people before two to four cameras with a right rig: walking,
    lying, with a quarter of the blobs lost, and both. Of another two people's and theirs together (68589 labels) 47 of 57070 at 0.99 or
    more are wrong (slope 23), 0 of 1034 (half of it), 129 of 63320 (twice); 265 of 64419 with half the middle, none is sure with twice.
    whole_noise was 1.9 for rigs that contradict themselves, mirrored images among them: of the others' 36848 labels 26 of 18582 sure
    ones are wrong, 40 of 27280 with half of it, 8 of 5162 with twice, and 51 of 30422 without.
    """

    noise: float = 0.8
    strays: float = 2.0
    occlusion_tolerance: float = -0.003
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
    kept: int = 5
    enough_gain: float = 0.85
    sure_gain: float = 0.93
    exchange: tuple[float, ...] = (20.0, 5.0)
    follow: tuple[float, ...] = (6.0, 2.5)
    follow_steps: int = 4
    carry: float = 8.0
    drop: float = 15.0
    rounds: int = 3
    turns: int = 2
    label_steps: int = 4
    tilt: float = 0.2
    joints: bool = True
    occlusion: bool = True
    together: bool = True
    personal: bool = True
    both_ways: bool = True
    turn_frames: int = 20
    window: int = 5
    jump: float = 10.0
    taken_over: float = 1.0
    lost: float = 3.0
    least_shown: float = 0.65
    longest_wait: int = 32
    slope: float = 0.75
    offset: float = 1.4
    single: float = -1.04
    rival_slope: float = 0.48
    whole_slope: float = 23.0
    whole_middle: float = 0.46
    whole_noise: float = 2.0
    usual_noise: float = 0.8

    def at_noise(self, noise: float) -> ViewsRules:
        """The rules for blobs that are off by this standard deviation (px)."""
        # The narrowest blur of a fit grows with the noise, or the fit would be lost between its blobs.
        least = min(self.follow) * noise / self.noise
        blur, follow = (tuple(max(each, least) for each in blurs) for blurs in (self.blur, self.follow))
        return replace(self, noise=noise, blur=blur, follow=follow)

    def confidence(self, margin: Floats, single: NDArray[np.bool_], rival_margin: Floats, explained: float = 1.0) -> Floats:
        """(N,) the probability that labels are right.

        margin (N,) nats beyond the best change of the label; single (N,) whether no other camera has a blob of the marker;
        rival_margin (N,) nats beyond the best other explanation of the frame that labels the blob otherwise, inf where none does;
        explained: share of the gain that the frame's blobs let expect. A body that explains few of them is wrong as a whole, however much
        better it is than the others that were tried. O(N).
        """
        own = _logistic(self.slope * margin + self.offset + self.single * single)
        rival = _logistic(self.rival_slope * np.minimum(rival_margin, 1e3))
        chance = self.whole_noise * np.log(self.noise / self.usual_noise)
        whole = _logistic(np.asarray(self.whole_slope * (explained - self.whole_middle) - chance))
        share: Floats = own * rival * whole
        return share

    def observing(self, area: float) -> Observing:
        """The model of observation for images of this mean area (px2)."""
        occlusion_tolerance = self.occlusion_tolerance if self.occlusion else float("inf")
        return Observing(
            self.noise,
            max(self.strays, 0.2) / area,
            occlusion_tolerance,
            self.softness,
            self.hidden,
            self.shown,
            self.clearance,
            40.0,
            False,
        )


def _logistic(x: Floats) -> Floats:
    out: Floats = 1.0 / (1.0 + np.exp(-np.clip(x, -30.0, 30.0)))
    return out


RULES = ViewsRules()

QUICK = ViewsRules(personal=False, both_ways=False, turn_frames=240)
"""Frames follow each other in one direction of time, with the body as it is; compared every 240 frames with the body found anew."""
