"""`asterism review --serve`: files in; a page in the browser on which their labels are corrected, out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from asterism.cli import _console
from asterism.cli._options import vertical_axis

if TYPE_CHECKING:
    from asterism.cli.review import ReviewOptions


def serve_page(options: ReviewOptions) -> None:
    """Serve the page until it is interrupted."""
    from asterism.labelling import SolverEnsemble
    from asterism.web import Place, Session, SessionOptions, serve

    settings = SessionOptions(
        options.model, options.output, options.log_folder, options.overwrite, vertical_axis(options.vertical), options.workers
    )
    session = Session(options.files, SolverEnsemble.load(options.model), settings)
    serve(session, Place(options.host, options.port, not options.no_browser), _console.result)
    unsaved = [trial.path.name for trial in session.trials if trial.has_unsaved]
    if unsaved:
        _console.result(f"Not saved: {', '.join(unsaved)}. The answers are in the logs: start again to go on.")
