"""How `asterism label` labels one file: models and a recording in; the labelling, held against the file's own names, and findings out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.cli._options import KnownLabels, Rules
from asterism.cli._standing import StandingTrials
from asterism.errors import AsterismError
from asterism.findings import Finding, Severity

if TYPE_CHECKING:
    from asterism.labelling import MarkerModel
    from asterism.progress import Progress
    from asterism.recording import Clouds, Disagreement, Labelling, MarkerSet, Recording

_PAIRS_TOLD = 4
"""Disagreements of names that a finding lists; the others are counted."""


@dataclass(frozen=True)
class Labelled:
    """A file's labelling.

    labelling   of the file's clouds, with the names of the file that hold
    marker_set  its names are the labelling's
    recording   the recording under these labels, as it is written
    subject     the trial by which the model was narrowed to the person; None where none was used
    known       what was done with the names of the file's points
    findings    what a person should know
    """

    labelling: Labelling
    marker_set: MarkerSet
    recording: Recording
    subject: Path | None
    known: KnownLabels | None
    findings: Sequence[Finding] = ()


@dataclass
class Labeller:
    """Labels files with one model, or with one for each body, narrowed to each file's person where a standing trial is known."""

    models: Sequence[MarkerModel]
    names: Sequence[str]
    standing: StandingTrials
    rules: Rules = Rules.WHOLE_BODY
    in_time: bool = True
    workers: int = 1
    _narrowed: dict[Path, MarkerModel | AsterismError] = field(default_factory=dict)

    @classmethod
    def of_models(
        cls, models: Sequence[Path], standing: StandingTrials, *, rules: Rules = Rules.WHOLE_BODY, in_time: bool = True, workers: int = 1
    ) -> Labeller:
        """With the models in these files. Raises AsterismError where one cannot be loaded, or the one trial of a subject cannot be used."""
        loaded, names = _loaded(models)
        alone = len(loaded) == 1 and rules is Rules.WHOLE_BODY
        labeller = cls(loaded, names, standing if alone else replace(standing, automatic=False), rules, in_time, workers)
        if len(standing.given) == 1:
            labeller._by(standing.given[0])
        return labeller

    def labelling_of(
        self, path: Path, clouds: Clouds, progress: Progress | None = None
    ) -> tuple[Labelling, MarkerSet, Path | None, list[Finding]]:
        """The labelling of a file's clouds, its marker set, the standing trial that was used, and findings."""
        trial, findings = self.standing.of(path), list[Finding]()
        model = self.models[0] if trial is None else self._narrowed_by(trial)
        labelling, marker_set = self._labelled(model, clouds, progress)
        if model is self.models[0]:
            trial = None
        elif _shows_subject(model, clouds, labelling) is False:
            findings.append(_other_subject(path, trial, given=bool(self.standing.given)))
            trial = None
            labelling, marker_set = self._labelled(self.models[0], clouds, progress)
        return labelling, marker_set, trial, findings + labelling.findings(str(path))

    def model_of(self, path: Path, parts: Iterable[Clouds]) -> tuple[MarkerModel, Path | None, list[Finding]]:
        """The model for a file, narrowed to its person where a trial is known; the trial; and findings.

        parts: of the file's clouds; the first one that shows the person tells whether the trial is of this person.
        """
        trial = self.standing.of(path)
        model = self.models[0] if trial is None else self._narrowed_by(trial)
        if model is self.models[0]:
            return model, None, []
        for clouds in parts:
            same = _shows_subject(model, clouds, model.label(clouds, workers=self.workers))
            if same is False:
                return self.models[0], None, [_other_subject(path, trial, given=bool(self.standing.given))]
            if same:
                break
        return model, trial, []

    def warm_up(self, clouds: Clouds) -> None:
        """Compile the kernels, so that the time of the first file leaves that out."""
        if len(clouds):
            self._labelled(self.models[0], clouds.frames([0]), None)

    def _labelled(self, model: MarkerModel, clouds: Clouds, progress: Progress | None) -> tuple[Labelling, MarkerSet]:
        """The labelling and its marker set."""
        from asterism.labelling import join_labellings, label_together

        if len(self.models) > 1:
            found = label_together(self.models, clouds, workers=self.workers, progress=progress)
            return join_labellings(found, [one.marker_set for one in self.models], self.names)
        if self.in_time:
            return model.label(clouds, workers=self.workers, progress=progress), model.marker_set
        return model.label_frames(clouds, method=self.rules.value, workers=self.workers, progress=progress), model.marker_set

    def _narrowed_by(self, trial: Path) -> MarkerModel:
        """The model narrowed by a trial; the model itself where a trial that nobody named cannot be used."""
        try:
            return self._by(trial)
        except (AsterismError, OSError):
            if self.standing.given:
                raise
            return self.models[0]

    def _by(self, trial: Path) -> MarkerModel:
        """The model narrowed by a trial, made once; the last few are kept."""
        from asterism import formats

        if trial not in self._narrowed:
            while len(self._narrowed) >= 8:
                self._narrowed.pop(next(iter(self._narrowed)))
            try:
                self._narrowed[trial] = self.models[0].adapt(formats.read(trial, vertical=self.standing.axis))
            except AsterismError as problem:
                sentence = str(problem)
                self._narrowed[trial] = AsterismError(sentence if trial.name in sentence else f"{trial}: {sentence}")
        found = self._narrowed[trial]
        if isinstance(found, AsterismError):
            raise found
        return found


