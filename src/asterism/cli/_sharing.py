"""Options that share work in; training and evaluating in several processes, or on a cluster, out."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def shared(workers: int, dask: str | None, folder: Path) -> Iterator[None]:
    """While this holds, training and evaluating share their work as the options say.

    folder  in which machines of a cluster find what they work on; processes of this machine have the folder of temporary files
    """
    if workers < 2 and dask is None:
        yield
        return
    from asterism.labelling.shared_work import shared_by
    from asterism.session import each_of

    with each_of(Path(tempfile.gettempdir()) if dask is None else folder, workers=workers, dask=dask) as each, shared_by(each):
        yield
