"""The page's server: what it answers, whom it refuses, two tabs, files that fail or change, and the command that starts it."""

from __future__ import annotations

import builtins
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import url2pathname

import numpy as np
import pytest
from correcting import Browser, longest, model, quick_learner, served, written

from asterism import formats
from asterism.errors import AsterismError
from asterism.labelling import MarkerModel
from asterism.labelling.recording_labeller import RecordingLabeller
from asterism.recording import Clouds, Recording

websockets = pytest.importorskip("websockets.sync.client")
pytest.importorskip("starlette")
pytest.importorskip("uvicorn")

from asterism.web import CorrectionSession, PageAddress, SessionOptions, serve  # noqa: E402
from asterism.web import session as web_session  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def walks_labelled_once() -> Iterator[None]:
    """Sittings of the same walk begin with the same labels: one model labels the same points with the same settings once."""
    label, kept = RecordingLabeller.label_bodies, dict[tuple[object, ...], Any]()

    def remembered(labeller: RecordingLabeller, clouds: Clouds, progress: Any = None, **more: Any) -> Any:
        if labeller.models != (model(),):
            return label(labeller, clouds, progress, **more)
        tracks = None if clouds.tracks is None else clouds.tracks.tobytes()
        given = (repr(labeller.settings), clouds.xyz.tobytes(), clouds.offsets.tobytes(), clouds.vertical.tobytes(), tracks, repr(more))
        if given not in kept:
            kept[given] = label(labeller, clouds, progress, **more)
        return kept[given]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(RecordingLabeller, "label_bodies", remembered)
        yield


def sitting(folder: Path, count: int = 1, **options: Any) -> CorrectionSession:
    return CorrectionSession(written(folder, count), model(), SessionOptions((folder / "gait.model",), **options))


def long_piece(state: dict[str, Any]) -> int:
    pieces = state["pieces"]
    return longest(pieces["id"], pieces["first"], pieces["last"])


def touched(browser: Browser, marker: str = "SACR", trial: str = "0") -> dict[str, Any]:
    state = browser.get(f"/api/trials/{trial}/state")
    event = {"kind": "name", "piece": long_piece(state), "marker": marker}
    return dict(browser.post(f"/api/trials/{trial}/touch", {"revision": state["revision"], "event": event}))


