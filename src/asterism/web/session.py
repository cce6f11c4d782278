"""The recordings that a person corrects at one sitting: each labelled, corrected, saved; and the model taught by them."""

from __future__ import annotations

import hashlib
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism import __version__, formats
from asterism.errors import AsterismError, NoMarkers, sentence_of
from asterism.files.atomic import write_atomically
from asterism.findings import Finding
from asterism.labelling.correction import Correction, CorrectionLog, log_path
from asterism.labelling.correction.event_log import NAMES_SUFFIX, SAVED, SUFFIX
from asterism.labelling.correction.group_naming import GroupNaming
from asterism.labelling.group_names import group_names_text
from asterism.labelling.review import labels_of_points
from asterism.session import FileLabeller, LabelledFile, LabellingOptions, body_names, read_trial, trials_of
from asterism.session.worn import NoSetWorn
from asterism.web.finishing import Finishing, OtherTrial, finished
from asterism.web.relabelling import Relabelled, RelabelRun, SittingModel

if TYPE_CHECKING:
    from asterism.labelling import MarkerModel
    from asterism.labelling.correction import CorrectionChange
    from asterism.motion.gaps import Filled
    from asterism.progress import Progress

WAITING, LABELLING, READY, FAILED = "waiting", "labelling", "ready", "failed"


class StaleRevision(AsterismError):
    """What was asked is about labels that have changed since."""


CORRECTED = "corrected"
"""The folder beside a file in which it is saved, where no other is named."""


@dataclass(frozen=True)
class SessionOptions:
    """How a sitting works.

    models      the models' files, one for each body; none where models of virtual people label
    output      the folder for the corrected files; None for a folder `corrected` beside each
    log_folder  the folder for the logs of corrections; None for beside each file
    overwrite   whether files that were there before may be replaced
    labelling   how the files are labelled
    by_hand     whether the groups of points are named by hand, whatever labels there could be
    """

    models: Sequence[Path]
    output: Path | None = None
    log_folder: Path | None = None
    overwrite: bool = False
    labelling: LabellingOptions = field(default_factory=LabellingOptions)
    by_hand: bool = False


