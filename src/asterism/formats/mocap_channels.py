"""What a stream says of its channels in; which of them are coordinates of which point, out. By XDF's convention for motion capture."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from asterism.recording import Ints

_AXIS = re.compile(r"^(?:position|pos)?[ _.:-]?([xyz])$", re.IGNORECASE)
_AXIS_OF_LABEL = re.compile(r"^(.*?)[ _.:-]?([xyz])$", re.IGNORECASE)
_BEFORE_LABEL = re.compile(r"^([xyz])[ _.:-](.+)$", re.IGNORECASE)
_ORIENTATION = re.compile(r"orientation|rotation|quat", re.IGNORECASE)
_COUNTER = re.compile(r"^(?:(?:frame|sample)[ _-]?(?:number|count|counter|index|no|id)|frame|counter)$", re.IGNORECASE)
_ANY = ("", "mocap", "position", "marker")
"""Types of channels that do not say which coordinate it is: then the label may."""


@dataclass(frozen=True, eq=False)
class ChannelLayout:
    """Which channels of a stream are what.

    columns  (P, 3) the channels of each point's x, y and z
    names    (P,) what the stream calls the points, "" for nothing
    unit     of length, as it is written there; None where it is not
    counter  the channel of a number that grows by one; None for none
    bodies   rigid bodies, whose places are no markers
    guessed  whether nothing says which channel is what
    """

    columns: Ints
    names: tuple[str, ...]
    unit: str | None = None
    counter: int | None = None
    bodies: int = 0
    guessed: bool = False


def layout_of_channels(channels: Sequence[Mapping[str, str]], count: int) -> ChannelLayout | None:
    """The layout of a stream of `count` channels; None where none of them are points.

    channels: what is said of each ("label", "marker", "object", "type", "unit"). Where less is said labels that end in x, y and z are
    believed; where nothing is, all channels in triples.
    """
    counter, units, oriented = None, list[str](), set[tuple[str, str]]()
    places = dict[tuple[str, str, int], dict[str, int]]()
    for at, channel in enumerate(channels[:count]):
        letter, key, turn = _axis_of(channel), _point_key(channel), 0
        if letter:
            # Points of one name are told apart by their order.
            while letter in places.get((*key, turn), {}):
                turn += 1
            places.setdefault((*key, turn), {})[letter] = at
            units.append(channel.get("unit", ""))
        elif _ORIENTATION.match(channel.get("type", "")):
            oriented.add(key)
        elif counter is None and any(_COUNTER.match(channel.get(said, "")) for said in ("label", "type")):
            counter = at
    whole = {key: axes for key, axes in places.items() if len(axes) == 3}
    # What has an orientation is a body; a marker has none.
    points = {key: axes for key, axes in whole.items() if key[:2] not in oriented}
    if points:
        columns = np.array([[axes[letter] for letter in "xyz"] for axes in points.values()])
        unit = max(set(units), key=units.count)
        return ChannelLayout(columns, tuple(marker or of for marker, of, _ in points), unit or None, counter, len(whole) - len(points))
    left = [at for at in range(count) if at != counter]
    if whole or any(channel.get("type") for channel in channels) or not left or len(left) % 3:
        return None
    return ChannelLayout(np.array(left).reshape(-1, 3), ("",) * (len(left) // 3), None, counter, guessed=True)


def _axis_of(channel: Mapping[str, str]) -> str:
    """x, y or z; "" for none."""
    kind = channel.get("type", "")
    found = _AXIS.match(kind)
    if found is None and kind.casefold() in _ANY and (of_label := _AXIS_OF_LABEL.match(channel.get("label", ""))):
        return of_label[2].lower()
    return "" if found is None else found[1].lower()


def _point_key(channel: Mapping[str, str]) -> tuple[str, str]:
    """What channels of one point share: its marker and its object, or its label without the x, y or z at one of its ends."""
    marker, of, label = channel.get("marker", ""), channel.get("object", ""), channel.get("label", "")
    if marker or of:
        return marker, of
    if before := _BEFORE_LABEL.match(label):
        return before[2], ""
    after = _AXIS_OF_LABEL.match(label)
    return (after[1] if after else label), ""
