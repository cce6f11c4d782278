"""The one way of a file to its labels: a path, models and options in; a `LabelledFile` out.

Where no model is given, the marker set worn is found among the shipped ones, and a model of virtual people labels. A short file is a long
one of a single stretch. Each file goes through the same steps: its person's standing trial narrows the model, its frames are labelled range
by range, and the names that its points have already are held against the labels.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from asterism.errors import AsterismError
from asterism.findings import Finding, Severity
from asterism.labelling.body.subject import SubjectRules
from asterism.labelling.correction.readiness import DO_NOT_USE
from asterism.labelling.marker_model import OTHER_SUBJECT_FIT, MarkerModel
from asterism.labelling.recording_labeller import LabelledBodies, RecordingLabeller, WiderModel
from asterism.labelling.stretches import JoinedLabelling, label_in_stretches, stretches_of
from asterism.labelling.virtual_model import virtual_model
from asterism.labelling.whole.bodies import SeveralBodies
from asterism.labelling.whole.verdict import MIN_FRAMES
from asterism.progress import Progress
from asterism.recording import Clouds, Disagreement, Ints, Labelling, MarkerSet, Recording
from asterism.recording.display import counted, significant
from asterism.recording.verdict import OTHER_BODY
from asterism.session.coincident import coincident_findings
from asterism.session.labelled import LabelledFile
from asterism.session.left_over import LeftOver, left_on_body, sets_to_name
from asterism.session.mirror import mirror_findings
from asterism.session.names import choose_name_policy, findings_on_names, join_disagreements, merge_file_names
from asterism.session.options import LabellingOptions
from asterism.session.people import in_order_of_names, people_in
from asterism.session.sources import FrameSource, open_source
from asterism.session.standing import StandingTrials
from asterism.session.upright import labelled_upright, vertical_finding
from asterism.session.wider import wider_model
from asterism.session.worn import BY_NAMES, BY_POINTS, FRAMES_TO_FIND, GIVEN, FindRules, SetFinder, WornMarkers

_WORTH_TELLING = 0.01
"""Probability below which another set is not named."""

_NUMBERS = {2: "two", 3: "three", 4: "four"}

_MOST = 0.5
"""Share of a set's markers that a usual frame shows where the set is worn."""

_FRAMES_LEFT_OVER = 200
"""Frames in which points without a label are counted; half and double do as well."""

_NARROWED_KEPT = 8
"""Narrowed models that are kept. Files of one person follow each other; a model has some megabytes."""


class _OtherSubject(Exception):
    """The standing trial is not of the person in the recording."""


@dataclass(frozen=True)
class _Person:
    """Who is labelled: the models, or the one that a trial has narrowed to the person, and this trial."""

    labeller: RecordingLabeller
    narrowed: MarkerModel | None = None
    trial: Path | None = None


@dataclass
class _Labels:
    """What labelling a source has found."""

    labelling: Labelling
    bodies: LabelledBodies | None
    against: list[Disagreement]
    source: FrameSource


