"""A recording whose legs have a clinical model in; the same with the model's joint centres as columns, for the fit of a skeleton, out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from asterism.errors import AsterismError
from asterism.geometry import z_up_rotation
from asterism.motion.clinical.angles import clinical_angles
from asterism.recording import Recording
from asterism.skeleton.person import joint_label


def with_joint_centres(recording: Recording, *, static: Recording | None = None, model: str | None = None) -> Recording:
    """The recording with columns of the hip, knee and ankle centres that its clinical model computes, as `fit_person` takes them.

    static, model: see `clinical_angles`. Raises AsterismError where no leg has one.

    >>> from asterism.simulation import simulate_walks
    >>> walk = simulate_walks(1, frames=30, seed=0)[0]
    >>> with_joint_centres(walk).labels[-1]
    'right foot joint'
    """
    found = clinical_angles(recording, static=static, model=model)
    legs = found.model.body(recording).legs
    if not legs:
        raise AsterismError(f"{recording.metadata.get('file', 'the recording')}: no leg has a hip, a knee and an ankle to compute.")
    back = z_up_rotation(recording.vertical)
    sides = {"L": "left", "R": "right"}
    columns = {
        joint_label(f"{sides[side]} {bone}"): centre @ back
        for side, leg in sorted(legs.items())
        for bone, centre in (("thigh", leg.hip), ("shank", leg.knee), ("foot", leg.ankle))
    }
    positions = np.concatenate([recording.positions, np.stack(list(columns.values()), axis=1)], axis=1)
    return replace(recording, positions=positions, labels=(*recording.labels, *columns), source=None, origin=None, taken=())
