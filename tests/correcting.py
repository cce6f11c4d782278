"""What the tests of corrections share: a model, recordings as camera systems deliver them, and the page's server on a free port."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from models import BRIEF, trained

import asterism
from asterism import formats
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Clouds, Ints, Recording
from asterism.simulation import simulate_walks


@cache
def walks() -> tuple[Recording, ...]:
    """Walks of five people, 120 frames each."""
    return tuple(simulate_walks(subjects=5, frames=120, markers="helen-hayes", seed=3))


@cache
def model() -> asterism.MarkerModel:
    """A model that has learned the first four."""
    return trained(list(walks()[:4]))


@cache
def quick_learner() -> asterism.MarkerModel:
    """The same model, which tries itself on little when it is taught more: for tests of what is taught, not of how sure it then is."""
    state = model().state
    config = replace(state.training.config, rules=BRIEF)
    return asterism.MarkerModel(replace(state, training=replace(state.training, config=config)))


def recorded(walk: Recording, hidden: int = 2, ghosts: int = 1, seed: int = 1) -> tuple[Recording, Ints]:
    """A walk as a camera system gives it: a column without a name for each unbroken track; and the true marker of each, -1 for ghosts."""
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden, ghosts, seed=seed)
    assert clouds.tracks is not None
    numbers, column = np.unique(clouds.tracks, return_inverse=True)
    positions = np.full((len(clouds), len(numbers), 3), np.nan)
    positions[clouds.frame_of, column] = clouds.xyz
    marker = np.full(len(numbers), -1)
    frames, markers = np.nonzero(truth >= 0)
    marker[column[clouds.offsets[frames] + truth[frames, markers]]] = markers
    names = tuple(f"*{number + 1}" for number in range(len(numbers)))
    return Recording(positions, names, walk.rate, walk.vertical, first_frame=11), marker


def truth_of_points(clouds: Clouds, marker_of_column: Ints) -> Ints:
    """The true marker of each point of a recording's clouds."""
    return np.asarray(marker_of_column[clouds.columns])


def written(folder: Path, count: int = 1, seed: int = 1) -> list[Path]:
    """Files of the fifth person's walk, and the model's file `gait.model` beside them."""
    model().save(folder / "gait.model")
    files = []
    for number in range(count):
        path = folder / f"walk{number + 1}.c3d"
        formats.write(path, recorded(walks()[4], seed=seed + number)[0])
        files.append(path)
    return files


@dataclass(frozen=True)
class Browser:
    """A client of the page's server, as the page is one."""

    address: str

    @property
    def host(self) -> str:
        return urlsplit(self.address).netloc

    @property
    def token(self) -> str:
        return parse_qs(urlsplit(self.address).query)["token"][0]

    def ask(self, path: str, given: Any = None, **headers: str) -> tuple[int, bytes, dict[str, str]]:
        """Status, body and headers of an answer; `given` is posted as JSON (bytes as they are)."""
        sent = {"X-Asterism-Token": self.token, "Content-Type": "application/json"}
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        body = given if given is None or isinstance(given, bytes) else json.dumps(given).encode()
        connection = HTTPConnection(self.host, timeout=60)
        try:
            connection.request("GET" if given is None else "POST", path, body, sent)
            answer = connection.getresponse()
            return answer.status, answer.read(), {name.lower(): value for name, value in answer.getheaders()}
        finally:
            connection.close()

    def get(self, path: str) -> Any:
        status, body, _ = self.ask(path)
        assert status == 200, body
        return json.loads(body)

    def post(self, path: str, given: Any) -> Any:
        status, body, _ = self.ask(path, given)
        assert status == 200, body
        return json.loads(body)


@contextmanager
def served(session: Any) -> Iterator[Browser]:
    """The page's server for a sitting, all of whose files are labelled."""
    import uvicorn

    from asterism.web.app import make_app
    from asterism.web.guard import Guard
    from asterism.web.serving import PageAddress, bound

    session.start().join()
    with bound(PageAddress()) as listening:
        port = listening.getsockname()[1]
        app = Guard(make_app(session), "a-token", "127.0.0.1", port)
        server = uvicorn.Server(uvicorn.Config(app, log_level="critical", lifespan="off", access_log=False))
        thread = threading.Thread(target=server.run, args=([listening],), daemon=True)
        thread.start()
        try:
            yield Browser(f"http://127.0.0.1:{port}/?token=a-token")
        finally:
            server.should_exit = True
            thread.join(timeout=10)
            session.close()


def longest(ids: Sequence[int], first: Sequence[int], last: Sequence[int]) -> int:
    """The id of the longest piece."""
    return int(ids[int(np.argmax(np.asarray(last) - np.asarray(first)))])


def drive(monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Let the page of the server load a script that stands for the person, after its own."""
    from starlette.responses import Response

    from asterism.web import app

    static = app.static_file

    def driven(name: str) -> Response:
        if name == "driver.js":
            return Response(script, media_type="text/javascript")
        answer = static(name)
        if name != "review.html":
            return answer
        page = bytes(answer.body).replace(b"</body>", b'<script src="/static/driver.js"></script></body>')
        return Response(page, media_type="text/html; charset=utf-8")

    monkeypatch.setattr(app, "static_file", driven)
