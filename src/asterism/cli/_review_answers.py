"""`asterism review --answers`: files and a filled table in; the corrected files out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.cli._folders import check_output, outputs_of, trials
from asterism.cli._labelling import file_labeller
from asterism.errors import AsterismError

if TYPE_CHECKING:
    from asterism.cli._review_options import ReviewOptions
    from asterism.labelling.correction import Answer
    from asterism.session import FileLabeller


def correct_by_answers(options: ReviewOptions) -> int:
    """Label the files, hold the answers of the table, and write the result. Returns the exit status."""
    from asterism.labelling.correction import read_answers

    assert options.answers is not None and options.output is not None
    batch = _console.Batch("corrected")
    found = trials(options.files, batch, without=options.output)
    files, targets = [trial.path for trial in found], outputs_of(found, options.output)
    # a table that names a file that was not given is a mistake in either: nothing is written then
    answers = _by_file(options.answers, read_answers(options.answers), files)
    labeller = file_labeller(options, files, batch)
    with _console.progress("labelling") as progress:
        for path, target in zip(files, targets, strict=True):
            with batch.file(path):
                if progress:
                    progress((len(batch.done) + len(batch.failed)) / len(files), path.name)
                _correct(path, target, answers.get(path, ()), labeller, options, batch)
    return batch.close()


def _correct(
    path: Path, target: Path, answers: Sequence[Answer], labeller: FileLabeller, options: ReviewOptions, batch: _console.Batch
) -> None:
    from asterism.cli._recordings import not_carried
    from asterism.labelling.correction import touches_of

    # before the labelling, which takes longer than the look
    check_output(path, target, options.overwrite)
    labelled = labeller.label(path)
    for finding in labelled.findings:
        batch.found(finding)
    correction = labelled.correction()
    if answers:
        try:
            correction.touch(*touches_of(answers, correction))
        except AsterismError as problem:
            raise AsterismError(f"{path}: {options.answers}, {problem}") from problem
    target.parent.mkdir(parents=True, exist_ok=True)
    lost = labelled.corrected(correction).write(target)
    for finding in not_carried(target, lost):
        batch.found(finding)
    _console.result(f"{path}: {len(answers)} answer{'' if len(answers) == 1 else 's'}; written as {target}. {correction.verdict.sentence}")


def _by_file(table: Path, answers: Sequence[Answer], files: Sequence[Path]) -> dict[Path, list[Answer]]:
    """The answers of each file, which the table names by its path, or by its name where no other file has the same.

    Raises AsterismError where a file of the table was not given.
    """
    found: dict[Path, list[Answer]] = {}
    for answer in answers:
        name = answer.file.replace("\\", "/").rpartition("/")[2]
        same = [path for path in files if str(path) == answer.file] or [path for path in files if path.name == name]
        if len(same) != 1:
            what = "is not among the files given" if not same else "is the name of several of the files given"
            raise AsterismError(f"{table}, line {answer.line}: {answer.file[:200]} {what}; name the files as when the list was written.")
        found.setdefault(same[0], []).append(answer)
    return found
