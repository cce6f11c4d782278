"""A recording whose events a person has set, and what was found in it, in; the person's events, with how certain they are, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from asterism.gait.events import OFF, SIDE_NAMES, STRIKE, EventRules, GaitEvent, Walking
from asterism.recording import Event, Recording

PERSON = "a person"
"""Who set the events, in the processing log and as the source of an event."""
_ACTION = "events set"
_SAME = 0.0005
"""s between an event of a file and the one that was found: a file keeps times with six or more digits, a frame lasts longer by far."""


def with_events_said(recording: Recording, events: Sequence[Event]) -> Recording:
    """The recording with strikes and offs as a person set them; its other events stay. A step of its log says so.

    events: s from the first frame.
    """
    start = float(recording.times[0]) if len(recording) else 0.0
    others = [event for event in recording.events if event.label not in (STRIKE, OFF)]
    own = [replace(event, time=start + event.time) for event in events]
    kept = tuple(sorted([*others, *own], key=lambda event: event.time))
    return replace(recording, events=kept).logged(_ACTION, PERSON, events=len(own))


def walking_as_said(recording: Recording, walking: Walking, rules: EventRules | None = None) -> Walking:
    """The walking with the recording's own strikes and offs, where a person has set them; else as it was found.

    An event that the person left where it was found is as certain as found. One that was moved or added is as certain as one that markers
    show clearly: a person looks at the same markers. How exactly people set events is not known here.
    """
    if not any(step.action == _ACTION and step.by == PERSON for step in recording.log):
        return walking
    rules, start = rules or EventRules(), float(recording.times[0])
    sides, told = {name: side for side, name in SIDE_NAMES.items()}, list[GaitEvent]()
    for event in recording.events:
        if event.label not in (STRIKE, OFF) or event.context not in sides:
            continue
        side, time = sides[event.context], event.time - start
        found = [one for one in walking.of(side, event.label) if abs(one.time - time) < _SAME]
        sigma = rules.strike_sigma if event.label == STRIKE else rules.off_sigma
        told.append(found[0] if found else GaitEvent(side, event.label, time, sigma, PERSON))
    return replace(walking, events=tuple(sorted(told, key=lambda event: event.time)))