def test_a_touch_saves_the_file_and_its_history(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        [trial] = browser.get("/api/trials")["trials"]
        assert trial["state"] == "ready" and trial["first_frame"] == 11 and not trial["saved"]
        state = browser.get("/api/trials/0/state")
        unsure = sum(last - first + 1 for runs in state["unsure"] for first, last in runs)
        assert unsure == round(trial["unsure"] * trial["frames"] * len(state["markers"])), "the timeline shows what the list says"
        answer = touched(browser)
        [said] = [part for part in answer["changed"] if part["by_person"]]
        assert said["after"] == "SACR" and answer["state"]["touches"] == 1
        undone = browser.post("/api/trials/0/undo", {"revision": answer["revision"]})
        assert [part["before"] for part in undone["changed"] if part["piece"] == said["piece"]] == ["SACR"]
        redone = browser.post("/api/trials/0/redo", {"revision": undone["revision"]})
        place = redone["state"]["pieces"]["id"].index(said["piece"])
        assert redone["state"]["pieces"]["person"][place] and redone["state"]["pieces"]["marker"][place] == 2
        follows = next(part for part in redone["changed"] if not part["by_person"] and part["before"])
        refused = browser.post("/api/trials/0/refuse", {"revision": redone["revision"], "pieces": [follows["piece"]]})
        assert refused["state"]["touches"] == 2
        saved = browser.post("/api/trials/0/save", {})
        assert browser.get("/api/trials/0/state")["saved"]
    done = formats.read(saved["path"])
    assert Path(saved["path"]) == tmp_path / "corrected" / "walk1.c3d"
    assert [step.action for step in done.log] == ["labelled", "corrected"]
    assert "SACR" in done.labels


def test_points_and_pieces_are_what_the_file_holds(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        _, body, _ = browser.ask("/api/trials/0/points")
        _, of_point, _ = browser.ask("/api/trials/0/piece_points")
        state = browser.get("/api/trials/0/state")
    clouds = formats.read(tmp_path / "walk1.c3d").clouds()
    frames, points = np.frombuffer(body[:8], "<u4")
    assert (frames, points) == (len(clouds), len(clouds.xyz))
    np.testing.assert_array_equal(np.frombuffer(body[8 : 8 + 4 * (frames + 1)], "<u4"), clouds.offsets)
    np.testing.assert_allclose(np.frombuffer(body[8 + 4 * (frames + 1) :], "<f4").reshape(-1, 3), clouds.xyz, atol=1e-6)
    piece = np.frombuffer(of_point, "<u4")
    assert len(piece) == points and piece.max() + 1 == len(state["pieces"]["id"])
    np.testing.assert_array_equal(np.array(state["pieces"]["first"])[piece] <= clouds.frame_of, True)
    assert {len(values) for values in state["pieces"].values()} == {len(state["pieces"]["id"])}
    assert state["side"][state["markers"].index("LKNE")] == "left" and len(state["bones"]) > 5


def test_candidates_name_all_markers_the_likeliest_first(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        state = browser.get("/api/trials/0/state")
        candidates = browser.get(f"/api/trials/0/candidates?piece={long_piece(state)}")["candidates"]
        assert browser.ask("/api/trials/0/candidates?piece=x")[0] == 400
        assert browser.ask("/api/trials/0/candidates?piece=99999999999999999999")[0] == 400
    chances = [chance for _, chance in candidates]
    assert sorted(chances, reverse=True) == chances and {name for name, _ in candidates} == set(state["markers"])


def test_an_old_revision_is_told_and_changes_nothing(tmp_path: Path) -> None:
    """Two tabs: the second has not seen the first one's touch."""
    with served(sitting(tmp_path)) as browser:
        state = browser.get("/api/trials/0/state")
        touched(browser)
        event = {"kind": "ghost", "piece": state["pieces"]["id"][3]}
        status, body, _ = browser.ask("/api/trials/0/touch", {"revision": state["revision"], "event": event})
        assert status == 409 and "changed since" in json.loads(body)["error"]
        assert browser.get("/api/trials/0/state")["touches"] == 1


def test_another_tab_is_told_of_a_touch(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser, websockets.connect(f"ws://{browser.host}/ws?token={browser.token}") as other:
        answer = touched(browser)
        assert json.loads(other.recv(timeout=20)) == {"trial": "0", "revision": answer["revision"]}


def test_two_tabs_that_touch_at_once_are_answered_one_after_the_other(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        state = browser.get("/api/trials/0/state")
        answers: list[int] = []

        def touch(number: int) -> None:
            event = {"kind": "ghost", "piece": state["pieces"]["id"][number]}
            answers.append(browser.ask("/api/trials/0/touch", {"revision": state["revision"], "event": event})[0])

        threads = [threading.Thread(target=touch, args=(number,)) for number in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(answers) == [200, 409, 409, 409, 409, 409]
        assert browser.get("/api/trials/0/state")["touches"] == 1


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({}, 200),
        ({"X_Asterism_Token": "guessed"}, 403),
        ({"X_Asterism_Token": ""}, 403),
        ({"X_Asterism_Token": "a-tokeN"}, 403),
        ({"Host": "evil.example:80"}, 403),
        ({"Host": "evil.example"}, 403),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
    ],
)
def test_only_the_page_itself_is_answered(headers: dict[str, str], status: int, tmp_path: Path) -> None:
    with served(sitting(tmp_path, count=0)) as browser:
        found, body, _ = browser.ask("/api/trials", **headers)
        assert found == status
        assert ("trials" in json.loads(body)) == (status == 200)


def test_a_name_of_another_host_with_our_port_is_refused(tmp_path: Path) -> None:
    """A page of another site whose own name points at this machine."""
    with served(sitting(tmp_path, count=0)) as browser:
        port = browser.host.rpartition(":")[2]
        assert browser.ask("/api/trials", Host=f"evil.example:{port}")[0] == 403
        assert browser.ask("/api/trials", Host=f"localhost:{port}")[0] == 200
        assert browser.ask("/api/trials", Host=f"localhost:{port}", Origin=f"http://localhost:{port}")[0] == 200
        assert browser.ask("/api/trials", Host=f"localhost:{port}", Origin=f"http://127.0.0.1:{port}")[0] == 403


@pytest.mark.parametrize("origin", [None, "http://evil.example"])
def test_a_socket_without_token_or_from_another_page_is_refused(origin: str | None, tmp_path: Path) -> None:
    with served(sitting(tmp_path, count=0)) as browser:
        token = "guessed" if origin is None else browser.token
        with pytest.raises(Exception, match="403"):
            websockets.connect(f"ws://{browser.host}/ws?token={token}", origin=origin)


def test_the_page_is_served_with_a_policy_and_nothing_outside_its_folder(tmp_path: Path) -> None:
    with served(sitting(tmp_path, count=0)) as browser:
        status, _, headers = browser.ask(f"/?token={browser.token}")
        assert status in (200, 404)
        assert "default-src 'none'" in headers["content-security-policy"] and headers["referrer-policy"] == "no-referrer"
        assert browser.ask("/", X_Asterism_Token="")[0] == 403
        status, script, headers = browser.ask("/static/player.js", X_Asterism_Token="")
        assert status == 200 and script and headers["content-type"].startswith("text/javascript")
        for path in ("/static/..%2fapp.py", "/static/%2e%2e/app.py", "/static/app.py", "/static/.gitignore", "/static/x.html", "/app.py"):
            assert browser.ask(path, X_Asterism_Token=browser.token)[0] == 404, path


@pytest.mark.parametrize(
    ("given", "status"),
    [
        (b"", 400),
        (b"{", 400),
        (b"[]", 400),
        (b"[" * 50_000, 400),
        (b" " * 70_000, 413),
        (b'{"revision": true, "event": {}}', 400),
        (b'{"revision": 1}', 400),
        (b'{"revision": 1, "event": []}', 400),
        (b'{"revision": 1, "event": {"kind": "name", "piece": 1e300, "marker": "SACR"}}', 400),
        (b'{"revision": 1, "event": {"kind": "cut", "piece": 0, "frame": 123456789012345678901234567890}}', 400),
        (b'{"revision": 1, "event": {"kind": "name", "piece": 0, "marker": "<img src=x onerror=alert(1)>\\u202e\\u0000"}}', 400),
        (b'{"revision": 1, "event": {"kind": "name", "piece": 0, "marker": "\\ud800"}}', 400),
    ],
)
def test_a_hostile_request_is_a_sentence(given: bytes, status: int, tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        found, body, headers = browser.ask("/api/trials/0/touch", given)
        assert found == status and json.loads(body)["error"].endswith(".")
        assert headers["content-type"] == "application/json" and headers["x-content-type-options"] == "nosniff"
        assert browser.get("/api/trials/0/state")["touches"] == 0


def test_a_form_of_another_page_is_no_request(tmp_path: Path) -> None:
    """What a page can send without being asked for leave: a form, as text."""
    with served(sitting(tmp_path)) as browser:
        for kind in ("text/plain", "application/x-www-form-urlencoded"):
            assert browser.ask("/api/trials/0/undo", b'{"revision": 1}', Content_Type=kind)[0] == 415


def test_a_file_that_fails_costs_itself_only(tmp_path: Path) -> None:
    files = written(tmp_path, 2)
    files[0].write_bytes(b"no C3D at all")
    files.append(tmp_path / "<b>&\u202e=1.trc")
    files[-1].write_text("hostile")
    with served(CorrectionSession(files, model(), SessionOptions((tmp_path / "gait.model",)))) as browser:
        first, second, third = browser.get("/api/trials")["trials"]
        assert [first["state"], second["state"], third["state"]] == ["failed", "ready", "failed"]
        assert "walk1.c3d" in first["error"] and third["name"] == files[-1].name
        status, body, _ = browser.ask("/api/trials/0/state")
        assert status == 400 and json.loads(body)["error"] == first["error"]
        assert browser.ask("/api/trials/7/state")[0] == 404


def test_a_sitting_goes_on_where_it_stopped(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        touched(browser)
        browser.post("/api/trials/0/save", {})
        touched(browser, "LASI")
    with served(sitting(tmp_path)) as browser:
        state = browser.get("/api/trials/0/state")
        assert state["touches"] == 2 and not state["saved"]
        browser.post("/api/trials/0/save", {})  # the file there is the one that an earlier sitting saved
    with served(sitting(tmp_path)) as browser:
        assert browser.get("/api/trials/0/state")["saved"]


def test_a_file_that_is_not_ours_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "corrected").mkdir()
    (tmp_path / "corrected" / "walk1.c3d").write_bytes(b"someone's")
    with served(sitting(tmp_path)) as browser:
        status, body, _ = browser.ask("/api/trials/0/save", {})
        assert status == 400 and "exists; choose another folder" in json.loads(body)["error"]
    with served(sitting(tmp_path, overwrite=True)) as browser:
        browser.post("/api/trials/0/save", {})


def test_a_recording_that_changed_on_the_disk_is_not_saved_over(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser:
        touched(browser)
        with (tmp_path / "walk1.c3d").open("ab") as file:
            file.write(b"more")
        status, body, _ = browser.ask("/api/trials/0/save", {})
        assert status == 400 and "changed on the disk" in json.loads(body)["error"]


def test_two_sittings_of_one_file(tmp_path: Path) -> None:
    with served(sitting(tmp_path)) as browser, served(sitting(tmp_path)) as early:
        touched(browser)
        # One that was open before the log was begun is told with its first answer; one that comes later, at once.
        state = early.get("/api/trials/0/state")
        event = {"kind": "name", "piece": long_piece(state), "marker": "SACR"}
        status, body, _ = early.ask("/api/trials/0/touch", {"revision": state["revision"], "event": event})
        assert status == 400 and "begun by another program" in json.loads(body)["error"]
        assert early.get("/api/trials/0/state")["touches"] == 0
        with served(sitting(tmp_path)) as late:
            [trial] = late.get("/api/trials")["trials"]
            assert trial["state"] == "failed" and "open in another program" in trial["error"]


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_file_that_was_being_saved_when_the_program_was_killed_is_known_as_ours(
    when: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = web_session.write_atomically

    def killed(path: Path, data: bytes) -> None:
        if when == "after":
            write(path, data)
        raise AsterismError("killed")

    with served(sitting(tmp_path)) as browser:
        touched(browser)
        browser.post("/api/trials/0/save", {})
        touched(browser, "LASI")
        monkeypatch.setattr(web_session, "write_atomically", killed)
        assert browser.ask("/api/trials/0/save", {})[0] == 400
    monkeypatch.undo()
    with served(sitting(tmp_path)) as browser:
        assert browser.get("/api/trials/0/state")["saved"] == (when == "after")
        browser.post("/api/trials/0/save", {})
        assert browser.get("/api/trials/0/state")["saved"]


def test_answers_go_on_into_a_new_log_where_it_was_deleted(tmp_path: Path) -> None:
    log = tmp_path / "walk1.c3d.asterism-log.jsonl"
    with served(sitting(tmp_path)) as browser:
        touched(browser)
        log.unlink()
        touched(browser, "LASI")
        log.write_text("notes")
        state = browser.get("/api/trials/0/state")
        status, body, _ = browser.ask("/api/trials/0/undo", {"revision": state["revision"]})
        assert status == 400 and "changed or replaced" in json.loads(body)["error"]
        assert browser.get("/api/trials/0/state")["touches"] == 2
    (tmp_path / "walk1.c3d.asterism-log-2.jsonl").replace(log)
    with served(sitting(tmp_path)) as browser:
        assert browser.get("/api/trials/0/state")["touches"] == 2


def test_logs_can_be_in_a_folder_of_their_own(tmp_path: Path) -> None:
    with served(sitting(tmp_path, log_folder=tmp_path / "logs")) as browser:
        touched(browser)
    assert [path.name for path in (tmp_path / "logs").iterdir()] == ["walk1.c3d.asterism-log.jsonl"]
    assert not list(tmp_path.glob("*.jsonl"))


def test_the_model_learns_what_was_saved(tmp_path: Path) -> None:
    session = CorrectionSession(written(tmp_path), quick_learner(), SessionOptions((tmp_path / "gait.model",)))
    with served(session) as browser:
        status, body, _ = browser.ask("/api/teach", {"trials": ["0"], "model_out": None})
        assert status == 400 and "not saved" in json.loads(body)["error"]
        browser.post("/api/trials/0/save", {})
        for name in ("../better", "a/b.model", "", ".hidden", "a\\b", "gait.model"):
            assert browser.ask("/api/teach", {"trials": ["0"], "model_out": name})[0] == 400, name
        assert browser.ask("/api/teach", {"trials": ["9"], "model_out": None})[0] == 400
        before = (tmp_path / "gait.model").read_bytes()
        answer = browser.post("/api/teach", {"trials": ["0"], "model_out": "better"})
    assert Path(answer["path"]) == tmp_path / "better.model" and (tmp_path / "gait.model").read_bytes() == before
    assert MarkerModel.load(tmp_path / "better.model").about["recordings"] == model().about["recordings"] + 1


def test_two_files_of_one_name_need_two_folders(tmp_path: Path) -> None:
    paths = [tmp_path / "a" / "walk.c3d", tmp_path / "b" / "walk.c3d"]
    with pytest.raises(AsterismError, match="would both become"):
        CorrectionSession(paths, model(), SessionOptions((tmp_path / "gait.model",), output=tmp_path / "out"))
    CorrectionSession(paths, model(), SessionOptions((tmp_path / "gait.model",)))


def test_a_port_that_is_taken_is_a_sentence(tmp_path: Path) -> None:
    session = CorrectionSession([], model(), SessionOptions((tmp_path / "gait.model",)))
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(AsterismError, match="is taken by another program; give another with --port"):
            serve(session, PageAddress(port=other.getsockname()[1], browser=False), lambda sentence: None)


def test_a_host_of_another_machine_is_a_sentence(tmp_path: Path) -> None:
    session = CorrectionSession([], model(), SessionOptions((tmp_path / "gait.model",)))
    with pytest.raises(AsterismError, match="no address of this machine"):
        serve(session, PageAddress(host="192.0.2.7", browser=False), lambda sentence: None)


def test_without_the_extra_one_sentence_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any) -> Any:
        if name == "uvicorn":
            raise ModuleNotFoundError("No module named 'uvicorn'", name="uvicorn")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    session = CorrectionSession([], model(), SessionOptions((tmp_path / "gait.model",)))
    with pytest.raises(AsterismError, match=r"pip install asterism\[web\]"):
        serve(session, PageAddress(browser=False), lambda sentence: None)


def test_a_machine_without_a_browser_gets_the_address(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from asterism.web import serving

    said: list[str] = []
    monkeypatch.setattr(serving.webbrowser, "open", lambda address: False)
    for leading in (tmp_path / "page.html", None):
        serving._open(leading, said.append)
    assert said == 2 * ["No browser could be opened; open the address yourself."]


@pytest.mark.parametrize(("host", "warned"), [("127.0.0.1", False), ("localhost", False), ("0.0.0.0", True)])
def test_the_token_is_in_no_argument_and_a_network_is_warned_of(
    host: str, warned: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import uvicorn

    from asterism.web import serving

    opened: list[tuple[str, int, str]] = []

    def browser(address: str) -> bool:
        file = Path(url2pathname(urlsplit(address).path))
        opened.append((address, file.stat().st_mode & 0o777, file.read_text(encoding="utf-8")))
        return True

    def run(self: Any, sockets: Any) -> None:
        while not opened:
            time.sleep(0.01)

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(serving.os.path, "isdir", lambda path: False)
    monkeypatch.setattr(serving.webbrowser, "open", browser)
    monkeypatch.setattr(uvicorn.Server, "run", run)
    said: list[str] = []
    serve(CorrectionSession([], model(), SessionOptions((tmp_path / "gait.model",))), PageAddress(host), said.append)
    [(address, mode, page)] = opened
    url = said[0].removeprefix("The page is at ")
    token = url.rpartition("=")[2]
    assert len(token) == 32 and token not in address and f'url={url}"' in page
    assert mode == 0o600 or os.name != "posix"
    assert any("nothing is encrypted" in sentence for sentence in said) == warned
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("port", "given", "known"),
    [
        (80, "127.0.0.1", True),
        (80, "127.0.0.1:80", True),
        (80, "localhost", True),
        (80, "[::1]", True),
        (80, "evil.example", False),
        (81, "127.0.0.1", False),
        (81, "[::1]:81", True),
        (81, "[::1]", False),
        (80, "", False),
    ],
)
def test_a_browser_leaves_out_port_80(port: int, given: str, known: bool) -> None:
    from asterism.web.guard import Guard

    assert Guard(None, "token", "127.0.0.1", port)._is_own_name(given) == known


def test_a_hundred_columns_of_odd_names(tmp_path: Path) -> None:
    """Names are text: the server gives them back as they are, in JSON that any reader takes."""
    [file] = written(tmp_path)
    recording = formats.read(file)
    names = tuple(f'<script>"{n}\u202e=cmd|[bold]' for n in range(len(recording.labels)))
    odd = tmp_path / "odd.npz"
    formats.write(odd, Recording(recording.positions, names, recording.rate, recording.vertical))
    with served(CorrectionSession([odd], model(), SessionOptions((tmp_path / "gait.model",)))) as browser:
        _, body, headers = browser.ask("/api/trials/0/state")
        assert json.loads(body)["markers"] == list(model().marker_set.names)
        assert headers["content-type"] == "application/json"


@pytest.mark.skipif(os.name != "posix", reason="a process is interrupted by a signal")
def test_the_command_serves_until_it_is_interrupted(tmp_path: Path) -> None:
    [file] = written(tmp_path)
    words = ["review", "--serve", str(file), "--model", str(tmp_path / "gait.model"), "--no-browser"]
    run = subprocess.Popen([sys.executable, "-m", "asterism", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert run.stdout is not None
    browser = Browser(run.stdout.readline().split()[-1])
    while (trial := browser.get("/api/trials")["trials"][0])["state"] in ("waiting", "labelling"):
        time.sleep(0.02)
    assert trial["state"] == "ready"
    touched(browser)
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=60)
    assert run.returncode == 0, err
    assert "Not saved: walk1.c3d." in out and "Traceback" not in err
