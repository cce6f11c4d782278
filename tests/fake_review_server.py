"""A server for tests of the page on which labels are corrected: one recording, its tracks are the pieces, names are taken as given."""

from __future__ import annotations

import http.server
import json
import threading
from importlib import resources
from typing import Any
from urllib.parse import parse_qs, urlparse

import numpy as np

from asterism.recording import Clouds, Floats, Ints
from asterism.recording.sides import marker_sides
from asterism.report import player_script, player_style

TOKEN = "secret"


class FakeReview:
    """The recording's state: a marker for each track, and what was asked of it."""

    def __init__(self, clouds: Clouds, marker_of_track: Ints, confidence: Floats, names: tuple[str, ...], trial: str = "walk.c3d") -> None:
        assert clouds.tracks is not None
        self.clouds, self.names, self.trial = clouds, names, trial
        self.marker, self.confidence = marker_of_track.copy(), confidence.copy()
        self.person, self.ghost = np.zeros(len(self.marker), dtype=np.bool_), np.zeros(len(self.marker), dtype=np.bool_)
        frame_of, tracks = clouds.frame_of, clouds.tracks
        self.first = np.array([frame_of[tracks == k].min(initial=len(clouds)) for k in range(len(self.marker))])
        self.last = np.array([frame_of[tracks == k].max(initial=0) for k in range(len(self.marker))])
        self.revision, self.asked = 1, list[dict[str, Any]]()
        self.failures = 0
        self.models, self.left, self.changed, self.before = ["gait.model"], 0, 0, 0

    def state(self) -> dict[str, Any]:
        doubt = np.where(self.marker >= 0, 1 - self.confidence, 0.4) * (self.last - self.first + 1)
        doubt[self.person | self.ghost] = 0.0
        order = [int(k) for k in np.argsort(-doubt, kind="stable") if doubt[k] > 0.1][:500]
        ids = range(100, 100 + len(self.marker))
        return {
            "revision": self.revision,
            "markers": list(self.names),
            "side": marker_sides(self.names),
            "bones": [[i, i + 1] for i in range(len(self.names) - 1)],
            "rate": self.clouds.rate,
            "first_frame": 101,
            "frames": len(self.clouds),
            "pieces": {
                "id": list(ids),
                "first": self.first.tolist(),
                "last": self.last.tolist(),
                "marker": self.marker.tolist(),
                "confidence": self.confidence.tolist(),
                "ghost": self.ghost.tolist(),
                "person": self.person.tolist(),
                "track": list(range(len(self.marker))),
            },
            "unsure": [[[0, 4], [20, 29]], *([] for _ in self.names[1:])],
            "items": [
                {"piece": 100 + k, "frame": int(self.first[k]), "gain": float(doubt[k]), "alternatives": [[self.names[0], 0.3]]}
                for k in order
            ],
            "verdict": {"kind": "look", "sentence": f"Look at {len(order)} pieces of tracks.", "look_at": len(order)},
            "can_undo": self.revision > 1,
            "can_redo": False,
            "touches": self.revision - 1,
            "saved": False,
            "relabelled": len(self.models) > 1,
        }

    def trials(self) -> dict[str, Any]:
        state = self.state()
        row: dict[str, Any] = {"id": "t1", "name": self.trial, "path": f"/lab/{self.trial}", "state": "ready", "error": None, "notes": []}
        row |= {
            "frames": len(self.clouds),
            "rate": self.clouds.rate,
            "first_frame": 101,
            "verdict": state["verdict"],
            "touches": 0,
            "saved": False,
        }
        failed = {"id": "t2", "name": "broken.c3d", "path": "broken.c3d", "state": "failed", "error": "broken.c3d is no C3D file."}
        return {"trials": [row, failed | {"notes": [], "saved": False}], "models": self.models, "out": "out"}

    def touch(self, event: dict[str, Any]) -> list[dict[str, Any]]:
        k = event["piece"] - 100
        before = self.names[self.marker[k]] if self.marker[k] >= 0 else None
        if event["kind"] == "name":
            self.marker[k] = self.names.index(event["marker"])
        if event["kind"] == "ghost":
            self.marker[k], self.ghost[k] = -1, True
        self.person[k], self.revision = True, self.revision + 1
        after = self.names[self.marker[k]] if self.marker[k] >= 0 else "ghost"
        return [
            {"piece": 100 + k, "first": int(self.first[k]), "last": int(self.last[k]), "before": before, "after": after, "by_person": True}
        ]

    def relabel(self, given: dict[str, Any]) -> dict[str, Any]:
        """Begin to label again; the first track of those that nobody named gets another marker."""
        self.asked.append(given)
        self.left = 3
        k = int(np.nonzero(~self.person & (self.marker > 0))[0][0])
        self.changed, self.before, self.marker[k] = k, int(self.marker[k]), 0
        return self.relabelling()

    def relabelling(self) -> dict[str, Any]:
        """How far it is; it is done when it has been asked for so often."""
        self.left -= 1
        if self.left:
            return {"running": True, "trial": self.trial, "model": self.models[-1], "done": 0, "of": 1, "share": 0.5, "failed": 0}
        self.revision += 1
        self.models.append("later.model")
        return {"running": False, "failed": 0, "sentence": "1 recording labelled again: 1 sample changed."}

    def what_changed(self) -> dict[str, Any]:
        k = self.changed
        part: dict[str, Any] = {"piece": 100 + k, "first": int(self.first[k]), "last": int(self.last[k]), "by_person": False}
        part |= {"before": self.names[self.before], "after": self.names[0]}
        return {"revision": self.revision, "about": "Labelled again with <b>.model: 1 sample changed.", "changed": [part]}

    def get(self, path: str, query: dict[str, list[str]]) -> tuple[bytes | Any, str]:
        if path == "/api/trials":
            return self.trials(), "application/json"
        if path == "/api/relabel":
            return self.relabelling(), "application/json"
        if path.endswith("/changed"):
            return self.what_changed(), "application/json"
        if path.endswith("/state"):
            return self.state(), "application/json"
        if path.endswith("/candidates"):
            return {"candidates": [[name, 0.5 / (i + 1)] for i, name in enumerate(self.names)]}, "application/json"
        if path.endswith("/piece_points"):
            assert self.clouds.tracks is not None
            return self.clouds.tracks.astype("<u4").tobytes(), "application/octet-stream"
        if path.endswith("/points"):
            head = np.array([len(self.clouds), len(self.clouds.xyz)], dtype="<u4").tobytes() + self.clouds.offsets.astype("<u4").tobytes()
            return head + self.clouds.xyz.astype("<f4").tobytes(), "application/octet-stream"
        raise KeyError(path)


