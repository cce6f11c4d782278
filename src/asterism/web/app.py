"""The page's server: addresses in; pages, plain values and bytes out. The work is that of `session.py`, done in threads."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from asterism.errors import AsterismError
from asterism.labelling.correction import Correction, CorrectionChange, request_of
from asterism.labelling.correction.group_naming import GroupNaming
from asterism.labelling.correction.touches import MarkerSpan, Touch
from asterism.recording import MarkerSet
from asterism.recording.display import counted
from asterism.recording.marker_set import shipped_sets
from asterism.report import player_script, player_style
from asterism.web.finishing import change_events, plain_events, plain_gaps, plain_graph, spans_of
from asterism.web.plain import packed_pieces, packed_points, plain_change, plain_relabelling, plain_state, plain_trials
from asterism.web.session import CorrectionSession, CorrectionTrial, StaleRevision

MAX_BODY = 1 << 16
"""Bytes of a request at most."""
_TYPES = {"html": "text/html; charset=utf-8", "js": "text/javascript; charset=utf-8", "css": "text/css; charset=utf-8"}


class _Refused(Exception):
    """A request that is answered by a sentence and a status."""

    def __init__(self, status: int, sentence: str) -> None:
        super().__init__(sentence)
        self.status, self.sentence = status, sentence


def make_app(session: CorrectionSession) -> Starlette:
    """The application for a sitting; behind a `Guard`."""
    # Every answer passes one place that turns failures into sentences.
    api = _Api(session)
    trial = "/api/trials/{trial}"
    routes = [
        Route("/", lambda request: static_file("review.html")),
        Route("/static/{name}", lambda request: static_file(request.path_params["name"])),
        Route("/api/trials", api.answering(api.trials)),
        Route(f"{trial}/points", api.answering(api.points)),
        Route(f"{trial}/piece_points", api.answering(api.piece_points)),
        Route(f"{trial}/state", api.answering(api.state)),
        Route(f"{trial}/candidates", api.answering(api.candidates)),
        *(Route(f"{trial}/{verb}", api.answering(api.changing(verb)), methods=["POST"]) for verb in ("touch", "refuse", "undo", "redo")),
        Route(f"{trial}/save", api.answering(api.save), methods=["POST"]),
        Route(f"{trial}/gaps", api.answering(api.gaps)),
        Route(f"{trial}/gap", api.answering(api.gap)),
        Route(f"{trial}/events", api.answering(api.events)),
        *(Route(f"{trial}/{verb}", api.answering(api.finishing(verb)), methods=["POST"]) for verb in ("fill", "unfill", "events")),
        Route(f"{trial}/changed", api.answering(api.changed)),
        Route("/api/sets", api.answering(api.sets)),
        Route("/api/teach", api.answering(api.teach), methods=["POST"]),
        Route("/api/relabel", api.answering(api.relabelling)),
        Route("/api/relabel", api.answering(api.relabel), methods=["POST"]),
        Route("/api/relabel/stop", api.answering(api.stop_relabelling), methods=["POST"]),
        WebSocketRoute("/ws", api.tell),
    ]
    return Starlette(routes=routes)


class _Api:
    """What the addresses under /api/ answer. Each method takes the request and its JSON, and runs in a thread."""

    def __init__(self, session: CorrectionSession) -> None:
        self.session = session
        self._given_sets = {_name_of_set(one): one for one in session.labeller.options.markers}

    def answering(self, answer: Callable[[Request, dict[str, Any]], Response | dict[str, Any]]) -> Callable[[Request], Any]:
        """An endpoint that answers by a method of this class, and by a sentence where it fails."""

        async def endpoint(request: Request) -> Response:
            # Reading the body waits for the network; the work itself runs in a thread, so that other requests go on.
            try:
                given = await _json_of(request) if request.method == "POST" else {}
                content = await run_in_threadpool(answer, request, given)
            except _Refused as problem:
                return JSONResponse({"error": problem.sentence}, problem.status)
            # 409: the page asks for the state anew and shows what has changed.
            except StaleRevision as problem:
                return JSONResponse({"error": str(problem)}, 409)
            except AsterismError as problem:
                return JSONResponse({"error": str(problem)}, 400)
            except OSError as problem:
                return JSONResponse({"error": f"{problem.filename or 'a file'}: {(problem.strerror or str(problem)).lower()}."}, 500)
            return content if isinstance(content, Response) else JSONResponse(content)

        return endpoint

    def trials(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        return plain_trials(self.session)

    def points(self, request: Request, given: dict[str, Any]) -> Response:
        with self._trial(request).held() as held:
            return Response(packed_points(held.clouds), media_type="application/octet-stream")

    def piece_points(self, request: Request, given: dict[str, Any]) -> Response:
        with self._trial(request).held() as held:
            return Response(packed_pieces(held), media_type="application/octet-stream")

    def state(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trial = self._trial(request)
        with trial.held() as held:
            return plain_state(trial, held)

    def candidates(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        try:
            piece = int(request.query_params.get("piece", ""))
        except ValueError:
            raise _Refused(400, "the address needs a piece's id, such as ?piece=0.") from None
        with self._trial(request).held() as held:
            if isinstance(held, GroupNaming):
                return {"candidates": held.candidates(piece, self._set(request.query_params.get("set")))}
            return {"candidates": [[name, round(chance, 6)] for name, chance in held.candidates(piece)]}

    def sets(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        """The marker sets whose names can be offered: what was given with --markers first, then the shipped ones."""
        return {
            "sets": [*self._given_sets, *(name for name in shipped_sets() if name not in self._given_sets)],
            "given": len(self._given_sets),
        }

    def gaps(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trial = self._trial(request)
        fill = trial.gaps()
        with trial.opened() as correction:
            return plain_gaps(correction, fill)

    def gap(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trial, asked = self._trial(request), request.query_params
        try:
            span = MarkerSpan(asked.get("marker", ""), int(asked.get("first", "")), int(asked.get("last", "")))
        except ValueError:
            raise _Refused(400, "the address needs a gap, such as ?marker=LKNE&first=0&last=9.") from None
        return plain_graph(trial.gaps(), span)

    def events(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trial = self._trial(request)
        found = trial.finishing.events(trial.snapshot())
        with trial.opened() as correction:
            return plain_events(correction, found)

    def finishing(self, verb: str) -> Callable[[Request, dict[str, Any]], dict[str, Any]]:
        """The answer to a request that accepts a fill, takes that back, or changes events."""

        def answer(request: Request, given: dict[str, Any]) -> dict[str, Any]:
            trial, revision = self._trial(request), _revision(given)
            finish = _events_changed if verb == "events" else _filled
            act = finish(trial, verb, given)
            trial.change(revision, lambda held: act(held) if isinstance(held, Correction) else _no_labels())
            with trial.opened() as correction:
                return {"revision": correction.revision, "changed": [], "state": plain_state(trial, correction)}

        return answer

    def changing(self, verb: str) -> Callable[[Request, dict[str, Any]], dict[str, Any]]:
        """The answer to a request that changes labels: touch, refuse, undo or redo."""

        def answer(request: Request, given: dict[str, Any]) -> dict[str, Any]:
            trial, revision = self._trial(request), _revision(given)
            change = trial.change(revision, lambda held: _changed_by(held, verb, given))
            with trial.held() as held:
                return {"revision": held.revision, "changed": plain_change(change), "state": plain_state(trial, held)}

        return answer

    def save(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trial = self._trial(request)
        sentence = trial.save()
        named = f" Its names are in {trial.table}. Train on it: `asterism train {trial.target} -o NAME.model`." if trial.is_naming else ""
        return {"path": str(trial.target), "sentence": f"{sentence or f'Saved as {trial.target}.'}{named}"}

    def changed(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        """What labelling the trial again changed; empty where something was said since."""
        trial = self._trial(request)
        with trial.opened() as correction:
            again, change = trial.relabelled, correction.last_change
            if again is None or again.revision != correction.revision or change is None:
                return {"revision": correction.revision, "changed": []}
            about = f"Labelled again with {again.model}: {counted(again.samples, 'sample')} of {len(correction.clouds.xyz):,} changed."
            return {"revision": correction.revision, "about": about, "changed": plain_change(change)}

    def relabelling(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        return plain_relabelling(self.session.relabelling)

    def relabel(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        model = given.get("model")
        if isinstance(model, bool) or not isinstance(model, int):
            raise _Refused(400, "the request needs the number of a model in the field model.")
        return plain_relabelling(self.session.relabel(self._chosen(given), model))

    def stop_relabelling(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        if self.session.relabelling is not None:
            self.session.relabelling.stop()
        return plain_relabelling(self.session.relabelling)

    def teach(self, request: Request, given: dict[str, Any]) -> dict[str, Any]:
        trials, name = self._chosen(given), given.get("model_out")
        if name is not None and not isinstance(name, str):
            raise _Refused(400, "the field model_out is no text; give the name of a file, or null.")
        path = self.session.teach(trials, name)
        return {
            "path": str(path),
            "model": len(self.session.models) - 1,
            "sentence": f"The model has learned {counted(len(trials), 'trial')}; it was written as {path}.",
        }

    async def tell(self, socket: WebSocket) -> None:
        """Tell a page whatever changes, for as long as it is open."""
        await socket.accept()
        loop, waiting = asyncio.get_running_loop(), asyncio.Queue[tuple[str, int]]()

        def listener(trial: str, revision: int) -> None:
            # Changes come from threads; the socket belongs to the loop.
            loop.call_soon_threadsafe(waiting.put_nowait, (trial, revision))

        self.session.listeners.append(listener)
        sender = asyncio.create_task(_send_all(socket, waiting))
        try:
            # The page says nothing; waiting for it tells when it has gone.
            while True:
                await socket.receive_text()
        except (WebSocketDisconnect, KeyError, RuntimeError):
            pass  # the page is gone
        finally:
            self.session.listeners.remove(listener)
            sender.cancel()

    def _chosen(self, given: dict[str, Any]) -> list[str]:
        """The ids of trials that a request names, which are checked: they name files."""
        trials, known = given.get("trials"), {trial.id for trial in self.session.trials}
        if not isinstance(trials, list) or not all(isinstance(trial, str) and trial in known for trial in trials):
            raise _Refused(400, "the request needs the ids of trials in the field trials.")
        return trials

    def _set(self, name: str | None) -> MarkerSet | None:
        """The set whose names are offered. Raises AsterismError where a set that was given cannot be read."""
        if name in self._given_sets:
            return MarkerSet.load(self._given_sets[name])
        # Only shipped names: anything else would be the path of a file.
        return shipped_sets().get(name or "")

    def _trial(self, request: Request) -> CorrectionTrial:
        try:
            return self.session.trial(request.path_params["trial"])
        except KeyError:
            raise _Refused(404, "there is no such trial.") from None


async def _send_all(socket: WebSocket, waiting: asyncio.Queue[tuple[str, int]]) -> None:
    while True:
        trial, revision = await waiting.get()
        await socket.send_text(json.dumps({"trial": trial, "revision": revision}))


def _revision(given: dict[str, Any]) -> int:
    revision = given.get("revision")
    # JSON has true and 1; in Python they are equal.
    if isinstance(revision, bool) or not isinstance(revision, int):
        raise _Refused(400, "the request needs the revision that it is about, a whole number.")
    return revision


def _no_labels() -> CorrectionChange:
    raise AsterismError("the recording has no labels yet, and no gaps or events.")


def _filled(trial: CorrectionTrial, verb: str, given: dict[str, Any]) -> Callable[[Correction], CorrectionChange]:
    """Accept the fill of gaps, or take that back."""
    asked = given.get("gaps")
    rows = asked if isinstance(asked, list) else []
    if not rows or not all(isinstance(row, dict) and isinstance(row.get("marker"), str) for row in rows):
        raise _Refused(400, "the request needs gaps with marker, first and last in the field gaps.")
    if any(isinstance(row.get(name), bool) or not isinstance(row.get(name), int) for row in rows for name in ("first", "last")):
        raise _Refused(400, "a gap's first and last frame are whole numbers.")
    spans = tuple(MarkerSpan(row["marker"], row["first"], row["last"]) for row in rows)
    known = {span for span, _ in spans_of(trial.gaps())} if verb == "fill" else set()

    def act(correction: Correction) -> CorrectionChange:
        # What was accepted is taken back even where labels have changed since.
        if any(span not in (known if verb == "fill" else correction.filled) for span in spans):
            raise AsterismError("this is no gap any more; look at the list again.")
        return correction.touch(Touch("fill", filled=spans) if verb == "fill" else Touch("unfill", unfilled=spans))

    return act


def _events_changed(trial: CorrectionTrial, verb: str, given: dict[str, Any]) -> Callable[[Correction], CorrectionChange]:
    removed, added = (given.get(name, []) for name in ("removed", "added"))
    if not isinstance(removed, list) or not isinstance(added, list):
        raise _Refused(400, "the request needs lists of events in the fields removed and added.")
    found = trial.finishing.events(trial.snapshot())
    return lambda correction: change_events(correction, found, removed, added)


def _name_of_set(given: str | Path | MarkerSet) -> str:
    """What a set that was given is called on the page."""
    return "the names given" if isinstance(given, MarkerSet) else Path(given).name


def _changed_by(held: Correction | GroupNaming, verb: str, given: dict[str, Any]) -> CorrectionChange:
    return _change_names(held, verb, given) if isinstance(held, GroupNaming) else _change(held, verb, given)


def _change_names(naming: GroupNaming, verb: str, given: dict[str, Any]) -> CorrectionChange:
    if verb == "undo":
        return naming.undo()
    if verb == "redo":
        return naming.redo()
    event = given.get("event")
    if verb != "touch" or not isinstance(event, dict) or event.get("kind") != "name" or not isinstance(event.get("marker"), str | None):
        raise _Refused(400, "groups of points are only named: the request needs a piece and a marker, or null, in the field event.")
    group = event.get("piece")
    if isinstance(group, bool) or not isinstance(group, int):
        raise _Refused(400, "the request needs the number of a group in the field piece.")
    return naming.apply(group, event.get("marker"))


def _change(correction: Correction, verb: str, given: dict[str, Any]) -> CorrectionChange:
    if verb == "undo":
        return correction.undo()
    if verb == "redo":
        return correction.redo()
    if verb == "refuse":
        pieces = given.get("pieces")
        if not isinstance(pieces, list) or not all(isinstance(piece, int) and not isinstance(piece, bool) for piece in pieces):
            raise _Refused(400, "the request needs the ids of pieces in the field pieces.")
        if correction.last_change is None:
            raise _Refused(400, "nothing has changed that could be refused.")
        return correction.refuse(correction.last_change, pieces)
    event = given.get("event")
    if not isinstance(event, dict):
        raise _Refused(400, "the request needs what was said in the field event.")
    return correction.apply(request_of(event))


async def _json_of(request: Request) -> dict[str, Any]:
    """The JSON object of a request."""
    # A form of another page cannot send this type without asking first.
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
        raise _Refused(415, "the request is no JSON.")
    body = b""
    async for part in request.stream():
        body += part
        # Counted while it arrives: the header may lie.
        if len(body) > MAX_BODY:
            raise _Refused(413, f"the request has more than {MAX_BODY} bytes.")
    try:
        given = json.loads(body)
    except (ValueError, RecursionError):
        raise _Refused(400, "the request is no JSON.") from None
    if not isinstance(given, dict):
        raise _Refused(400, "the request is no JSON object.")
    return given


def static_file(name: str) -> Response:
    """One of the page's own files."""
    kind = _TYPES.get(name.rpartition(".")[2])
    if name in ("player.js", "player.css"):
        return Response(player_script() if name.endswith("js") else player_style(), media_type=kind)
    # No path leads out of the folder of the page's files.
    if kind is None or name != name.replace("/", "").replace("\\", "") or name.startswith("."):
        return JSONResponse({"error": "there is no such file."}, 404)
    file = resources.files("asterism.web").joinpath("static", name)
    if not file.is_file():
        return JSONResponse({"error": "there is no such file."}, 404)
    return Response(file.read_bytes(), media_type=kind)
