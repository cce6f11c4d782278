"""What commands that label are asked to do in; the same as the session room labels, out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from asterism.cli import _console
from asterism.cli._options import KnownLabels, Rules, marker_names, vertical_axis
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.labelling import MarkerModel
    from asterism.recording import MarkerSet
    from asterism.session import FileLabeller, LabelledFile


class LabellingCommand(Protocol):
    """The options that commands which label have in common."""

    @property
    def model(self) -> list[Path] | None:
        """The models' files, one for each body; None for a model of virtual people."""
        ...

    @property
    def markers(self) -> list[str] | None:
        """Without a model, the marker sets worn; None where they are to be found."""
        ...

    @property
    def subject(self) -> list[Path] | None:
        """Trials of the person."""
        ...

    @property
    def no_static(self) -> bool:
        """Whether no standing trial is looked for."""
        ...

    @property
    def frame_wise(self) -> bool:
        """Whether each frame is labelled by itself."""
        ...

    @property
    def known_labels(self) -> KnownLabels | None:
        """What becomes of the names that points have already."""
        ...

    @property
    def keep_labels(self) -> bool:
        """Whether they are kept."""
        ...

    @property
    def workers(self) -> int:
        """Threads."""
        ...

    @property
    def vertical(self) -> str | None:
        """What points up."""
        ...


def file_labeller(
    command: LabellingCommand, files: Sequence[Path], batch: _console.Batch, *, rules: Rules = Rules.WHOLE_BODY, in_memory: bool = True
) -> FileLabeller:
    """What labels the files of a run. in_memory: whether whole recordings are needed, and not only what is written.

    What is to be known of the models is said, once. Raises AsterismError where a model or the one trial given cannot be used.
    """
    from asterism.session import FileLabeller, LabellingOptions, LabellingSettings

    options = LabellingOptions(
        settings=LabellingSettings(method=rules.value, frame_wise=command.frame_wise, workers=command.workers),
        file_names=file_names(command),
        standing=command.subject or (),
        find_standing=not command.no_static,
        vertical=vertical_axis(command.vertical),
        in_memory=in_memory,
        markers=worn_sets(command.markers),
    )
    labeller = FileLabeller.of_models(command.model, options, files) if command.model else FileLabeller((), options, files)
    # once for the run, not once for each file
    for finding in labeller.findings:
        batch.found(finding)
    return labeller


ROW = ("frames", "labelled", "likely", "unsure", "hidden", "subject", "worn", "verdict", "readiness", "use", "look_at")
"""What of a row of `labelled_row` the tables and lines need."""


def labelled_row(labelled: LabelledFile) -> dict[str, Any]:
    """What the tables, pages and JSON of all commands say of a labelled file, in plain values."""
    from asterism.recording import axis_name, label_shares

    return {
        "file": labelled.path,
        "frames": len(labelled.clouds),
        "vertical": axis_name(labelled.clouds.vertical),
        **asdict(label_shares(labelled.labelling, labelled.clouds)),
        "marker_set": [one.to_dict() for one in labelled.worn] or None,
        "worn": ", ".join(one.words for one in labelled.worn) or None,
        "virtual_people": bool(labelled.worn),
        "subject": labelled.standing,
        "known_labels": labelled.file_names,
        "verdict": None if labelled.verdict is None else labelled.verdict.kind,
        # what no label is more certain than, and why
        "max_confidence": None if labelled.verdict is None else labelled.verdict.max_confidence,
        "limited_by": None if labelled.verdict is None else labelled.verdict.limited_by,
        "readiness": labelled.readiness.kind,
        "use": labelled.readiness.words,
        "why": labelled.readiness.why or None,
        "look_at": labelled.readiness.look_at,
    }


