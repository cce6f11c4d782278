"""A seed in; a session in a simulated laboratory out: rig, waved wand, L-frame, a walker, and what the cameras saw of each."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from asterism.cameras import Rig
from asterism.recording import Blobs, Floats, Ints, Recording
from asterism.simulation.cameras import ImagingSettings, WandTruth, ring_rig, simulate_blobs, simulate_wand, walker_capsules

WAND = (0.0, 0.2, 0.6)
L_FRAME = ((0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.6, 0.0, 0.0), (0.0, 0.4, 0.0))
"""Where the L-frame's markers lie, which is where the world begins (m)."""
NOISE = 0.2


@dataclass(frozen=True)
class SimulatedSession:
    """What happened, and what the cameras saw of it.

    rig                  the truth; the world is that of the L-frame
    wand, wand_truth     a waved wand of lengths `WAND`, outliers and strays among its blobs
    l_frame              a recording of markers that lie where `L_FRAME` says
    walk                 the person, as true trajectories
    blobs, identity      what the cameras saw of the person, and which marker each blob is, see `simulate_blobs`
    """

    rig: Rig
    wand: Blobs
    wand_truth: WandTruth
    l_frame: Blobs
    walk: Recording
    blobs: Blobs
    identity: Ints

    @property
    def seen(self) -> Ints:
        """(T, M) how many cameras have a blob of each marker alone."""
        cameras = np.zeros(self.walk.positions.shape[:2], dtype=np.int64)
        alone = self.identity >= 0
        np.add.at(cameras, (self.blobs.frame_of[alone], self.identity[alone]), 1)
        return cameras


def simulate_session(
    walk: Recording, seed: int = 0, *, cameras: int = 8, wand_frames: int = 1500, noise: float = NOISE
) -> SimulatedSession:
    """Cameras of 2048 x 1536 px in a ring of 4 m, and what they see of a wand, an L-frame and a person.

    noise  px, standard deviation of each blob's x and y
    Errors: 1 % of the wand's blobs are elsewhere; images show passing lights (0.3 on average); 1 % of the images never arrive, 1 % of blobs
    are missed; the body hides markers; blobs that overlap become one. Every camera sees a reflection until the walker comes: by then it is
    masked. The same arguments give the same session.
    """
    rngs = [np.random.default_rng([seed, part]) for part in range(4)]
    rig = ring_rig(cameras, radius=4.0, height=2.6, size=(2048, 1536), rng=rngs[0])
    usual = ImagingSettings(noise=noise, strays=0.3, dropped=0.01, missed=0.01)
    # A wand in a lit hall: outliers and one reflection for each camera, as calibrations meet them.
    waved = replace(usual, outliers=0.01, reflections=1)
    wand, truth = simulate_wand(rig, WAND, wand_frames, settings=waved, rate=60.0, rng=rngs[1])
    # A second of a frame that lies still: its noise averages out.
    lying: Floats = np.tile(L_FRAME, (60, 1, 1))
    l_frame = simulate_blobs(rig, lying, replace(usual, reflections=1), rng=rngs[2], rate=60.0)[0]
    blobs, identity = simulate_blobs(rig, walk.positions, usual, body=walker_capsules(walk), rng=rngs[3], rate=walk.rate)
    return SimulatedSession(rig, wand, truth, l_frame, walk, blobs, identity)
