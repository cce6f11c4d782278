"""Recordings of several people in; recordings of one person each out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from asterism.recording import Recording, canonical, is_unnamed, subject_of

FEWEST_SHARED = 4
"""Markers that two prefixes share from which they are two people, where these are also half of the markers of one: parts of a body that
carry prefixes of their own (a chair, an arm) share few names."""


FEWEST_NUMBERED = 10
"""Markers of one word and numbers ("Marker1" to "Marker4") from which a prefix may be a person's: programs number those of a rigid body,
and every rigid body has the same names."""


def one_person_each(recordings: Sequence[Recording], subjects: Sequence[str] | None) -> tuple[list[Recording], list[str]]:
    """The recordings, those of several people split by the prefixes of their labels ("Ann:LKNE", "Bob:LKNE"); and whose each is.

    subjects: the person of each recording, by default as `subject_of` says. Of a split recording a person is "subject Ann", or the subject
    whose names have no prefix. Columns of no person, such as an object's, are left out of split recordings.
    """
    found, names = [], []
    for i, recording in enumerate(recordings):
        subject = subject_of(recording) if subjects is None else subjects[i]
        prefixes = prefixes_of_people(recording.labels)
        # The recording of one person keeps its labels, prefix or not.
        if not prefixes:
            found.append(recording)
            names.append(subject)
        for prefix in prefixes:
            # Columns of another person, or of an object, are no markers of this one.
            found.append(of_person(recording, prefix))
            names.append(f"{subject} {prefix}".rstrip())
    return found, names


def of_person(recording: Recording, prefix: str) -> Recording:
    """The markers of the person with this prefix, under their names without it."""
    own = recording.select([label for label in recording.labels if prefix_of(label) == prefix and not is_unnamed(label)])
    return replace(own, labels=tuple(label.partition(":")[2].strip() if prefix else label for label in own.labels))


def prefixes_of_people(labels: Sequence[str]) -> list[str]:
    """The prefixes of labels that several people wear: "Ann" and "Bob", or "" and "2" for names of which some have none.

    Empty where there is one person.

    >>> prefixes_of_people(["LKNE", "LANK", "LHEE", "LTOE", "2:LKNE", "2:LANK", "2:LHEE", "2:LTOE", "*1"])
    ['', '2']
    """
    worn: dict[str, set[str]] = {}
    for label in labels:
        if not is_unnamed(label):
            prefix = prefix_of(label)
            worn.setdefault(prefix, set()).add(canonical(label.partition(":")[2] if prefix else label))
    # Rigid bodies have like names, too, and would pass for people.
    worn = {prefix: names for prefix, names in worn.items() if not _is_rigid_body(names)}
    return [prefix for prefix, names in worn.items() if any(_alike(names, worn[other]) for other in worn if other != prefix)]


def _is_rigid_body(names: set[str]) -> bool:
    """Whether a prefix's names are those that programs give the few markers of a rigid body."""
    # A few names of one word and a number, as programs give them.
    return len(names) < FEWEST_NUMBERED and len({name.rstrip("0123456789") for name in names}) == 1


def _alike(one: set[str], other: set[str]) -> bool:
    """Whether two prefixes have so many names in common that they are two people."""
    return len(one & other) >= max(FEWEST_SHARED, 0.5 * min(len(one), len(other)))


def prefix_of(label: str) -> str:
    """What stands before the first colon of a label, "" for nothing."""
    before, colon, after = label.partition(":")
    return before.strip() if colon and after.strip() else ""