def labelled_line(row: Mapping[str, Any]) -> str:
    """A row of `labelled_row` as a line, with the speed where the row has one."""
    from asterism.recording.display import counted

    # records of earlier versions say no vertical
    up = [f"{row['vertical']} up"] if "vertical" in row else []
    parts = [counted(row["frames"], "frame"), *up, shares_text(row)]
    if "frames_per_second" in row:
        parts.append(f"{_console.count(row['frames_per_second'])} frames/s")
    if row["subject"] is not None:
        parts.append(f"with {row['subject']}")
    worn = f"; {row['worn']}, a model of virtual people" if row["worn"] else ""
    why = f": {row['why']}" if row.get("why") else ""
    return f"{row['file']}: {', '.join(parts)}{worn}; {row['use']}{why}"


def shares_text(row: Mapping[str, Any]) -> str:
    """What became of a recording's markers, in words: the shares in `row`, as `LabelShares` names them."""
    from asterism.recording import LABEL_STATES

    return ", ".join(f"{_console.percent(row[name])} {name}" for name in LABEL_STATES)


def model_or_virtual(
    model: Path | None, markers: str | None, files: Sequence[Path], vertical: str | None
) -> tuple[MarkerModel, str | None]:
    """The model in a file; without one, that of virtual people who wear the set that is given, or worn in the first of the files.

    With the name of the set, where the people are virtual. Raises AsterismError where both are given, or no shipped set is worn.
    """
    from asterism import formats
    from asterism.labelling import MarkerModel, virtual_model
    from asterism.session import SetFinder

    if model is not None:
        if markers is not None:
            raise AsterismError(f"{model} has its own marker set; leave out --markers.")
        return MarkerModel.load(model), None
    axis = vertical_axis(vertical)
    finder = SetFinder(worn_sets(None if markers is None else [markers]), files, axis)
    # what is given needs no file
    # two people who are named in a file wear the same set
    worn, *_ = finder.given_sets() if markers is not None else finder.of(files[0], formats.read(files[0], vertical=axis))
    with _console.progress("making a model of virtual people") as progress:
        return virtual_model(worn.marker_set, progress=progress), worn.name


def worn_sets(given: Sequence[str] | None) -> list[str | MarkerSet]:
    """What each --markers means to the session room: a shipped set's name, a file, or the set of the names that it lists."""
    from asterism.recording import MarkerSet

    meant = [marker_names(one) for one in given or ()]
    return [one if isinstance(one, str) else MarkerSet.load(one or ()) for one in meant]


def model_text(command: LabellingCommand) -> str:
    """The models in words, for a page."""
    return ", ".join(map(str, command.model)) if command.model else f"virtual people, {', '.join(command.markers or ['markers found'])}"


def model_json(command: LabellingCommand) -> Path | list[Path] | None:
    """The models as JSON says them: one, several, or none."""
    return command.model[0] if command.model and len(command.model) == 1 else command.model


def file_names(command: LabellingCommand) -> KnownLabels | None:
    """What becomes of the names that points have already; None where each file decides."""
    return KnownLabels.KEEP if command.keep_labels else command.known_labels


def check_labelling(command: LabellingCommand, rules: Rules = Rules.WHOLE_BODY) -> None:
    """Raise AsterismError where options contradict each other."""
    models = command.model or ()
    bodies = max(len(models), len(command.markers or ()))
    if models and command.markers:
        raise AsterismError(f"{models[0]} has its own marker set; leave out --markers, or --model.")
    if not models and rules is not Rules.WHOLE_BODY:
        raise AsterismError(f"a model of virtual people has no solvers for the rules {rules.value}; leave out --rules, or give --model.")
    if bodies > 1 and (command.frame_wise or rules is not Rules.WHOLE_BODY):
        raise AsterismError(
            "several bodies are separated by their tracks over time; leave out --frame-wise and --rules, or give one --model."
        )
    if bodies > 1 and command.subject:
        raise AsterismError("a trial of the subject narrows one model; leave out --subject, or give one --model.")
    if command.subject and rules is not Rules.WHOLE_BODY:
        raise AsterismError(f"the rules {rules.value} do not use a body model that a trial could narrow; leave out --subject, or --rules.")
    if command.keep_labels and command.known_labels not in (None, KnownLabels.KEEP):
        raise AsterismError(f"--keep-labels contradicts --known-labels {command.known_labels.value}; give one of them.")
