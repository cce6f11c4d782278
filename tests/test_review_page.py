"""The page on which labels are corrected: what it makes of a state, how it sends, and that it shows names as text.

The scripts run in Node, the page in Chromium against a server that stands for the real one, where these are installed.
"""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import in_node, needs_chromium, needs_node, opened
from fake_review_server import TOKEN, FakeReview, serve

from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.simulation import simulate_walks

STATIC = resources.files("asterism") / "web" / "static"
SCRIPTS = [entry.name for entry in STATIC.iterdir() if entry.name.endswith(".js")]


def script(name: str) -> str:
    return (STATIC / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def review() -> FakeReview:
    """A walk with gaps: every third track in doubt, some of the short ones without a label."""
    walk = simulate_walks(1, frames=90, seed=2)[0]
    clouds, truth = simulate_gaps_and_ghosts(walk, 3, 0, seed=1)
    assert clouds.tracks is not None
    marker = np.full(clouds.tracks.max() + 1, -1)
    frames, markers = np.nonzero(truth >= 0)
    marker[clouds.tracks[clouds.offsets[frames] + truth[frames, markers]]] = markers
    short = np.nonzero(np.bincount(clouds.tracks) < 40)[0]
    marker[short[::3]] = -1
    confidence = np.where(np.arange(len(marker)) % 3 == 0, 0.6, 0.9999)
    return FakeReview(clouds, marker, confidence, walk.labels)


def shown(review: FakeReview, code: str, folder: Path) -> Any:
    """What the code makes of the review's state, as `labels`."""
    tracks = review.clouds.tracks
    assert tracks is not None
    points, _ = review.get("/api/trials/t1/points", {})
    preamble = (
        "const labels = new Asterism.Labels('w', Asterism.readPoints(Uint8Array.from(bytes).buffer), state, Uint32Array.from(tracks)); "
    )
    given = {"bytes": list(points), "state": review.state(), "tracks": tracks.tolist()}
    return in_node(preamble + code, folder, scripts=script("labels.js"), **given)


@pytest.mark.parametrize("name", ["review", "live"])
def test_the_page_asks_nobody_else_and_writes_no_markup(name: str) -> None:
    page = (STATIC / f"{name}.html").read_text(encoding="utf-8")
    scripts = [each for each in SCRIPTS if each.startswith("live") == (name == "live")]
    assert re.findall(r"<script(?![^>]*src=)", page) == [] and not re.search(r"\son\w+=", page), "the server forbids inline scripts"
    loads = re.findall(r"(?:src|href)=\"([^\"]*)\"", page)
    assert {load for load in loads if not load.startswith("/static/")} == {"data:,"}
    files = {load.removeprefix("/static/") for load in loads if load.startswith("/static/")} - {"player.js", "player.css"}
    assert files == {*scripts, f"{name}.css"} and all((STATIC / each).is_file() for each in files)
    # Nothing of a recording stays in the browser; of a live session the choice of curves and of light does.
    kept = "" if name == "live" else "|localStorage"
    for each in scripts:
        code = script(each)
        assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\b|new Function|https?://" + kept, code), each
    assert not re.search(r"url\(|@import", (STATIC / f"{name}.css").read_text(encoding="utf-8"))


def test_every_element_that_the_scripts_name_is_on_the_page() -> None:
    page = (STATIC / "review.html").read_text(encoding="utf-8")
    named = {name for file in SCRIPTS for name in re.findall(r"\bat\(\"([\w-]+)\"\)", script(file))}
    assert len(named) > 20 and named <= set(re.findall(r"id=\"([\w-]+)\"", page))


@needs_node
def test_points_bear_the_labels_of_their_pieces(review: FakeReview, tmp_path: Path) -> None:
    clouds = review.clouds
    tracks = clouds.tracks
    assert tracks is not None
    got = shown(
        review,
        """const { recording: r } = labels;
        return { marker: [...r.marker], confidence: [...r.confidence], codes: [...labels.codes()], bars: labels.bars(), first: r.number(0),
          at: labels.pieces.id.map((_, k) => [0, 30, 60].map(t => labels.pointAt(k, t))), rows: labels.rows(labels.codes()),
          ofMarker: r.names.map((_, m) => [0, 30, 60].map(t => labels.placeOfMarker(m, t))) };""",
        tmp_path,
    )
    marker = review.marker[tracks]
    np.testing.assert_array_equal(got["marker"], marker)
    np.testing.assert_allclose(got["confidence"], review.confidence[tracks], atol=1e-6)
    assert got["first"] == 101
    codes = np.array(got["codes"]).reshape(len(review.names), len(clouds))
    given = np.zeros(codes.shape, dtype=np.bool_)
    given[marker[marker >= 0], clouds.frame_of[marker >= 0]] = True
    # Points without a label are left in other frames, too: which of them may be a marker, the server says.
    unsure = np.zeros(codes.shape, dtype=np.bool_)
    for first, last in review.state()["unsure"][0]:
        unsure[0, first : last + 1] = True
    assert (unsure & given).any() and (unsure & ~given).any()
    np.testing.assert_array_equal(codes > 1, given)
    np.testing.assert_array_equal(codes == 1, ~given & unsure)
    np.testing.assert_allclose([row["share"] for row in got["rows"]], given.mean(axis=1))
    assert {bar["place"] for bar in got["bars"]} == set(np.nonzero(review.marker < 0)[0])
    for k, points in enumerate(got["at"]):
        for t, point in zip((0, 30, 60), points, strict=True):
            own = np.nonzero((clouds.frame_of == t) & (tracks == k))[0]
            assert point == (own[0] if len(own) else -1)
    for m, places in enumerate(got["ofMarker"]):
        for t, place in zip((0, 30, 60), places, strict=True):
            own = np.nonzero((clouds.frame_of == t) & (marker == m))[0]
            assert place == (tracks[own[0]] if len(own) else -1)


@needs_node
def test_a_piece_says_how_fast_it_is_and_what_it_is_near(review: FakeReview, tmp_path: Path) -> None:
    clouds = review.clouds
    tracks = clouds.tracks
    assert tracks is not None
    got = shown(review, "return labels.pieces.id.map((_, k) => labels.motion(k));", tmp_path)
    place = int(np.argmax(np.bincount(tracks[tracks >= 0])))
    own = np.nonzero(tracks == place)[0]
    steps = np.linalg.norm(np.diff(clouds.xyz[own], axis=0), axis=1).sum()
    seconds = (clouds.frame_of[own[-1]] - clouds.frame_of[own[0]]) / clouds.rate
    assert got[place]["speed"] == pytest.approx(steps / seconds, rel=1e-3)
    distances = [metres for _, metres in got[place]["near"]]
    assert len(distances) == 3 and distances == sorted(distances) and 0 < distances[0] < 1
    names = [name for name, _ in got[place]["near"]]
    assert review.marker[place] < 0 or review.names[review.marker[place]] not in names


@needs_node
def test_incomplete_points_and_pieces_that_do_not_fit_are_refused(review: FakeReview, tmp_path: Path) -> None:
    got = shown(
        review,
        """const said = work => { try { work(); return ""; } catch (problem) { return problem.message; } };
        return [said(() => Asterism.readPoints(Uint8Array.from(bytes.slice(0, -4)).buffer)),
          said(() => Asterism.readPoints(new ArrayBuffer(3))),
          said(() => labels.apply(state, Uint32Array.from(tracks, k => k + 1)))];""",
        tmp_path,
    )
    assert got == ["The points of the recording came incomplete."] * 2 + ["The pieces of the recording do not fit its state."]


@needs_node
def test_the_list_goes_on_where_a_mended_item_was(review: FakeReview, tmp_path: Path) -> None:
    """From an item to the one after it; from a piece that is no item any more, to what stands in its place."""
    got = shown(
        review,
        """const ids = state.items.map(item => item.piece);
        const out = [labels.nextItem(ids[2], 0, 1), labels.nextItem(ids[2], 0, -1), labels.nextItem(-5, 3, 1), labels.nextItem(-5, 3, -1),
          labels.nextItem(ids[0], 0, -1), labels.nextItem(ids[ids.length - 1], 0, 1) - ids.length];
        state.items.length = 0;
        return [...out, labels.nextItem(5, 3, 1)];""",
        tmp_path,
    )
    assert got == [3, 1, 3, 2, 0, -1, -1]


@needs_node
def test_what_is_typed_finds_names_by_their_beginning_then_by_their_middle(tmp_path: Path) -> None:
    names = [["RKNE", 0.5], ["LKNE", 0.3], ["KNEE_L", 0.1], ["L.Thigh", 0.05], ["膝", None]]
    got = in_node(
        "return ['', 'kne', 'l k', 'lthi', '膝', 'zzz'].map(typed => Asterism.matching(names, typed).map(([name]) => name))",
        tmp_path,
        scripts=script("labels.js"),
        names=names,
    )
    assert got == [[name for name, _ in names], ["KNEE_L", "RKNE", "LKNE"], ["LKNE"], ["L.Thigh"], ["膝"], []]


@needs_node
def test_a_lost_connection_is_said_and_what_was_sent_is_sent_again(tmp_path: Path) -> None:
    """Two failures, then an answer: one answer, waits that grow, and each in its turn; what the server refuses is not sent again."""
    got = in_node(
        """const waits = [], said = [], sent = [];
        const fail = () => { throw new TypeError("network"); };
        const answers = [fail, fail, () => ({ ok: true, json: async () => ({ revision: 2 }) }),
          () => ({ ok: false, status: 409, json: async () => ({ error: "changed in another window" }) }),
          fail, () => ({ ok: false, status: 409, json: async () => ({ error: "again" }) })];
        const connection = new Asterism.Connection("secret", { status: s => said.push(s), wait: async ms => { waits.push(ms); },
          fetch: async (path, options) => {
            sent.push([path, options.headers["X-Asterism-Token"], options.body || null]);
            return answers.shift()();
          } });
        const tell = problem => [problem.status, problem.message, problem.again];
        const results = await Promise.all([
          connection.inTurn(() => connection.ask("/a", { body: { revision: 1 } })),
          connection.inTurn(() => connection.ask("/b", { body: { revision: 2 } })).catch(tell),
          connection.inTurn(() => connection.ask("/c", { body: {} })).catch(tell)]);
        return { waits, said, results, sent };""",
        tmp_path,
        scripts=script("connection.js"),
    )
    assert got["results"] == [{"revision": 2}, [409, "changed in another window", False], [409, "again", True]]
    assert got["said"] == ["lost", "back", "lost", "back"] and got["waits"][0] < got["waits"][1] and len(got["waits"]) == 3
    assert [path for path, _, _ in got["sent"]] == ["/a", "/a", "/a", "/b", "/c", "/c"]
    assert {token for _, token, _ in got["sent"]} == {"secret"} and got["sent"][0][2] == '{"revision":1}'


@needs_chromium
def test_the_page_opens_with_its_list_and_hostile_names_as_text(review: FakeReview, tmp_path: Path) -> None:
    odd = ("<img src=x onerror=alert(1)>", "a\u202eb", *review.names[2:])
    hostile = FakeReview(review.clouds, review.marker, review.confidence, odd, trial="</select><b>walk</b>.c3d")
    server = serve(hostile)
    try:
        seen = int((review.marker[review.clouds.tracks[review.clouds.frame_of == 0]] >= 0).sum())  # type: ignore[index]
        elements = opened(f"http://127.0.0.1:{server.server_port}/?token={TOKEN}", tmp_path, r"class=\"line current\"")
        items = hostile.state()["items"]
        assert f"To look at: {len(items)}" in elements and f"Look at {len(items)} pieces of tracks." in elements
        first = next(item for item in items)
        assert re.search(rf"frame {101 + first['frame']}, \d+ of 15 markers", elements) and seen > 0
        assert "<img" not in elements and "onerror" in elements and "\u202e" not in elements and "a\ufffdb" in elements
        assert "<b>walk</b>" not in elements and "&lt;b&gt;walk&lt;/b&gt;.c3d – look at" in elements
        assert "broken.c3d – failed" in elements
        assert "undefined" not in elements and "NaN" not in elements
    finally:
        server.shutdown()
        server.server_close()


DRIVER = """(async () => {
  const { page } = Asterism, at = id => document.getElementById(id);
  const until = met => new Promise(ok => { const timer = setInterval(() => { if (met()) { clearInterval(timer); ok(); } }, 20); });
  const press = key => document.activeElement.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true, cancelable: true }));
  const taken = revision => until(() => page.labels.state.revision === revision && !at("piece").hasAttribute("aria-busy"));
  await until(() => document.querySelector("#list .current"));
  press("g");
  await taken(2);
  press("Tab");
  press("n");
  document.activeElement.value = "l.kne";
  document.activeElement.dispatchEvent(new Event("input"));
  press("Enter");
  await taken(3);
  const before = page.player.frame;
  press("ArrowRight");
  press("ArrowRight");
  press("c");
  await taken(4);
  press("s");
  page.select(page.labels.state.items[0].piece);
  await taken(5);
  const { frame, canvas } = page.player;
  document.body.append(Asterism.make("p", { textContent: `driven ${frame - before} frames, ${document.activeElement === canvas}` }));
})();"""


@pytest.mark.slow
@needs_chromium
def test_keys_say_what_a_person_means(review: FakeReview, tmp_path: Path) -> None:
    """A ghost, a name typed in part, a cut two frames on, a swap with the list's first; the focus returns to the picture."""
    asked = FakeReview(review.clouds, review.marker, review.confidence, review.names)
    first, second = (item["piece"] for item in asked.state()["items"][:2])
    frame = asked.state()["items"][1]["frame"]
    server = serve(asked, DRIVER)
    try:
        opened(f"http://127.0.0.1:{server.server_port}/?token={TOKEN}", tmp_path, "driven 2 frames, true")
    finally:
        server.shutdown()
        server.server_close()
    ghost, name, cut, swap = (given["event"] for given in asked.asked[-4:])
    assert ghost == {"kind": "ghost", "piece": first} and name == {"kind": "name", "piece": second, "marker": "LKNE"}
    assert cut == {"kind": "cut", "piece": second, "frame": frame + 2}
    assert swap["kind"] == "swap" and swap["piece"] == second and swap["other"] not in (first, second)
    assert [given["revision"] for given in asked.asked[-4:]] == [1, 2, 3, 4]


RELABEL = """(async () => {
  const { page } = Asterism, at = id => document.getElementById(id), said = [];
  const until = met => new Promise(ok => { const timer = setInterval(() => { if (met()) { clearInterval(timer); ok(); } }, 20); });
  await until(() => document.querySelector("#list .current"));
  // what is said is gone after a while
  const say = page.messages.say.bind(page.messages);
  page.messages.say = (sentence, ...more) => { said.push(sentence); return say(sentence, ...more); };
  page.models = ["gait.model", "gait-2.model"];
  at("relabel").click();
  at("relabel-form").querySelector("button[value=relabel]").click();
  await until(() => !at("relabelling").hidden && at("relabelling").textContent);
  said.push(at("relabelling").textContent.trim());
  await until(() => at("relabelling").hidden && page.labels.state.revision === 2 && at("changes").textContent.includes("Labelled again"));
  at("changes").querySelector("li .small").click();
  await until(() => page.labels.state.revision === 3);
  document.body.append(Asterism.make("p", { textContent: `driven ${said} driven` }));
})();"""


@needs_chromium
def test_a_recording_is_labelled_again_and_a_change_is_refused(review: FakeReview, tmp_path: Path) -> None:
    asked = FakeReview(review.clouds, review.marker, review.confidence, review.names)
    server = serve(asked, RELABEL)
    try:
        elements = opened(f"http://127.0.0.1:{server.server_port}/?token={TOKEN}", tmp_path, "driven .* driven")
    finally:
        server.shutdown()
        server.server_close()
    assert "walk.c3d is being labelled again with gait.model" in elements and "1 recording labelled again: 1 sample changed." in elements
    begun, refused = asked.asked
    assert begun == {"trials": ["t1"], "model": 1} and refused == {"revision": 2, "pieces": [100 + asked.changed]}


@pytest.mark.slow
@needs_chromium
def test_a_wrong_token_is_said(review: FakeReview, tmp_path: Path) -> None:
    server = serve(review)
    try:
        elements = opened(f"http://127.0.0.1:{server.server_port}/?token=old", tmp_path, "of an earlier run")
        assert "To look at:" not in elements
    finally:
        server.shutdown()
        server.server_close()
