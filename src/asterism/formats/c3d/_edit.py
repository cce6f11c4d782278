"""Changed parameters of a C3D file: labels, events and single numbers in, records that replace the old ones out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from asterism.errors import AsterismError
from asterism.formats.c3d._file import C3DFile, events_of_group, numbered
from asterism.formats.c3d._numbers import Processor
from asterism.formats.c3d._parameters import CHARACTER, FLOAT, INTEGER, Parameters, Record, make_group, make_parameter
from asterism.recording import Event, ProcessingStep, log_as_text, log_from_text

MOST_STRINGS = 255
COMPUTED_GROUPS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS", "MODELED_MARKERS", "MODELLED_MARKERS")
"""Parameters of the group POINT that list what a model computed."""
LOG_GROUP, LOG = "ASTERISM", "LOG"
_WIDEST = 127
_LOG_WIDTH = 120
_EVENT_WIDTHS = {"CONTEXTS": 16, "LABELS": 32, "DESCRIPTIONS": 80, "SUBJECTS": 32}


def strings_record(name: str, group: int, strings: Sequence[bytes], width: int, processor: Processor, like: Record | None = None) -> Record:
    """A character parameter, padded with blanks to `width` or to the longest string. Raises AsterismError beyond 127 bytes."""
    width = max([width, *map(len, strings)])
    # A file with wider labels keeps them; else the format's limit counts.
    if width > max(_WIDEST, like.dimensions[0] if like is not None and like.dimensions else 0):
        raise AsterismError(
            f"label {max(strings, key=len).decode('utf-8', 'replace')!r} is longer than the {_WIDEST} bytes of a C3D label; shorten it."
        )
    data = b"".join(text.ljust(width) for text in strings)
    return make_parameter(name, group, CHARACTER, (width, len(strings)), data, processor=processor, like=like)


def floats_record(name: str, group: int, values: Sequence[float], dimensions: Sequence[int], processor: Processor) -> Record:
    """A parameter of floats."""
    data = processor.store(processor.words_of_floats(np.asarray(values, dtype=np.float64)))
    return make_parameter(name, group, FLOAT, dimensions, data, processor=processor)


def integers_record(name: str, group: int, values: Sequence[int], dimensions: Sequence[int], processor: Processor) -> Record:
    """A parameter of 16-bit integers; values up to 65535 are stored without their sign."""
    data = b"".join(processor.bytes_of_unsigned(int(value) & 0xFFFF) for value in values)
    return make_parameter(name, group, INTEGER, dimensions, data, processor=processor)


def with_number(parameters: Parameters, group: str, name: str, value: float) -> Record:
    """The record of an existing single number with another value, stored in the same type."""
    old = parameters.find(group, name)
    if old is None:
        raise KeyError(f"{group}:{name}")
    processor = parameters.processor
    first = processor.store(processor.words_of_floats([value])) if old.kind == FLOAT else processor.bytes_of_unsigned(int(value) & 0xFFFF)
    # A byte parameter keeps its type, or programs that expect it stop.
    if old.kind == 1:
        first = bytes([int(value) & 0xFF])
    return make_parameter(name, old.group, old.kind, old.dimensions, first + old.data[len(first) :], processor=processor, like=old)


def label_parameters(file: C3DFile, labels: Sequence[bytes], descriptions: Sequence[bytes]) -> dict[tuple[str, str], Record | None]:
    """Changes to POINT:USED, LABELS, LABELS2, ... and DESCRIPTIONS, ... for a new list of points."""
    parameters, processor = file.parameters, file.processor
    group = parameters.group_id("POINT")
    if group is None:
        used = {record.group for record in parameters.records if record.is_group}
        # Group numbers are free from 1 to 127.
        group = next(number for number in range(1, 128) if number not in used)
    changes: dict[tuple[str, str], Record | None] = {}
    if parameters.group_id("POINT") is None:
        changes["", "POINT"] = make_group("POINT", group, processor=processor)
    if parameters.find("POINT", "USED") is not None:
        changes["POINT", "USED"] = with_number(parameters, "POINT", "USED", len(labels))
    else:
        changes["POINT", "USED"] = integers_record("USED", group, [len(labels)], (), processor)
    for name, texts in (("LABELS", labels), ("DESCRIPTIONS", descriptions)):
        # A file without descriptions stays without.
        if name == "DESCRIPTIONS" and parameters.find("POINT", name) is None:
            continue
        old = numbered(parameters, "POINT", name)
        pages = [texts[at : at + MOST_STRINGS] for at in range(0, len(texts), MOST_STRINGS)]
        keys = [name, *(f"{name}{page + 1}" for page in range(1, len(pages)))]
        # Old pages are removed: fewer labels may need fewer of them.
        changes.update({("POINT", key): None for key in old})
        for key, page in zip(keys, pages, strict=True):
            like = parameters.find("POINT", key)
            widths = [
                record.dimensions[0] for k in old if (record := parameters.find("POINT", k)) is not None and len(record.dimensions) > 1
            ]
            changes["POINT", key] = strings_record(key, group, page, max(widths, default=4), processor, like)
    return changes


def with_declared(parameters: Parameters, gone: Collection[str], renamed: Mapping[str, str]) -> Parameters:
    """The parameters without labels that are gone, and with new labels, in the lists of angles, forces and the like.

    A list that would be empty is left out.
    """
    changes: dict[tuple[str, str], Record | None] = {}
    for name in parameters.groups.get("POINT", ()):
        record = parameters.find("POINT", name)
        # Only lists of labels of computed points concern them.
        if record is None or record.kind != CHARACTER or len(record.dimensions) != 2 or not name.startswith(COMPUTED_GROUPS):
            continue
        listed = parameters.raw_strings("POINT", name)
        read = parameters.text_of
        kept = [renamed[read(raw)].encode("utf-8") if read(raw) in renamed else raw for raw in listed if read(raw) not in gone]
        if kept != listed:
            width, processor = record.dimensions[0], parameters.processor
            # A list without an entry would be an array of size 0, which some readers refuse.
            changes["POINT", name] = strings_record(name, record.group, kept, width, processor, record) if kept else None
    return parameters.replaced(changes)


def with_events(parameters: Parameters, events: Sequence[Event]) -> Parameters:
    """The parameters with these events in the group EVENT, in place of those that it had."""
    parameters, group = with_group(parameters, "EVENT")
    changes: dict[tuple[str, str], Record | None] = {}
    for name in (*_EVENT_WIDTHS, "TIMES", "ICON_IDS", "GENERIC_FLAGS"):
        changes.update({("EVENT", key): None for key in numbered(parameters, "EVENT", name)})
    subject = next(iter(parameters.strings("SUBJECTS", "NAMES")), "")
    # What the file says of an event that stays is kept; only events in the header have nothing.
    written = [text for key in numbered(parameters, "EVENT", "DESCRIPTIONS") for text in parameters.strings("EVENT", key)]
    notes = dict(zip(events_of_group(parameters), written, strict=False))
    for record in event_records(events, group, parameters.processor, subject, notes):
        changes["EVENT", record.name] = record
    return parameters.replaced(changes)


def with_log(parameters: Parameters, log: Sequence[ProcessingStep]) -> Parameters:
    """The parameters with this processing log in the group ASTERISM, in place of the one that they had."""
    parameters, group = with_group(parameters, LOG_GROUP)
    return parameters.replaced({(LOG_GROUP, LOG): log_record(log, group, parameters.processor)})


def log_record(log: Sequence[ProcessingStep], group: int, processor: Processor) -> Record:
    """A processing log as one text, cut into lines that a parameter can hold. Where it is too long, the oldest steps are left out."""
    log = tuple(log)
    # What was done last says most of what the file holds now.
    while len(text := log_as_text(log).encode("ascii")) > _LOG_WIDTH * MOST_STRINGS:
        log = log[1:]
    lines = [text[at : at + _LOG_WIDTH] for at in range(0, len(text), _LOG_WIDTH)]
    return strings_record(LOG, group, lines, _LOG_WIDTH, processor)


def log_of(parameters: Parameters) -> tuple[ProcessingStep, ...]:
    """The processing log in the group ASTERISM; empty where the file has none."""
    record = parameters.find(LOG_GROUP, LOG)
    return () if record is None or record.kind != CHARACTER else log_from_text(record.data.decode("ascii", "replace"))


def with_group(parameters: Parameters, name: str) -> tuple[Parameters, int]:
    """The parameters with a group of this name, and its number."""
    group = parameters.group_id(name)
    if group is not None:
        return parameters, group
    used = {record.group for record in parameters.records if record.is_group}
    group = next(number for number in range(1, 128) if number not in used)
    # The new group comes first, so that its parameters can follow it.
    return replace(parameters, records=(make_group(name, group, processor=parameters.processor), *parameters.records)), group


def event_records(
    events: Sequence[Event], group: int, processor: Processor, subject: str = "", notes: Mapping[Event, str] | None = None
) -> list[Record]:
    """The parameters of the group EVENT; more than 255 events go on in LABELS2, TIMES2, ...; notes: descriptions of some events."""
    records = [integers_record("USED", group, [len(events)], (), processor)]
    for page, at in enumerate(range(0, len(events), MOST_STRINGS)):
        some = events[at : at + MOST_STRINGS]
        number = str(page + 1) if page else ""
        texts = {
            "CONTEXTS": [event.context for event in some],
            "LABELS": [event.label for event in some],
            "DESCRIPTIONS": [(notes or {}).get(event, "") for event in some],
            "SUBJECTS": [subject for _ in some],
        }
        for name, strings in texts.items():
            records.append(strings_record(name + number, group, [s.encode("utf-8") for s in strings], _EVENT_WIDTHS[name], processor))
        # Times are stored as minutes and seconds.
        minutes = [np.floor(event.time / 60) for event in some]
        times = [value for event, whole in zip(some, minutes, strict=True) for value in (whole, event.time - 60 * whole)]
        records.append(floats_record("TIMES" + number, group, times, (2, len(some)), processor))
        records.append(integers_record("ICON_IDS" + number, group, [_icon_of(event) for event in some], (len(some),), processor))
        flags = make_parameter("GENERIC_FLAGS" + number, group, 1, (len(some),), bytes(len(some)), processor=processor)
        records.append(flags)
    return records


def _icon_of(event: Event) -> int:
    return {"foot strike": 1, "foot off": 2}.get(event.label.casefold(), 0)