def static(path: str, driver: str) -> tuple[bytes, str]:
    """One of the page's files; the page loads the driver after its own scripts."""
    if path == "/static/driver.js":
        return driver.encode(), "text/javascript"
    if path == "/":
        page = (resources.files("asterism") / "web" / "static" / "review.html").read_text(encoding="utf-8")
        return page.replace("</body>", '<script src="/static/driver.js"></script></body>').encode(), "text/html; charset=utf-8"
    name = path.removeprefix("/static/")
    kind = {"js": "text/javascript", "css": "text/css"}[name.rpartition(".")[2]]
    if name in ("player.js", "player.css"):
        return (player_script() if name.endswith("js") else player_style()).encode(), kind
    return (resources.files("asterism") / "web" / "static" / name).read_bytes(), kind


def serve(review: FakeReview, driver: str = "") -> http.server.ThreadingHTTPServer:
    """A server on a free port, in a thread of its own; its `server_port` is the port. driver: a script that stands for the person."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def answer(self, status: int, content: bytes | Any, kind: str = "application/json") -> None:
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(data)))
            self.send_header(
                "Content-Security-Policy",
                "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data:; connect-src 'self'",
            )
            self.end_headers()
            self.wfile.write(data)

        def do_GET(self) -> None:
            url = urlparse(self.path)
            if url.path == "/" or url.path.startswith("/static/"):
                self.answer(200, *static(url.path, driver))
            elif self.headers.get("X-Asterism-Token") != TOKEN:
                self.answer(403, {"error": "the token is missing or of an earlier run."})
            else:
                self.answer(200, *review.get(url.path, parse_qs(url.query)))

        def do_POST(self) -> None:
            given = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            if self.path == "/api/relabel":
                self.answer(200, review.relabel(given))
                return
            if given["revision"] != review.revision:
                self.answer(409, {"error": "the labels were changed in another window."})
                return
            review.asked.append(given)
            changed = review.touch(given.get("event", {"kind": "refuse", "piece": given.get("pieces", [0])[0]}))
            self.answer(200, {"changed": changed, "revision": review.revision, "state": review.state()})

        def log_message(self, *words: object) -> None:
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server