@dataclass
class FileLabeller:
    """Labels the files of a run with one model, or with one for each body in the volume, or with those of virtual people.

    models   one for each body; none where each file's marker set is to be found, and a model of virtual people to label it
    options  what a person chose for the run
    files    of the run, among which standing trials are looked for
    names    what each body is called where two have markers of one name; by default 1, 2, ...
    findings on the models
    wider    labels in place of the one model, see `wider_model`
    """

    models: Sequence[MarkerModel]
    options: LabellingOptions = field(default_factory=LabellingOptions)
    files: Sequence[Path] = ()
    names: Sequence[str] | None = None
    findings: Sequence[Finding] = ()
    wider: WiderModel | None = None
    _narrowed: dict[Path, MarkerModel | AsterismError] = field(default_factory=dict)
    _compiled: bool = False
    _of_sets: dict[tuple[str, ...], FileLabeller] = field(default_factory=dict)
    _of_wider_sets: dict[tuple[str, ...], FileLabeller] = field(default_factory=dict)
    _of_named: dict[tuple[str, ...], FileLabeller] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.models and self.options.markers:
            raise AsterismError("a model has its own marker set; give either the model or the markers.")
        self._finder = SetFinder(self.options.markers, self.files, self.options.vertical)
        if not self.models:
            # a set that cannot be used is told before any file is read
            if self.options.markers:
                self._of_worn(self._finder.given_sets(), None)
            return
        # only a model that labels by the body can be narrowed to one, and only where there is one
        # what votes by partial solvers has no body to narrow
        alone = len(self.models) == 1 and self.options.settings.method == "whole-body"
        find = alone and self.options.find_standing
        self._standing = StandingTrials(self.files, self.options.standing, find, self.options.vertical)
        self._plain = RecordingLabeller(self.models, self.options.settings, self.names, self.wider)
        if len(self.options.standing) == 1:
            self._narrowed_by(self.options.standing[0])

    @classmethod
    def of_models(cls, models: Sequence[Path], options: LabellingOptions, files: Sequence[Path] = ()) -> FileLabeller:
        """With the models in these files. Raises AsterismError where one cannot be loaded, or the one trial given cannot be used."""
        from asterism import __version__

        loaded = {path: MarkerModel.load(path) for path in dict.fromkeys(models)}
        # files say what labelled them, unless somebody has said it otherwise
        by = options.by or f"asterism {__version__}, {', '.join(path.name for path in models)}"
        findings = [finding for path, model in loaded.items() for finding in model.findings(str(path))]
        return cls([loaded[path] for path in models], replace(options, by=by), files, body_names(models), findings)

    @property
    def marker_set(self) -> MarkerSet | None:
        """The names of the markers of all bodies; None where each file's set is to be found."""
        return self._plain.marker_set if self.models else None

    @property
    def about(self) -> dict[str, Any]:
        """What is known of the first model: what it was trained on. Of models of virtual people, the sets that were taken so far."""
        if self.models:
            return dict(self.models[0].about)
        return {"virtual_people_of": ", ".join(dict.fromkeys(name for names in self._of_sets for name in names))}

    def label(self, path: Path, progress: Progress | None = None) -> LabelledFile:
        """Label a file.

        Raises AsterismError where it cannot be read, its kind NoMarkers where no frame has a point, or where names are to be kept that
        contradict each other.
        """
        path = Path(path)
        if not self.models:
            return self._label_worn(path, progress)
        if self.options.vertical is not None:
            source = self._open(path, self.options.vertical)
            people = self._of_people(source.about)
            return people.label(path, progress) if people is not None else self._label_source(path, source, progress)
        source = self._open(path, None)
        people = self._of_people(source.about)
        if people is not None:
            return people.label(path, progress)
        recording = source.frames(_beginning(source))
        said, other = source.about.vertical, labelled_upright(self._plain, recording)
        labelled = self._label_source(path, source if other is None else self._open(path, other), progress)
        # whatever points up, the body may be another: then all axes are tried before it is refused
        refused = labelled.verdict is not None and labelled.verdict.kind == OTHER_BODY
        if other is None and (refused or not labelled.given):
            other = labelled_upright(self._plain, recording, every=True)
            turned = labelled if other is None else self._label_source(path, self._open(path, other), progress)
            # labels that are not to be used do not show that the file is wrong
            believed = turned.given > labelled.given and turned.readiness.kind != DO_NOT_USE
            labelled, other = (turned, other) if believed else (labelled, None)
        if other is None:
            return labelled
        return replace(labelled, found=(vertical_finding(str(path), said, other), *labelled.found))

    def _of_people(self, recording: Recording) -> FileLabeller | None:
        """What labels a file whose names are of several people ("Ann:LKNE", "Bob:LKNE"): a body for each, called as the file calls them.

        None where there is one person, it is labelled so already, or the models are of another number of bodies, or not alike.
        """
        model = self.models[0]
        one_model = self.options.settings.in_time and all(other is model for other in self.models)
        subject = str(recording.metadata.get("subject") or "")
        people = tuple(people_in(recording.labels, model.marker_set, subject, bodies=len(self.models)))
        if not one_model or len(people) < 2 or len(self.models) not in (1, len(people)) or tuple(self.names or ()) == people:
            return None
        if people not in self._of_named:
            self._of_named[people] = FileLabeller([model] * len(people), self.options, self.files, people, self.findings)
        return self._of_named[people]

    def _open(self, path: Path, vertical: ArrayLike | str | None) -> FrameSource:
        """The recording of a file. Raises AsterismError as `label` does."""
        # several bodies are told apart over the whole recording, and a page shows all points: both need it in memory
        by_ranges = self._plain.can_divide and not self.options.in_memory
        source = open_source(path, replace(self.options, vertical=vertical), by_ranges=by_ranges)
        self._compile(source)
        return source

    def _label_source(self, path: Path, source: FrameSource, progress: Progress | None) -> LabelledFile:
        """Label the recording of a file. Raises AsterismError as `label` does."""
        person, findings = self._person(path), list(source.about.warnings)
        started = time.perf_counter()
        # the names of all columns decide at once, so that all stretches treat them alike
        policy = choose_name_policy(source.about, self._plain.marker_set, self.options.file_names)
        try:
            found = self._labels(path, source, person, policy, progress)
        except _OtherSubject:
            # the narrowed model labels somebody else worse than the plain one
            findings.append(_other_subject(path, person.trial, given=bool(self.options.standing)))
            person = _Person(self._plain)
            found = self._labels(path, source, person, policy, progress)
        # the copy is made last: only now all stretches have said which columns they use
        copy = found.source.finish(found.labelling, policy, self.options.by)
        seconds = time.perf_counter() - started
        findings += found.labelling.findings(str(path))
        findings += _nothing_labelled(path, found.labelling) or _few_frames(path, source.counts)
        clouds = source.clouds(_beginning(source))
        findings += coincident_findings(str(path), clouds)
        findings += mirror_findings(str(path), self._plain, found.labelling, clouds)
        findings += findings_on_names(path, source.about, self._plain.marker_set, found.against, policy)
        return LabelledFile(
            path,
            found.labelling,
            self._plain.marker_set,
            tuple(findings),
            person.trial,
            policy,
            tuple(self.models),
            person.labeller,
            found.bodies,
            seconds,
            found.source.about,
            copy,
        )

    def _label_worn(self, path: Path, progress: Progress | None) -> LabelledFile:
        """Label a file whose marker set is to be found. Raises AsterismError as `label` does, and where no shipped set is like it."""
        # finding reads the points of a few frames; of a long file, only of its beginning
        source = open_source(path, self.options, by_ranges=True)
        recording = source.frames(_beginning(source))
        try:
            worn = self._finder.of(path, recording if recording.clouds().counts.any() else source.about)
        except AsterismError as problem:
            # what is wrong with the file may be why
            raise type(problem)(" ".join([str(problem), *(finding.sentence for finding in source.about.warnings)])) from None
        bodies = [body for one in worn for body in one.bodies]
        labeller, said, shown = self._of_worn(bodies, progress), recording.vertical, worn[0].vertical
        upright = (recording if shown is None else replace(recording, vertical=shown)).clouds()
        # a person's standing trial narrows the model of the set itself
        if len(bodies) == 1 and self.options.settings.in_time and not self.options.standing:
            wider = wider_model(labeller.models[0], upright, progress=progress)
            labeller = labeller if wider is None else self._of_wider(labeller, wider)
        if shown is None:
            labelled = labeller.label(path, progress)
        else:
            # with which vertical the points are a body was asked already
            turned = not np.allclose(shown, said)
            labelled = labeller._label_source(path, labeller._open(path, shown if turned else self.options.vertical), progress)
            if turned and labelled.given:
                labelled = replace(labelled, found=(vertical_finding(str(path), said, shown), *labelled.found))
        findings = [*labelled.found, *findings_on_sets(path, bodies, self._finder.rules)]
        if BY_NAMES not in {one.by for one in bodies}:
            findings = [_with_sets(one, bodies, upright) if one.code == "label-nothing" else one for one in findings]
            findings += _other_set(path, labelled, bodies, upright)
        if labeller.wider is not None:
            findings.append(_explained_by(path, labeller.wider.name, bodies[0].name, _left_over(labelled, upright)))
        return replace(labelled, worn=tuple(bodies), found=tuple(findings))

    def _of_wider(self, labeller: FileLabeller, wider: WiderModel) -> FileLabeller:
        """What labels the files of a set whose points another model explains better, made once."""
        key = (*labeller.models[0].marker_set.names, *wider.model.marker_set.names)
        if key not in self._of_wider_sets:
            options = replace(labeller.options, find_standing=False)
            self._of_wider_sets[key] = FileLabeller(labeller.models, options, self.files, labeller.names, wider=wider)
        return self._of_wider_sets[key]

    def _of_worn(self, worn: Sequence[WornMarkers], progress: Progress | None) -> FileLabeller:
        """What labels the files in which these sets are worn, made once."""
        from asterism import __version__

        names = tuple(one.name for one in worn)
        if names not in self._of_sets:
            # people who wear one set are told to have one model
            of_set = {one.name: virtual_model(one.marker_set, progress=progress) for one in worn}
            models = [of_set[name] for name in names]
            by = self.options.by or f"asterism {__version__}, virtual people, {', '.join(names)}"
            of_bodies = [Path(name).stem for name in names]
            self._of_sets[names] = FileLabeller(
                models, replace(self.options, by=by, markers=()), self.files, of_bodies if len(set(of_bodies)) == len(of_bodies) else None
            )
        return self._of_sets[names]

    def _labels(self, path: Path, source: FrameSource, person: _Person, policy: str | None, progress: Progress | None) -> _Labels:
        """The labels of a source, and the names that contradict them. Raises _OtherSubject where the trial is of somebody else."""
        rules, frames = self.options.settings.stretches, slice(0, len(source.counts))
        parts = stretches_of(source.counts, source.about.rate, rules) if self._plain.can_divide else [frames]
        try:
            return self._labels_in(parts, path, source, person, policy, progress, two=False)
        except SeveralBodies:
            if not self._plain.can_divide:
                raise
            # two people are told apart by their tracks over the whole recording
            return self._labels_in([frames], path, source.whole(), person, policy, progress, two=True)

    def _labels_in(
        self,
        parts: Sequence[slice],
        path: Path,
        source: FrameSource,
        person: _Person,
        policy: str | None,
        progress: Progress | None,
        *,
        two: bool,
    ) -> _Labels:
        """The labels of a source in these stretches. two: whether two people wear the one model's markers."""
        labeller, marker_set = person.labeller, self._plain.marker_set
        keep = self.options.keep_tracklets and len(parts) == 1 and len(person.labeller.models) == 1
        bodies = list[LabelledBodies]()

        def label(clouds: Clouds, report: Progress | None) -> Labelling:
            found = labeller.label_two(clouds, report) if two else labeller.label_bodies(clouds, report, keep_tracklets=keep)
            # the points alone do not say which of like bodies is whose; the names of the file do
            bodies[:] = [in_order_of_names(found, source.about.labels, clouds, labeller) if two or len(labeller.models) > 1 else found]
            return bodies[0].labelling

        # a source that is not in memory wants its labels small, too
        joined = JoinedLabelling(marker_set.names, len(source.counts), len(parts), compact=source.compact)
        against, undecided = list[tuple[int, Disagreement]](), person.narrowed
        source.begin(marker_set)
        for begin, piece in label_in_stretches(label, source.clouds, parts, progress=progress):
            here = slice(begin, begin + len(piece.indices))
            recording, clouds = source.frames(here), source.clouds(here)
            if undecided is not None:
                # the first piece that shows enough of the person tells whose body it is
                same = _shows_subject(undecided, clouds, piece, self.options.settings.subject)
                if same is False:
                    raise _OtherSubject
                undecided = None if same else undecided
            # names hold frame by frame, so that a piece needs no other one
            held, differ = merge_file_names(path, recording, clouds, piece, marker_set, policy)
            joined.add(begin, held)
            against += [(begin, each) for each in differ]
            source.add(begin, held, recording, clouds)
        return _Labels(joined.labelling(), bodies[0] if len(parts) == 1 else None, join_disagreements(against), source)

    def _person(self, path: Path) -> _Person:
        """The models for a file, narrowed to its person where a trial is known and can be used."""
        trial = self._standing.of(path)
        if trial is None:
            return _Person(self._plain)
        try:
            model = self._narrowed_by(trial)
        except (AsterismError, OSError):
            if self.options.standing:
                raise
            return _Person(self._plain)  # nobody named the trial: it is named when it is labelled itself
        return _Person(RecordingLabeller([model], self.options.settings, self.names), model, trial)

    def _narrowed_by(self, trial: Path) -> MarkerModel:
        """The model narrowed by a trial, made once; the last few are kept."""
        from asterism import formats

        if trial not in self._narrowed:
            while len(self._narrowed) >= _NARROWED_KEPT:
                self._narrowed.pop(next(iter(self._narrowed)))
            try:
                recording = formats.read(trial, vertical=self.options.vertical)
                # a laboratory's files err alike
                other = None if self.options.vertical is not None else labelled_upright(self._plain, recording)
                recording = recording if other is None else replace(recording, vertical=other)
                self._narrowed[trial] = self.models[0].adapt(recording, self.options.settings.subject)
            except AsterismError as problem:
                sentence = str(problem)
                self._narrowed[trial] = AsterismError(sentence if trial.name in sentence else f"{trial}: {sentence}")
        narrowed = self._narrowed[trial]
        if isinstance(narrowed, AsterismError):
            raise narrowed
        return narrowed

    def _compile(self, source: FrameSource) -> None:
        """Compile the kernels by one frame, so that the time of the first file leaves that out."""
        if not self._compiled:
            first = int(source.counts.argmax())
            with suppress(SeveralBodies):
                self._plain.label_bodies(source.clouds(slice(first, first + 1)))
            self._compiled = True


