"""What calibrates the confidence: a recording in; clouds with hidden markers and ghosts, and the truth about them, out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from asterism.labelling.simulated_clutter import Clutter, add_clutter
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts, simulate_occlusions
from asterism.recording import Clouds, Ints, Recording


@dataclass(frozen=True)
class TrainingTrial:
    """One way to make labelling hard.

    hidden   share of the markers that is hidden at every moment
    ghosts   ghosts that ride along at every moment
    clutter  points that flicker beside markers, on average in each frame
    spread   m, standard deviation along each axis of the clutter's offset from its marker
    """

    hidden: float = 0.0
    ghosts: int = 0
    clutter: float = 0.0
    spread: float = 0.08

    @property
    def adds_points(self) -> bool:
        """Whether there are points that are no markers."""
        return self.ghosts > 0 or self.clutter > 0

    def in_frames(self, recording: Recording, rng: np.random.Generator) -> tuple[Clouds, Ints]:
        """Clouds whose frames stand alone, and the truth, as `simulate_occlusions` gives them."""
        # A share becomes a whole number of markers, so that small sets round.
        clouds, truth = simulate_occlusions(recording, round(self.hidden * len(recording.labels)), self.ghosts, rng)
        return self._cluttered(recording, clouds, truth, rng)

    def in_time(self, recording: Recording, rng: np.random.Generator) -> tuple[Clouds, Ints]:
        """Clouds in which gaps and ghosts last, and the truth, as `simulate_gaps_and_ghosts` gives them."""
        clouds, truth = simulate_gaps_and_ghosts(recording, round(self.hidden * len(recording.labels)), self.ghosts, rng)
        return self._cluttered(recording, clouds, truth, rng)

    def _cluttered(self, recording: Recording, clouds: Clouds, truth: Ints, rng: np.random.Generator) -> tuple[Clouds, Ints]:
        if not self.clutter:
            return clouds, truth
        return add_clutter(recording, clouds, truth, Clutter(self.clutter, spread=self.spread), rng)
