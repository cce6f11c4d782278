"""The names that a file gives the markers of several people in; who they are, and which of the bodies found is whose, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from asterism.labelling.recording_labeller import LabelledBodies, RecordingLabeller
from asterism.labelling.together import join_labellings
from asterism.labelling.training.people import prefix_of, prefixes_of_people
from asterism.recording import Clouds, Ints, Labelling, MarkerSet


def people_in(labels: Sequence[str], marker_set: MarkerSet, subject: str = "", *, bodies: int = 1) -> list[str]:
    """The people whose markers of a set a file names, by the names before the colon; empty where it is one person.

    Whose names have nothing before them is called as the file's subject, or else by a number. bodies: how many people there are; where the
    names are of one, with that subject, the others have the numbers that follow.

    >>> people_in([f"{who}:{name}" for who in ("Ann", "Bob") for name in ("LKNE", "LANK", "LHEE", "LTOE")], MarkerSet.load("helen-hayes"))
    ['Ann', 'Bob']
    """
    named = [label for label in labels if marker_set.name_of(label) is not None]
    people = prefixes_of_people(named)
    if not people and bodies > 1 and subject and named:
        people = ["", *map(str, range(2, bodies + 1))]
    plain = subject or next(str(number) for number in range(1, len(people) + 2) if str(number) not in people)
    return [person or plain for person in people] if plain not in people else people


def in_order_of_names(found: LabelledBodies, labels: Sequence[str], clouds: Clouds, labeller: RecordingLabeller) -> LabelledBodies:
    """Bodies of one model, each as the person with whose names in the file it agrees in most samples; `found` where models differ.

    labels: of the file's columns. Of two bodies of which one is labelled (`RecordingLabeller.label_two`), that is the one with the names.
    """
    model = labeller.models[0]
    alone = len(labeller.models) == 1
    if any(other is not model for other in labeller.models):
        return found
    # names with nothing before them are those of the one whose name no other label has
    before = {prefix_of(label) for label in labels}
    plain = next((name for name in labeller.names or () if name not in before), None)
    whose = [prefix_of(label) or plain for label in labels]
    named = [[label if who == name else "" for label, who in zip(labels, whose, strict=True)] for name in labeller.names or ()]
    of_people = [labels] if alone else named
    if not alone and len(of_people) != len(found.bodies):
        return found
    same = np.array([[_agreeing(body, one, clouds, model.marker_set) for body in found.bodies] for one in of_people])
    if alone:
        first = int(same[0].argmax())
        ordered = [found.bodies[first], *(body for at, body in enumerate(found.bodies) if at != first)]
        shown = replace(ordered[0], bodies=len(ordered))
        return replace(found, labelling=shown, bodies=(shown, *ordered[1:]))
    bodies = tuple(found.bodies[at] for at in linear_sum_assignment(same, maximize=True)[1])
    return replace(found, labelling=join_labellings(bodies, [model.marker_set] * len(bodies), labeller.names)[0], bodies=bodies)


def _agreeing(body: Labelling, labels: Sequence[str], clouds: Clouds, marker_set: MarkerSet) -> int:
    """Samples whose label the file's own column has."""
    column_of = _columns(labels, marker_set)
    given = (body.indices >= 0) & (column_of >= 0)
    return int((clouds.columns[body.indices[given]] == np.broadcast_to(column_of, given.shape)[given]).sum())


def _columns(labels: Sequence[str], marker_set: MarkerSet) -> Ints:
    """(M,) the one column that carries each marker's name, -1 where none or several do."""
    names = [marker_set.name_of(label) if label else None for label in labels]
    return np.array([names.index(name) if names.count(name) == 1 else -1 for name in marker_set.names], dtype=np.int64)