@dataclass
class CorrectionTrial:
    """One recording of a sitting: its labels are corrected, or its groups of points named. Its methods may be called from any thread.

    id       a short name in addresses
    path     its file
    target   where it is saved
    state    "waiting", "labelling", "ready" or "failed"
    error    why it failed, in one sentence
    notes    what a person should know when it is opened
    findings of labelling it
    relabelled  what labelling it again has changed; None where that was not done
    finishing   what is proposed for its gaps and events
    others      the trials of the sitting that it is one of
    """

    id: str
    path: Path
    target: Path
    options: SessionOptions
    changed: Callable[[str, int], None]
    state: str = WAITING
    error: str = ""
    notes: list[str] = field(default_factory=list)
    findings: Sequence[Finding] = ()
    relabelled: Relabelled | None = None
    finishing: Finishing = field(default_factory=Finishing)
    others: Callable[[], Sequence[CorrectionTrial]] = tuple
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _labelled: LabelledFile | None = None
    _correction: Correction | None = None
    _naming: GroupNaming | None = None
    _log: CorrectionLog | None = None
    _saved: int = -1
    _ours: set[str] = field(default_factory=set)
    _on_disk: tuple[int, int] = (0, 0)

    def label(self, labeller: FileLabeller) -> None:
        """Read and label the file, and take up the corrections of its log; a failure is kept as `error`."""
        self.state = LABELLING
        self.changed(self.id, 0)
        try:
            self._open(labeller)
            self.state = READY
        except Exception as problem:  # whatever a file raises costs that file only
            self.error = _sentence(problem, self.path)
            self.state = FAILED
        self.changed(self.id, 0)

    def relabel(self, model: SittingModel, progress: Progress) -> None:
        """Label the file again with another model, and hold what was said. A file that is not labelled yet is labelled.

        Raises AsterismError where the file has changed on the disk, or an answer would be lost; whatever is raised, nothing changes then.
        """
        if self.state == WAITING:
            self.label(model.labeller)
            if self.state == READY:
                return
        # Said before the work of minutes: whether there are labels at all.
        with self.opened():
            self._check_unchanged()
        labelled = model.labeller.label(self.path, progress)
        fresh = labelled.correction()
        # Answers go on while the file is labelled: what was said until now is held.
        with self.opened() as earlier:
            fresh.follow(earlier)
            before, after = (labels_of_points(labels, fresh.clouds)[0] for labels in (earlier.labelling, fresh.labelling))
            self._labelled, self._correction, self.findings = labelled, fresh, labelled.findings
            self.relabelled = Relabelled(model.name, fresh.revision, int((before != after).sum()))
        self.changed(self.id, fresh.revision)

    @contextmanager
    def opened(self) -> Iterator[Correction]:
        """The corrections, for one thread at a time. Raises AsterismError where the trial is not ready, or has no labels to correct."""
        with self.held() as held:
            if not isinstance(held, Correction):
                raise AsterismError(f"{self.path.name} has no labels yet; name its groups, save it, and train a model on it.")
            yield held

    @contextmanager
    def held(self) -> Iterator[Correction | GroupNaming]:
        """The corrections, or the names of groups, for one thread at a time. Raises AsterismError where the trial is not ready."""
        if self.state != READY:
            raise AsterismError(self.error or f"{self.path.name} is not labelled yet; wait a moment.")
        with self._lock:
            held = self._held
            assert held is not None
            yield held

    @property
    def _held(self) -> Correction | GroupNaming | None:
        return self._correction if self._naming is None else self._naming

    def snapshot(self) -> LabelledFile:
        """The file under the labels as they are. Raises AsterismError as `opened` does."""
        with self.opened() as correction:
            assert self._labelled is not None
            return self._labelled.corrected(correction)

    def gaps(self) -> Filled:
        """Its gaps as they can be filled. Raises AsterismError as `opened` does.

        Found outside the trial's lock: that can take seconds, and answers go on.
        """
        return self.finishing.gaps(self.snapshot(), self._trials())

    def _trials(self) -> list[OtherTrial]:
        """What `trials_of` names: of trials of the sitting under the labels as they are, of other files under their own.

        Not to be called under the trial's lock: each of two would wait for the other's.
        """
        ours = {str(one.path.resolve()): one for one in self.others()}
        found = []
        for path in trials_of(self.path, [one.path for one in ours.values()]):
            trial = ours.get(str(path.resolve()))
            if trial is None:
                vertical = self.options.labelling.vertical
                found.append(OtherTrial((path, _stamp(path)), partial(read_trial, path, vertical)))
                continue
            # one that is not labelled yet tells nothing, nor one whose groups are named
            with suppress(AsterismError):
                labelled = trial.snapshot()
                found.append(OtherTrial(labelled.labelling, partial(getattr, labelled, "recording")))
        return found

    @property
    def is_naming(self) -> bool:
        """Whether groups of points are named, since there are no labels."""
        return self._naming is not None

    @property
    def is_saved(self) -> bool:
        """Whether the labels are in the file `target` as they are now."""
        return self._held is not None and self._saved == self._held.revision

    @property
    def models(self) -> Sequence[MarkerModel]:
        """What labelled it; empty where that is not done."""
        return () if self._labelled is None else self._labelled.models

    @property
    def has_unsaved(self) -> bool:
        """Whether something was said that is in no saved file."""
        return self._held is not None and bool(self._held.touches) and not self.is_saved

    def change(self, revision: int, act: Callable[[Correction | GroupNaming], CorrectionChange]) -> CorrectionChange:
        """Change the labels, or names. Raises StaleRevision where they are no longer those of this revision, else what `act` raises."""
        with self.held() as held:
            # Two tabs may show one trial: the later answer would be about labels that are gone.
            if revision != held.revision:
                raise StaleRevision("the labels have changed since, perhaps in another tab; look at them again.")
            change = act(held)
            number = held.revision
        self.changed(self.id, number)
        return change

    def save(self) -> str:
        """Write the labelled file. Returns what it leaves out, in one sentence; empty where it leaves out nothing.

        Of groups that were named, the names are written beside it, in a table that `asterism name` reads. Raises AsterismError where the
        recording's file has changed on the disk, a target is there and not ours, or no group has a name.
        """
        trials = self._trials()
        with self.held() as held:
            self._check_unchanged()
            for target in self._targets:
                self._check_target(target)
            self.target.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(prefix="asterism-") as folder:
                draft = Path(folder) / self.target.name
                lost = self._draft(held, draft, trials)
                data = draft.read_bytes()
            if isinstance(held, GroupNaming):
                self._write(self.table, group_names_text(held.groups, held.names).encode())
            self._write(self.target, data)
            number = self._saved = held.revision
        self.changed(self.id, number)
        return f"{self.target.name} leaves out {', '.join(lost)}." if lost else ""

    @property
    def table(self) -> Path:
        """Where the names of groups are saved."""
        return self.target.with_suffix(".names.csv")

    @property
    def _targets(self) -> list[Path]:
        return [self.table, self.target] if self.is_naming else [self.target]

    def _draft(self, held: Correction | GroupNaming, draft: Path, trials: Sequence[OtherTrial]) -> list[str]:
        """Write the labelled recording, its fills told by other trials, too; returns what the file cannot hold."""
        if isinstance(held, GroupNaming):
            return formats.write(draft, held.named())
        assert self._labelled is not None
        return self._labelled.corrected(held, lambda recording: finished(held, recording, trials)).write(draft)

    def _write(self, target: Path, data: bytes) -> None:
        # The hash tells our file from one that someone else put there. Noted first: a kill may come between.
        saved = hashlib.sha256(data).hexdigest()
        if self._log is not None:
            self._log.append({"kind": SAVED, "file": str(target), "sha256": saved})
        self._ours.add(saved)
        write_atomically(target, data)

    def close(self) -> None:
        """Close the log. Raises AsterismError where it was deleted and cannot be written again."""
        with self._lock:
            if self._held is not None:
                self._held.close()

    def _open(self, labeller: FileLabeller) -> None:
        if self.options.by_hand:
            self._open_groups()
            return
        try:
            self._open_labels(labeller)
        except (NoSetWorn, NoMarkers) as problem:
            # Points that a model refuses are none to name: nobody asked for a set.
            if labeller.models:
                raise
            self._open_groups()
            self.notes.append(_sentence(problem, self.path).removeprefix(f"{self.path}: "))

    def _open_groups(self) -> None:
        """Group the points, for a person to name, and take up the names of their log."""
        stamp = _stamp(self.path)
        recording = formats.read(self.path, vertical=self.options.labelling.vertical)
        naming = GroupNaming(recording)
        self.findings = recording.warnings
        self.notes += [finding.sentence.removeprefix(f"{self.path}: ") for finding in self.findings]
        # A format without names of its own cannot hold what was named.
        self.target = self.target.with_suffix(".c3d")
        self._naming = naming
        self._take_up(naming, NAMES_SUFFIX)
        self._on_disk = stamp

    def _open_labels(self, labeller: FileLabeller) -> None:
        stamp = _stamp(self.path)
        labelled = labeller.label(self.path)
        correction = labelled.correction()
        self.findings = labelled.findings
        # the page names the trial itself
        self.notes += [finding.sentence.removeprefix(f"{self.path}: ") for finding in labelled.findings]
        log = self._take_up(correction)
        if log.other_model and correction.touches:
            self.notes.append(f"{log.path.name}: its answers were given with another model, and hold.")
        self._labelled, self._correction, self._on_disk = labelled, correction, stamp

    def _take_up(self, held: Correction | GroupNaming, suffix: str = SUFFIX) -> CorrectionLog:
        """Open the log of what was said, and take it up."""
        folder = self.options.log_folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)
        log = self._log = CorrectionLog(log_path(self.path, folder, suffix), *held.identity)
        try:
            held.attach(log)
        except BaseException:
            log.close()
            raise
        if log.dropped:
            self.notes.append(f"{log.path.name}: its end was not whole and is dropped; one answer may be missing.")
        # A file that an earlier sitting saved is ours if its content still is; the last one may have been noted, and not written.
        saves = [entry for entry in log.entries if entry["kind"] == SAVED]
        self._ours = {str(entry.get("sha256")) for entry in saves if str(entry.get("file")) in map(str, self._targets)}
        last = saves and log.entries[-1] is saves[-1] and saves[-1].get("file") == str(self.target)
        if last and not log.other_model and self._is_ours(self.target, {str(saves[-1].get("sha256"))}):
            self._saved = held.revision
        return log

    def _check_unchanged(self) -> None:
        # Labels by row numbers of a file that was written anew would be of other points.
        if _stamp(self.path) != self._on_disk:
            raise AsterismError(f"{self.path} has changed on the disk since it was opened; start again to correct the new one.")

    def _is_ours(self, target: Path, hashes: set[str]) -> bool:
        """Whether a target is a file that was saved, by the hashes of such."""
        return target.is_file() and _hash_of_file(target) in hashes

    def _check_target(self, target: Path) -> None:
        if target.exists() and target.samefile(self.path) and not self.options.overwrite:
            raise AsterismError(f"{target} is the recording itself; choose another folder with -o, or replace it with --overwrite.")
        if target.exists() and not self.options.overwrite and not self._is_ours(target, self._ours):
            raise AsterismError(f"{target} exists; choose another folder with -o, or replace it with --overwrite.")