def with_names_of_file(
    path: Path, recording: Recording, clouds: Clouds, labelling: Labelling, marker_set: MarkerSet, wanted: KnownLabels | None
) -> tuple[Labelling, Recording, KnownLabels | None, list[Finding]]:
    """The labelling with the names of the file that hold, the recording to which it belongs, what was done, and findings.

    wanted: None checks the names where the file is partly labelled, and else takes the model's labels alone; names of points that are no
    markers of the model stay in any case but `ignore`. Raises AsterismError where names are to be kept and two columns claim one marker.
    """
    wanted = settled_names(recording, marker_set, wanted)
    held, named, against = held_against_names(path, recording, clouds, labelling, marker_set, wanted)
    return held, named, wanted, findings_on_names(path, recording, against, wanted)


def settled_names(recording: Recording, marker_set: MarkerSet, wanted: KnownLabels | None) -> KnownLabels | None:
    """What becomes of the names of a file, where nobody has said: they are checked where it is partly labelled."""
    from asterism.recording import is_partly_labelled

    return KnownLabels.CHECK if wanted is None and is_partly_labelled(recording, marker_set) else wanted


def held_against_names(
    path: Path, recording: Recording, clouds: Clouds, labelling: Labelling, marker_set: MarkerSet, wanted: KnownLabels | None
) -> tuple[Labelling, Recording, tuple[Disagreement, ...]]:
    """The labelling with the names of the file that hold, the recording under the names of the set, and which names contradict."""
    from asterism.cli._recordings import labels_kept
    from asterism.recording import check_labels

    if wanted is KnownLabels.KEEP:
        return labels_kept(path, labelling, recording, clouds, marker_set), recording, ()
    checked, against = check_labels(labelling, recording, clouds, marker_set)
    renamed = replace(recording, labels=names_in_set(recording, marker_set, wanted))
    return checked if wanted is KnownLabels.CHECK else labelling, renamed, against


def names_in_set(recording: Recording, marker_set: MarkerSet, wanted: KnownLabels | None) -> tuple[str, ...]:
    """The labels of a recording, those of markers by the marker set's names; all as they are where they are kept."""
    return recording.labels if wanted is KnownLabels.KEEP else tuple(marker_set.name_of(label) or label for label in recording.labels)


