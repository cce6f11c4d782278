"""Simulated walkers in; the model that both demos label with out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from asterism.cli import _console

if TYPE_CHECKING:
    from asterism.labelling import MarkerModel
    from asterism.recording import Recording

MARKERS = "helen-hayes"


def train_on_walkers(walks: Sequence[Recording], seed: int) -> MarkerModel:
    """A quick training: two groups left out in turn, few and short trials, no partial solvers, which the whole-body rules do not use."""
    from asterism.labelling import MarkerModel, TrainingRules
    from asterism.labelling.training.trials import TrainingTrial
    from asterism.recording import MarkerSet

    rules = TrainingRules(
        virtual_people=0,
        folds=2,
        trial_frames=10,
        trials=(
            TrainingTrial(),
            TrainingTrial(0.2),
            TrainingTrial(0.34),
            TrainingTrial(0.2, 3),
            TrainingTrial(0.2, clutter=3.0, spread=0.03),
        ),
        time_trials=(TrainingTrial(0.27), TrainingTrial(0.2, 3)),
        stretches=1,
        stretch_frames=50,
    )
    with _console.progress("training") as progress:
        return MarkerModel.fit(walks, seed=seed, miner=None, marker_set=MarkerSet.load(MARKERS), training=rules, progress=progress)