def label_file(
    path: Path | str,
    models: MarkerModel | Sequence[MarkerModel] = (),
    options: LabellingOptions | None = None,
    *,
    files: Sequence[Path] = (),
    progress: Progress | None = None,
) -> LabelledFile:
    """Label a file as `asterism label` does.

    models: one, or one for each body in the volume; without any, the marker set is found among the shipped ones, and a model of virtual
    people labels (`LabelledFile.worn` says which set was taken).
    files: of the same session, among which the person's standing trial is looked for.
    Raises AsterismError where the file cannot be read or labelled, or no shipped set is like it, its kind NoMarkers where no frame has a
    point.
    """
    several = list(models) if isinstance(models, Sequence) else [models]
    if any(isinstance(model, str | Path) for model in several):
        raise AsterismError("label_file takes models, not their files; load each with MarkerModel.load(path).")
    return FileLabeller(several, options or LabellingOptions(), [Path(file) for file in files]).label(Path(path), progress)


def _beginning(source: FrameSource) -> slice:
    """The frames of a file that tell what is worn, and what is up."""
    return slice(0, min(len(source.counts), FRAMES_TO_FIND))


def body_names(models: Sequence[Path]) -> list[str]:
    """What each body is called: its model's file, or a number where two files have one name."""
    names = [path.stem for path in models]
    return names if len(set(names)) == len(names) else [str(i + 1) for i in range(len(names))]


