"""A labelled recording in; the arms whose hand labels no hand can have, out. No labelling takes part."""

from __future__ import annotations

import numpy as np

from asterism.recording import Recording

_HAND = ("WRA", "WRB", "FIN")
"""The wrist on the side of the thumb and on that of the little finger, and the back of the hand."""


def impossible_hands(recording: Recording) -> frozenset[str]:
    """The markers of hands whose hand labels contradict the anatomy, by medians over the recording.

    The finger marker is nearer to the elbow than one of the wrist; or it lies on the palm when the wrist markers are taken for what they
    are named: seen along the forearm, thumb, little finger and back of the hand go around in one sense on the left, in the other on the
    right. O(T).
    """
    found = set[str]()
    for side, sense in (("L", 1.0), ("R", -1.0)):
        names = [side + name for name in _HAND]
        if not {side + "ELB", *names} <= set(recording.labels):
            continue
        elbow, thumb, little, finger = (recording.positions[:, recording.labels.index(name)] for name in (side + "ELB", *names))
        away = [np.nanmedian(np.linalg.norm(each - elbow, axis=1)) for each in (thumb, little, finger)]
        wrist = 0.5 * (thumb + little)
        back = sense * np.cross(wrist - elbow, little - thumb)
        if away[2] < max(away[:2]) or np.nanmedian((back * (finger - wrist)).sum(axis=1)) < 0.0:
            found.update(names)
    return frozenset(found)