class CorrectionSession:
    """The trials of a sitting, labelled one after the other."""

    def __init__(
        self,
        files: Sequence[Path],
        models: MarkerModel | Sequence[MarkerModel],
        options: SessionOptions,
        targets: Sequence[Path] | None = None,
    ) -> None:
        """models: one, or one for each body.

        targets: where each file is saved, by default in the folder for the corrected files, under its name.

        Raises AsterismError where two files would be saved to one place, or the output is no folder.
        """
        several = tuple(models) if isinstance(models, Sequence) else (models,)
        # models of virtual people are known when a file's marker set is, and say themselves who labelled
        given = f"asterism {__version__}, {', '.join(path.name for path in options.models)}" if options.models else ""
        by = options.labelling.by or given
        labelling = replace(options.labelling, by=by, in_memory=True, keep_tracklets=True)
        self.labeller = FileLabeller(several, labelling, files, body_names(options.models) if len(several) > 1 else None)
        self.options = options
        self.listeners: list[Callable[[str, int], None]] = []
        """Called with a trial's id and revision when it has changed, from any thread."""
        targets = _targets(files, options.output) if targets is None else targets
        self.trials = [
            CorrectionTrial(str(number), path, target, options, self._changed, others=lambda: self.trials)
            for number, (path, target) in enumerate(zip(files, targets, strict=True))
        ]
        name = ", ".join(path.name for path in options.models) or "virtual people"
        self.models = [SittingModel(name, self.labeller)]
        """What can label: what the sitting began with, and then each model that it has taught."""
        self.relabelling: RelabelRun | None = None
        """The trials that are labelled again, or were last."""
        self._stopped = threading.Event()
        self._teaching = threading.Lock()
        # One at a time: labelling takes all of the machine.
        self._busy = threading.Lock()
        self._virtual: Sequence[MarkerModel] = ()

    def start(self) -> threading.Thread:
        """Label the trials in a thread of its own."""
        thread = threading.Thread(target=self._label_all, name="labelling", daemon=True)
        thread.start()
        return thread

    def trial(self, number: str) -> CorrectionTrial:
        """The trial with this id. Raises KeyError where there is none."""
        return {trial.id: trial for trial in self.trials}[number]

    def teach(self, trials: Sequence[str], name: str | None = None) -> Path:
        """Teach the model some saved trials; returns the new model's file, which is beside the present one.

        name: of that file, without a folder; by default one that is not there yet. Raises AsterismError where a trial is not saved, should
        not be used, or the name is taken.
        """
        recordings = [self._taught(number) for number in trials]
        if not recordings:
            raise AsterismError("no trial was chosen; save one, and teach it.")
        models = self.labeller.models or self._virtual or self.trial(trials[0]).models
        if len(models) > 1:
            raise AsterismError("a sitting with several models teaches none of them; start again with the one to teach.")
        target = self._model_target(name, self.trial(trials[0]))
        # One at a time: two lessons from one model would each forget the other.
        with self._teaching:
            taught = models[0].learn(recordings)
            taught.save(target)
            # What models of virtual people have learned once, they learn anew with more trials.
            self._virtual = models
            by = self.options.labelling.by or f"asterism {__version__}, {target.name}"
            how = replace(self.labeller.options, by=by, markers=())
            self.models.append(SittingModel(target.name, FileLabeller((taught,), how, self.labeller.files)))
        return target

    def relabel(self, trials: Sequence[str], model: int) -> RelabelRun:
        """Label trials again in a thread of its own; model: the place among `models`.

        Raises AsterismError where no trial is ready, there is no such model, or trials are being labelled again already.
        """
        if not 0 <= model < len(self.models):
            raise AsterismError("there is no such model; teach one first.")
        chosen = [self.trial(number) for number in trials]
        if not chosen:
            raise AsterismError("no trial was chosen; choose one to label again.")
        with self._teaching:
            if self.relabelling is not None and self.relabelling.running:
                raise AsterismError("trials are being labelled again already; wait for them, or stop that first.")
            run = self.relabelling = RelabelRun(self.models[model], chosen, self._busy)
        threading.Thread(target=run.run, name="labelling again", daemon=True).start()
        return run

    def close(self) -> None:
        """Close the logs; labelling stops after the present file. Raises AsterismError where a log is gone and cannot be written again."""
        self._stopped.set()
        if self.relabelling is not None:
            self.relabelling.stop()
        problems = []
        for trial in self.trials:
            try:
                trial.close()
            except AsterismError as problem:
                problems.append(str(problem))
        if problems:
            raise AsterismError(" ".join(problems))

    def _label_all(self) -> None:
        for trial in self.trials:
            with self._busy:
                if self._stopped.is_set():
                    return
                # A taught model may have labelled it meanwhile.
                if trial.state == WAITING:
                    trial.label(self.labeller)

    def _changed(self, trial: str, revision: int) -> None:
        for listener in list(self.listeners):
            listener(trial, revision)

    def _taught(self, number: str) -> Any:
        trial = self.trial(number)
        with trial.opened() as correction:
            if not trial.is_saved:
                raise AsterismError(f"{trial.path.name} is not saved; save it before the model learns it.")
            # A recording that should not be used would teach its mistakes.
            verdict = correction.verdict
            if verdict.kind == "do-not-use":
                raise AsterismError(f"{trial.path.name} should not be learned: {verdict.sentence}")
            return correction.labelled_recording()

    def _model_target(self, name: str | None, trial: CorrectionTrial) -> Path:
        # a model of virtual people is in no folder of the user's: what it learns goes beside the trial
        model = self.options.models[0] if self.options.models else trial.path.with_name("taught.model")
        if name is None:
            number = 2
            while (target := model.with_name(f"{model.stem}-{number}{model.suffix}")).exists():
                number += 1
            return target
        # The name comes from the page: it must not lead to another folder.
        if not name.strip() or name != Path(name).name or "\\" in name or name.startswith("."):
            raise AsterismError(f"{name[:60]!r} is no name of a file; give one without a folder, such as better.model.")
        target = model.with_name(name if name.endswith(".model") else f"{name}.model")
        if target.exists() and not self.options.overwrite:
            raise AsterismError(f"{target} exists; give another name, or start with --overwrite.")
        return target


def _targets(files: Sequence[Path], output: Path | None) -> list[Path]:
    """Where each file is saved."""
    if output is not None and output.exists() and not output.is_dir():
        raise AsterismError(f"{output} is a file; -o takes the folder for the corrected files.")
    targets = [(path.parent / CORRECTED if output is None else output) / path.name for path in files]
    taken: dict[str, Path] = {}
    for path, target in zip(files, targets, strict=True):
        # Names that differ only in case are one file on some systems.
        other = taken.setdefault(str(target.absolute()).casefold(), path)
        if other is not path:
            raise AsterismError(f"{other} and {path} would both become {target}; correct them one after the other, into two folders.")
    return targets


def _stamp(path: Path) -> tuple[int, int]:
    """Size and time of the last change of a file; zeros where it is gone."""
    try:
        status = path.stat()
    except OSError:
        return 0, 0
    return status.st_size, status.st_mtime_ns


def _hash_of_file(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sentence(problem: Exception, path: Path) -> str:
    """One sentence on what went wrong with a file."""
    text = sentence_of(problem)
    return text if path.name in text else f"{path}: {text}"