def _explained_by(path: Path, wider: str, asked: str, left: LeftOver) -> Finding:
    """That a set which nobody asked for has labelled."""
    sentence = f"{path}: the points beside those of {asked} are like markers of {wider}; all were labelled so, and those of {asked} kept."
    sentence += f" {left.unseen} of {left.markers} have no label in any frame." if left.tells else ""
    mend = f"Nothing need be done; give --markers {wider} to have all of them."
    return Finding("label-wider-set", Severity.NOTE, str(path), sentence, mend)


def findings_on_sets(path: Path, worn: Sequence[WornMarkers], rules: FindRules) -> list[Finding]:
    """What a person should know of the marker sets that were found: which may be another, and that there are several."""
    findings = []
    for one in worn:
        if one.by == BY_POINTS and one.same_names < rules.sure:
            rest = ", ".join(f"{name} ({significant(100 * chance, 2)} %)" for name, chance in one.others if chance > _WORTH_TELLING)
            rest = rest or "a set that is not shipped"
            sentence = f"{path}: the points may be those of {one.name} ({significant(100 * one.probability, 2)} %) or of {rest}; "
            sentence += f"{one.name} was taken, by which {significant(100 * one.same_names, 2)} % of the names are expected to be right."
            if one.shown < one.points:
                sentence += f" Its markers explain {one.shown} of {one.points} points."
            mend = "Name the set with --markers; recordings of one person in one folder are judged together."
            findings.append(Finding("label-set-unsure", Severity.WARNING, str(path), sentence, mend))
    if len(worn) > 1 and worn[0].by != GIVEN:
        names = list(dict.fromkeys(one.name for one in worn))
        sentence = f"{path}: {_NUMBERS.get(len(worn), len(worn))} bodies wear "
        sentence += f"{'different marker sets, ' if len(names) > 1 else ''}{' and '.join(names)}; each was labelled."
        mend = "Where that is wrong, name the set with --markers, once for each body."
        findings.append(Finding("label-two-sets", Severity.NOTE, str(path), sentence, mend))
    return findings