def findings_on_names(path: Path, recording: Recording, against: Sequence[Disagreement], wanted: KnownLabels | None) -> list[Finding]:
    """What a person should know of names that contradict."""
    findings = list[Finding]()
    if against and wanted is not KnownLabels.IGNORE:
        findings.append(_disagreement(path, recording, against, Severity.WARNING if wanted is KnownLabels.CHECK else Severity.NOTE))
    if against:
        findings += _out_of_date(path, recording)
    return findings


def labelled_file(
    labeller: Labeller,
    path: Path,
    recording: Recording,
    clouds: Clouds,
    *,
    known: KnownLabels | None = None,
    by: str = "",
    progress: Progress | None = None,
) -> Labelled:
    """Label a recording that was read from a file."""
    labelling, marker_set, trial, findings = labeller.labelling_of(path, clouds, progress)
    labelling, named, known, more = with_names_of_file(path, recording, clouds, labelling, marker_set, known)
    written = named.with_labelling(labelling, clouds, keep_names=known is not KnownLabels.IGNORE, by=by)
    return Labelled(labelling, marker_set, written, trial, known, (*findings, *more))


def body_names(models: Sequence[Path]) -> list[str]:
    """What each body is called: its model's file, or a number where two files have one name."""
    names = [path.stem for path in models]
    return names if len(set(names)) == len(names) else [str(i + 1) for i in range(len(names))]


def _loaded(models: Sequence[Path]) -> tuple[list[MarkerModel], list[str]]:
    from asterism.labelling import MarkerModel

    loaded: Mapping[Path, MarkerModel] = {path: MarkerModel.load(path) for path in dict.fromkeys(models)}
    return [loaded[path] for path in models], body_names(models)


def _shows_subject(model: MarkerModel, clouds: Clouds, labelling: Labelling) -> bool | None:
    """Whether a recording is of the person to whom the model is adapted; None where it shows too little of anybody."""
    from asterism.labelling.marker_model import OTHER_SUBJECT_FIT

    fit = model.subject_fit(clouds, labelling)
    return None if math.isnan(fit) else fit >= OTHER_SUBJECT_FIT


def _other_subject(path: Path, trial: Path | None, *, given: bool) -> Finding:
    sentence = f"{path}: {trial} is not of this body, or its markers were placed again; the file was labelled without it."
    if given:
        return Finding("label-other-subject", Severity.WARNING, str(path), sentence, "Give a trial of the same session with --subject.")
    mend = "Name the person's standing trial with --subject, or look for none with --no-static."
    return Finding("label-other-subject", Severity.NOTE, str(path), sentence, mend)


def _disagreement(path: Path, recording: Recording, against: Sequence[Disagreement], severity: Severity) -> Finding:
    def told(each: Disagreement) -> str:
        first, last = each.first_frame + recording.first_frame, each.last_frame + recording.first_frame
        where = f"frame {first}" if each.frames == 1 else f"{each.frames} frames from {first} to {last}"
        return f"{each.name} is {each.given or 'at another point'} ({where})"

    listed = "; ".join(map(told, against[:_PAIRS_TOLD]))
    listed += f"; and {len(against) - _PAIRS_TOLD} more" if len(against) > _PAIRS_TOLD else ""
    sentence = f"{path}: names of the file contradict the labels given, which were written: {listed}."
    mend = "Look at them with `asterism review`; --known-labels keep leaves the file's names."
    return Finding("label-names-differ", severity, str(path), sentence, mend)


def _out_of_date(path: Path, recording: Recording) -> list[Finding]:
    """The finding that a file holds what a model computed from labels that are no more."""
    from asterism.formats import computed_labels

    computed = computed_labels(recording)
    if not computed:
        return []
    few = ", ".join(computed[:3]) + (", ..." if len(computed) > 3 else "")
    what = f"{len(computed)} computed points and angles ({few}) come" if len(computed) > 1 else f"the computed point {few} comes"
    sentence = f"{path}: {what} from labels that have changed."
    return [
        Finding(
            "label-computed-outdated", Severity.WARNING, str(path), sentence, "Compute them again, or leave them out with --drop-computed."
        )
    ]
