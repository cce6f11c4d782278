"""The confidence of labels in a C3D file: an analog channel for each label, and the means in the group ASTERISM; in and out.

An analog channel is what other programs carry along and draw over time, whatever it holds. A point's residual would be the other place;
it has 8 bits, is the only record of how well the cameras saw the point, and programs drop points by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from asterism.errors import AsterismError
from asterism.formats._confidence import LabelConfidence
from asterism.formats.c3d._assemble import assembled
from asterism.formats.c3d._channels import ChannelTexts, with_channels, write_analog_header
from asterism.formats.c3d._edit import LOG_GROUP, MOST_STRINGS, floats_record, integers_record, strings_record, with_group
from asterism.formats.c3d._file import C3DFile, numbered, ranges
from asterism.formats.c3d._layout import LIMIT
from asterism.formats.c3d._numbers import Words
from asterism.formats.c3d._parameters import Parameters, Record
from asterism.recording import Floats, LabelStates

ENDING = " confidence"
"""What follows a label in the name of its channel."""
_CHANNELS = "CONFIDENCE_CHANNELS"
_STEPS = 10_000
"""Integers of a confidence of 1 in files of integers."""


@dataclass(frozen=True)
class LabelSummary:
    """What a recording's labels amount to.

    total   (M,) sum of the confidence of each label where it is given
    counts  in how many frames each is labelled, likely, unsure and hidden: (M,) each, by name
    """

    total: Floats
    counts: dict[str, Floats]

    @classmethod
    def of(cls, confidence: LabelConfidence, states: LabelStates) -> LabelSummary:
        """The summary of labels and their states."""
        # Labels that were not given have no confidence to sum.
        total = np.where(states.labelled | states.likely, np.nan_to_num(confidence.values), 0.0).sum(axis=0)
        return cls(total, {name: state.sum(axis=0).astype(float) for name, state in vars(states).items()})

    def plus(self, later: LabelSummary) -> LabelSummary:
        """The summary of these frames and of later ones."""
        return LabelSummary(self.total + later.total, {name: count + later.counts[name] for name, count in self.counts.items()})

    @property
    def mean_confidence(self) -> Floats:
        """(M,) mean confidence of each label where it is given; 0 for one that is not."""
        return np.asarray(self.total / np.maximum(self.counts["labelled"] + self.counts["likely"], 1))


@dataclass(frozen=True)
class Channels:
    """The analog channels of a file that has the confidence of its labels.

    kept        channels of the file that stay
    names       labels, a channel each
    samples     of a channel in each frame
    parameters  of the new file
    """

    kept: list[int]
    names: tuple[str, ...]
    samples: int
    parameters: Parameters

    @classmethod
    def of(cls, file: C3DFile, names: tuple[str, ...], summary: LabelSummary) -> Channels:
        """Those for a file. Raises AsterismError as `with_confidence` does."""
        general = file.parameters.number("ANALOG", "GEN_SCALE")
        # A general scale of zero would make every confidence 0.
        if general == 0.0:
            raise AsterismError(f"{file.path} scales all analog channels by zero (ANALOG:GEN_SCALE); correct it there.")
        kept = _kept_channels(file)
        # All channels of a file have as many samples per frame: ours follow the others.
        samples = max(1, file.layout.analog // file.analog_channels if file.analog_channels else 1)
        if samples * (len(kept) + len(names)) > LIMIT:
            raise AsterismError(f"{file.path}: {len(kept) + len(names)} analog channels are more than a C3D file can hold at this rate.")
        # Readers multiply by the general scale, which is divided out here.
        scale = (1.0 if file.layout.real else 1.0 / _STEPS) / (1.0 if general is None else general)
        texts = [(name + ENDING, "probability that the label is right", "") for name in names]
        parameters = with_channels(file, kept, [ChannelTexts(*each, scale) for each in texts], samples)
        return cls(kept, names, samples, _with_summary(parameters, names, summary, len(kept)))

    @property
    def width(self) -> int:
        """Analog words of a frame."""
        return self.samples * (len(self.kept) + len(self.names))

    def words(self, file: C3DFile, analog: Words, values: Floats) -> Words:
        """The analog words of some frames; analog: theirs in the file (frames, words); values (frames, M) of the confidence."""
        # One value per frame, repeated for each sample: confidence has no finer time.
        new = np.repeat(_encoded(file, values)[:, None], self.samples, axis=1)
        if file.analog_channels:
            new = np.concatenate([analog.reshape(len(values), self.samples, -1)[:, :, self.kept], new], axis=2)
        return new.reshape(len(values), -1)

    def write_header(self, raw: bytearray, file: C3DFile) -> None:
        """Write what the header of the new file says of its analog samples."""
        write_analog_header(raw, file, self.width, self.samples)


def with_confidence(file: C3DFile, confidence: LabelConfidence, states: LabelStates) -> bytearray:
    """The bytes of a file with the confidence of its labels, in place of one that it had.

    confidence  names (M,) and values (T, M) in [0, 1]; states: theirs. Other channels keep their samples, numbers and order.
    Raises AsterismError where a frame would hold more analog samples than a C3D file can, or the general scale of its channels is zero.
    """
    channels, points = Channels.of(file, confidence.names, LabelSummary.of(confidence, states)), 4 * file.layout.points
    raw, words = assembled(file, channels.parameters, points + channels.width, file.layout.points, None)
    # Some frames at a time: a long file is not in memory twice.
    for some in ranges(file.layout.frames):
        words[some, :points] = file.words[some, :points]
        words[some, points:] = channels.words(file, file.words[some, points:], confidence.values[some])
    channels.write_header(raw, file)
    return raw


def confidence_of(file: C3DFile) -> LabelConfidence | None:
    """The confidence of the labels in a file; None where it has none."""
    channels = _own_channels(file)
    if not channels:
        return None
    labels = [text for key in numbered(file.parameters, "ANALOG", "LABELS") for text in file.parameters.strings("ANALOG", key)]
    samples = max(1, file.layout.analog // file.analog_channels)
    # The first sample of each frame, the others being copies of it.
    values = np.clip(file.analog[::samples][: file.layout.frames, channels], 0.0, 1.0)
    return LabelConfidence(tuple(labels[channel].removesuffix(ENDING) for channel in channels), values)


def _own_channels(file: C3DFile) -> list[int]:
    """The channels that hold the confidence of labels, as the file says."""
    said = file.parameters.counts(LOG_GROUP, _CHANNELS)
    labels = sum(len(file.parameters.strings("ANALOG", key)) for key in numbered(file.parameters, "ANALOG", "LABELS"))
    # Another program may have changed the channels since: then what is said of them counts for nothing.
    if len(said) != 2 or said[0] < 1 or said[0] - 1 + said[1] > min(file.analog_channels, labels):
        return []
    return list(range(said[0] - 1, said[0] - 1 + said[1]))


def _kept_channels(file: C3DFile) -> list[int]:
    own = set(_own_channels(file))
    return [channel for channel in range(file.analog_channels) if channel not in own]


def _encoded(file: C3DFile, values: Floats) -> Words:
    """(T, M) words of a confidence; 0 for one that is not known."""
    # NaN would be a number of its own to most programs.
    known = np.nan_to_num(np.clip(values, 0.0, 1.0))
    if file.layout.real:
        return file.processor.words_of_floats(known)
    # Rounded down: a confidence never reads higher than it is.
    return file.processor.words_of_integers(np.floor(known * _STEPS + 1e-9).astype(np.int16))


def _with_summary(parameters: Parameters, names: Sequence[str], summary: LabelSummary, first: int) -> Parameters:
    """The group ASTERISM with the labels, their mean confidence where they are given, and in how many frames each is what."""
    parameters, group = with_group(parameters, LOG_GROUP)
    processor = parameters.processor
    columns = {"CONFIDENCE": summary.mean_confidence.tolist(), **{name.upper(): count.tolist() for name, count in summary.counts.items()}}
    changes: dict[tuple[str, str], Record | None] = {
        # Old lists go, also those of a label that is no longer there.
        (LOG_GROUP, key): None
        for name in ("LABELS", *columns)
        for key in numbered(parameters, LOG_GROUP, name)
    }
    for page, at in enumerate(range(0, len(names), MOST_STRINGS)):
        number = str(page + 1) if page else ""
        some = slice(at, at + MOST_STRINGS)
        changes[LOG_GROUP, "LABELS" + number] = strings_record(
            "LABELS" + number, group, [name.encode("utf-8") for name in names[some]], 4, processor
        )
        for name, values in columns.items():
            part = values[some]
            changes[LOG_GROUP, name + number] = floats_record(name + number, group, part, (len(part),), processor)
    changes[LOG_GROUP, _CHANNELS] = integers_record(_CHANNELS, group, [first + 1, len(names)], (2,), processor)
    return parameters.replaced(changes)
