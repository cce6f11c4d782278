"""Model outputs and gait parameters in; a C3D file with them, under the names and in the lists of gait programs, out.

Angles, moments, powers, forces and joint centres are points of the file, listed by POINT:ANGLES and so on with the unit of the list;
parameters are the group ANALYSIS. What the file had under the same name is replaced in its place; everything else stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from asterism.errors import AsterismError
from asterism.files.atomic import write_atomically
from asterism.formats.c3d._assemble import assembled
from asterism.formats.c3d._edit import MOST_STRINGS, floats_record, integers_record, label_parameters, strings_record, with_group
from asterism.formats.c3d._file import C3DFile, numbered, parse_c3d, ranges
from asterism.formats.c3d._fresh import fresh_c3d, residual_steps
from asterism.formats.c3d._layout import LIMIT
from asterism.formats.c3d._parameters import CHARACTER, Parameters, Record, make_parameter
from asterism.formats.c3d._reader import unit_of
from asterism.formats.c3d._writer import missing_words, rewritten
from asterism.recording import Floats, Recording

_DEGREES = float(np.degrees(1.0))
_LISTS: dict[str, tuple[str, dict[str, float]]] = {
    "ANGLES": ("ANGLE", {"deg": _DEGREES, "degree": _DEGREES, "degrees": _DEGREES, "rad": 1.0}),
    "FORCES": ("FORCE", {"N": 1.0, "kN": 0.001}),
    "MOMENTS": ("MOMENT", {"Nmm": 1000.0, "Nm": 1.0}),
    "POWERS": ("POWER", {"W": 1.0, "mW": 1000.0}),
    "MODELED_MARKERS": ("MODELED_MARKER", {}),
}
"""The lists of POINT, what TYPE_GROUPS calls an entry of them, and their units: the first is that of a file that has none yet."""
_FIELDS = {"NAMES": 32, "DESCRIPTIONS": 80, "SUBJECTS": 32, "CONTEXTS": 16, "UNITS": 32}
"""Texts of the group ANALYSIS, with their widths."""


@dataclass(frozen=True)
class ModelPoint:
    """One output of a model over time.

    name    such as "LKneeAngles"
    kind    the list that it belongs to: ANGLES, FORCES, MOMENTS, POWERS or MODELED_MARKERS
    values  (T, 3) rad, N, N m, W (per kg, as gait programs have them) or m, in the recording's axes; NaN where it is not known
    filled  (T,) m, the largest standard deviation of a filled marker behind it; NaN where all were measured
    """

    name: str
    kind: str
    values: Floats
    filled: Floats | None = None


@dataclass(frozen=True)
class AnalysisValue:
    """An entry of the group ANALYSIS, such as Cadence; `context` "Left" or "Right"."""

    name: str
    context: str
    value: float
    unit: str
    description: str = ""


def write_model_outputs(path: Path, recording: Recording, points: Sequence[ModelPoint], values: Sequence[AnalysisValue]) -> list[str]:
    """Write a recording as C3D with the outputs of a model; a file at `path` is replaced completely or not at all.

    The recording is written as `write_c3d` does, into a copy of its file. An output replaces all points of its name, else follows the last
    point. A sample that is not known is written as a missing point. One that a filled marker is behind has as its residual the
    marker's standard deviation, in steps; others have 0. A file of integers becomes one of real numbers, because its steps are too
    coarse for powers. O(T points).

    Returns what the reader of the file must know: units that had to be changed.
    Raises AsterismError where the recording does not fit its source, or the file cannot be written.
    """
    if not recording.labels or not len(recording):
        what = "no frames" if recording.labels else "no points"
        raise AsterismError(f"{path}: the recording has {what}, and a C3D file needs both; nothing was written.")
    source = recording.source
    file = parse_c3d(rewritten(source, recording, str(path)) if isinstance(source, C3DFile) else fresh_c3d(recording, str(path)), str(path))
    if not file.layout.real:
        file = parse_c3d(as_real(file), str(path))
    data, told = _with_outputs(file, points, values)
    write_atomically(path, data)
    return told


def as_real(file: C3DFile) -> bytearray:
    """The bytes of a file of integers, its samples as real numbers of the same value; everything else stays."""
    parameters, group = with_group(file.parameters, "POINT")
    scale = floats_record("SCALE", group, [-file.scale], (), file.processor)
    parameters = parameters.replaced({("POINT", "SCALE"): scale})
    out, words = assembled(file, parameters, file.layout.width, file.layout.points, None, real=True)
    out[12:16] = scale.data
    points, unsigned = 4 * file.layout.points, file.parameters.text("ANALOG", "FORMAT").upper() == "UNSIGNED"
    for some in ranges(file.layout.frames):
        old = np.ascontiguousarray(file.words[some])
        values = file.processor.integers(old).astype(np.float64)
        # Only analog samples may be without a sign.
        if unsigned:
            values[:, points:] = old[:, points:]
        # Real coordinates are in the file's unit, not in steps.
        values[:, :points].reshape(len(values), -1, 4)[:, :, :3] *= file.scale
        words[some] = file.processor.words_of_floats(values)
    return out


def _with_outputs(file: C3DFile, outputs: Sequence[ModelPoint], values: Sequence[AnalysisValue]) -> tuple[bytearray, list[str]]:
    # Of a file with one subject, outputs have that subject's prefix, also where some points have none.
    subjects = {label.rpartition(":")[0] for label in file.labels if ":" in label}
    prefix = f"{min(subjects)}:" if len(subjects) == 1 else ""
    seen = [label.removeprefix(prefix) for label in file.labels]
    labels, descriptions = list(file.raw_labels), list(file.descriptions)
    places: list[list[int]] = []
    for output in outputs:
        own = [place for place, label in enumerate(seen) if label == output.name]
        if not own:
            own = [len(labels)]
            labels.append((prefix + output.name).encode("utf-8"))
            descriptions.append(b"")
        places.append(own)
    if len(labels) > LIMIT:
        raise AsterismError(f"{file.path}: {len(labels)} points are more than the {LIMIT} that a C3D file can hold.")
    parameters = file.parameters
    if len(labels) > len(file.raw_labels):
        parameters = parameters.replaced(label_parameters(file, labels, descriptions))
    parameters, factors, told = _listed(file, parameters, outputs, prefix)
    parameters = with_analysis(parameters, values)
    out, words = assembled(file, parameters, 4 * len(labels) + file.layout.analog, len(labels), None)
    words[:, : 4 * file.layout.points] = file.words[:, : 4 * file.layout.points]
    words[:, 4 * len(labels) :] = file.words[:, 4 * file.layout.points :]
    missing, steps = missing_words(file), abs(file.scale) * unit_of(file)[0]
    for output, own in zip(outputs, places, strict=True):
        filled = np.zeros(len(output.values)) if output.filled is None else residual_steps(output.filled / steps)
        # Where all residuals are negative, a 0 would stand out as the only measured point.
        residual = np.full(len(filled), -1.0) if file.residuals_are_unused else filled
        known = np.asarray(np.isfinite(output.values).all(axis=1))
        column = np.tile(missing, (len(output.values), 1))
        new = np.concatenate([output.values[known] * factors[output.kind], residual[known, None]], axis=1)
        column[known] = file.processor.words_of_floats(new)
        for place in own:
            words[:, 4 * place : 4 * place + 4] = column
    return out, told


def _listed(
    file: C3DFile, parameters: Parameters, outputs: Sequence[ModelPoint], prefix: str
) -> tuple[Parameters, dict[str, float], list[str]]:
    """The parameters with the outputs in the lists of POINT; by what SI values are multiplied in each list; and what had to be changed."""
    parameters, group = with_group(parameters, "POINT")
    processor, told = parameters.processor, []
    factors = {"MODELED_MARKERS": 1.0 / unit_of(file)[0]}
    changes: dict[tuple[str, str], Record | None] = {}
    pairs = parameters.strings("POINT", "TYPE_GROUPS")
    for kind in dict.fromkeys(output.kind for output in outputs):
        entry, units = _LISTS[kind]
        unit_name = f"{entry}_UNITS"
        declared = parameters.text("POINT", unit_name)
        if kind == "MODELED_MARKERS":
            unit = parameters.text("POINT", "UNITS") or "mm"
        else:
            unit = declared if declared in units else next(iter(units))
            factors[kind] = units[unit]
        if declared and declared != unit:
            told.append(f"POINT:{unit_name} was {declared!r}, and is {unit!r} now, in which the new {kind.lower().replace('_', ' ')} are")
        if declared != unit:
            changes["POINT", unit_name] = make_parameter(
                unit_name, group, CHARACTER, (len(unit.encode()),), unit.encode(), processor=processor
            )
        listed = {label for key in numbered(parameters, "POINT", kind) for label in parameters.strings("POINT", key)}
        new = [(prefix + output.name).encode("utf-8") for output in outputs if output.kind == kind]
        new = [label for label in new if label.decode("utf-8") not in listed]
        if new:
            # A list is continued on its last page; more than 255 names make another one.
            key = numbered(parameters, "POINT", kind)[-1]
            old = parameters.find("POINT", key)
            before = parameters.raw_strings("POINT", key)
            if len(before) + len(new) > MOST_STRINGS:
                key, old, before = f"{kind}{len(numbered(parameters, 'POINT', kind)) + 1}", None, []
            width = old.dimensions[0] if old is not None and len(old.dimensions) > 1 else 4
            changes["POINT", key] = strings_record(key, group, [*before, *new], width, processor, old)
        if kind not in pairs[::2]:
            pairs += [kind, entry]
    if pairs != parameters.strings("POINT", "TYPE_GROUPS"):
        width = max(map(len, pairs))
        data = b"".join(text.encode("utf-8").ljust(width) for text in pairs)
        changes["POINT", "TYPE_GROUPS"] = make_parameter(
            "TYPE_GROUPS", group, CHARACTER, (width, 2, len(pairs) // 2), data, processor=processor
        )
    return parameters.replaced(changes), factors, told


def with_analysis(parameters: Parameters, values: Sequence[AnalysisValue]) -> Parameters:
    """The parameters with these entries of the group ANALYSIS; those that it had with the same name and context are replaced."""
    if not values:
        return parameters
    subject = next(iter(parameters.strings("SUBJECTS", "NAMES")), "")
    entries: dict[tuple[str, str], tuple[dict[str, bytes], float]] = {}
    columns = {name: [raw for key in numbered(parameters, "ANALYSIS", name) for raw in parameters.raw_strings("ANALYSIS", key)]
               for name in _FIELDS}  # fmt: skip
    numbers = [float(value) for key in numbered(parameters, "ANALYSIS", "VALUES") for value in parameters.values("ANALYSIS", key)]
    used = parameters.count("ANALYSIS", "USED")
    for place, number in enumerate(numbers[: len(numbers) if used is None else used]):
        texts = {name: column[place].rstrip() if place < len(column) else b"" for name, column in columns.items()}
        entries[parameters.text_of(texts["NAMES"]), parameters.text_of(texts["CONTEXTS"])] = texts, number
    for one in values:
        fields = {"NAMES": one.name, "DESCRIPTIONS": one.description, "SUBJECTS": subject, "CONTEXTS": one.context, "UNITS": one.unit}
        entries[one.name, one.context] = {name: text.encode("utf-8") for name, text in fields.items()}, one.value
    parameters, group = with_group(parameters, "ANALYSIS")
    processor = parameters.processor
    changes: dict[tuple[str, str], Record | None] = {
        ("ANALYSIS", key): None for name in (*_FIELDS, "VALUES") for key in numbered(parameters, "ANALYSIS", name)
    }
    changes["ANALYSIS", "USED"] = integers_record("USED", group, [len(entries)], (), processor)
    every = list(entries.values())
    for page, at in enumerate(range(0, len(every), MOST_STRINGS)):
        ending, some = str(page + 1) if page else "", every[at : at + MOST_STRINGS]
        for name, width in _FIELDS.items():
            texts_of = [texts[name] for texts, _ in some]
            changes["ANALYSIS", name + ending] = strings_record(name + ending, group, texts_of, width, processor)
        column = floats_record("VALUES" + ending, group, [value for _, value in some], (len(some),), processor)
        changes["ANALYSIS", "VALUES" + ending] = column
    return parameters.replaced(changes)