def _nothing_labelled(path: Path, labelling: Labelling) -> list[Finding]:
    """The finding that no point of a file got a name."""
    if (labelling.indices >= 0).any():
        return []
    mend = "Check the marker set, the unit of length and the vertical; `asterism info` shows them."
    return [Finding("label-nothing", Severity.ERROR, str(path), f"{path}: no point got a label.", mend)]


def _left_over(labelled: LabelledFile, some: Clouds) -> LeftOver:
    """What the labels leave over in the frames that show much of the body; it may be out of view in the others. some: the first frames."""
    indices, full = labelled.labelling.indices, _full(np.asarray(labelled.clouds.counts))
    of_some = np.nonzero(full[: len(some)] & (np.asarray(some.counts) > 0))[0]
    # some frames tell what is there in all of them
    of_some = of_some[:: max(1, len(of_some) // _FRAMES_LEFT_OVER)]
    return LeftOver.of((indices[full] >= 0).mean(axis=0), [left_on_body(some[t], indices[t]) for t in of_some.tolist()])


def _full(counts: Ints) -> NDArray[np.bool_]:
    """(T,) the frames with as many points as a usual one."""
    return counts >= np.median(counts[counts > 0])


def _other_set(path: Path, labelled: LabelledFile, worn: Sequence[WornMarkers], some: Clouds) -> list[Finding]:
    """The finding that another set may be worn than the one that labelled, which nobody has seen worn.

    Most of its markers may not be there: fewer points may be those of a smaller set. Or some are not, beside points that are none of them.
    some: clouds of a part of the file that says where its points are.
    """
    if not labelled.given:
        return []
    given = (labelled.labelling.indices >= 0).sum(axis=1)
    usual, left = int(np.median(given[_full(np.asarray(labelled.clouds.counts))])), _left_over(labelled, some)
    names = " and ".join(dict.fromkeys(one.name for one in worn))
    # most of the set: at half of it, a set of thrice as many markers passes; at double, any hidden marker is told
    few = usual < _MOST * left.markers
    # where a wider set has labelled, what is left over is known, and that is said
    if not few and (not left.tells or labelled.labeller.wider is not None):
        return []
    mend = "Leave --markers out to have the set found" if worn[0].by == GIVEN else "Name the set that is worn with --markers"
    mend += "; check the labels with `asterism review`."
    if not few:
        is_own, sets = _sets_to_name(worn, some)
        if is_own:
            return [left.note(str(path), names)]
        return [Finding("label-other-set", Severity.WARNING, str(path), left.sentence(str(path), names), f"{mend} {sets}".strip())]
    sentence = f"{path}: {usual} of {left.markers} markers of {names} have a label in a usual frame; "
    sentence += "another set may be worn, part of the body be out of view, or the movement be an unusual one."
    found = Finding("label-few-markers", Severity.WARNING, str(path), sentence, mend)
    # fewer points may be those of a smaller set; what is left over tells of another one
    return [_with_sets(found, worn, some) if left.tells else found]


def _with_sets(finding: Finding, worn: Sequence[WornMarkers], some: Clouds) -> Finding:
    """A finding on a set that nobody has seen worn, with the sets that the points are like."""
    return replace(finding, mend=f"{finding.mend} {_sets_to_name(worn, some)[1]}".strip())


def _sets_to_name(worn: Sequence[WornMarkers], some: Clouds) -> tuple[bool, str]:
    return sets_to_name(some, [name for one in worn for name in one.marker_set.names])


def _few_frames(path: Path, counts: Ints) -> list[Finding]:
    """The finding that a file shows too little for its movement to speak for the labels; counts (T,) points of each frame."""
    frames = int((np.asarray(counts) > 0).sum())
    if frames >= MIN_FRAMES:
        return []
    sentence = f"{path}: {counted(frames, 'frame')} with points cannot show which distances stay while a body moves; "
    sentence += "the posture alone gave the labels."
    mend = "Check them with `asterism review`, or give the whole recording: its other frames make them sure."
    return [Finding("label-few-frames", Severity.NOTE, str(path), sentence, mend)]


def _shows_subject(model: MarkerModel, clouds: Clouds, labelling: Labelling, rules: SubjectRules) -> bool | None:
    """Whether a recording is of the person to whom the model is adapted; None where it shows too little of anybody."""
    fit = model.subject_fit(clouds, labelling, rules)
    return None if math.isnan(fit) else fit >= OTHER_SUBJECT_FIT


def _other_subject(path: Path, trial: Path | None, *, given: bool) -> Finding:
    sentence = f"{path}: {trial} is not of this body, or its markers were placed again; the file was labelled without it."
    if given:
        return Finding("label-other-subject", Severity.WARNING, str(path), sentence, "Give a trial of the same session with --subject.")
    mend = "Name the person's standing trial with --subject, or look for none with --no-static."
    return Finding("label-other-subject", Severity.NOTE, str(path), sentence, mend)
