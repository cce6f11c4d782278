"""`asterism review --serve`: files in; a page in the browser on which their labels are corrected, out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.cli._folders import Trial, outputs_of, trials
from asterism.cli._labelling import file_labeller

if TYPE_CHECKING:
    from asterism.cli._review_options import ReviewOptions


def _is_corrected(trial: Trial) -> bool:
    """Whether a file of a folder is what an earlier sitting saved there."""
    from asterism.web import CORRECTED

    return trial.folder is not None and trial.path.parent.name == CORRECTED


def serve_page(options: ReviewOptions) -> None:
    """Serve the page until it is interrupted."""
    from asterism.recording.display import short_names
    from asterism.web import CorrectionSession, PageAddress, SessionOptions, serve

    batch = _console.Batch("opened")
    # what an earlier sitting saved is no raw recording
    found = [trial for trial in trials(options.files, batch, without=options.output) if not _is_corrected(trial)]
    files, targets = [trial.path for trial in found], None if options.output is None else outputs_of(found, options.output)
    labeller = file_labeller(options, files, batch)
    settings = SessionOptions(options.model or (), options.output, options.log_folder, options.overwrite, labeller.options, options.by_hand)
    session = CorrectionSession(files, labeller.models, settings, targets)
    serve(session, PageAddress(options.host, options.port, not options.no_browser), _console.result)
    # answers are in the logs in any case; only the files are not written
    unsaved = [name for name, trial in zip(short_names(files), session.trials, strict=True) if trial.has_unsaved]
    if unsaved:
        _console.result(f"Not saved: {', '.join(unsaved)}. The answers are in the logs: start again to go on.")
