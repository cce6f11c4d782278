"""The pages in a browser: how large the label page of a batch is, how soon the player draws, and how many frames per second it plays.

Chromium opens a page from a server of this process, without a graphics card, and sends back what the page measured: the time from its
navigation to its first picture, and the pictures drawn while it plays; beside them those of a page that only clears its canvas.
"""

from __future__ import annotations

import http.server
import json
import shutil
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from asterism.recording import Clouds, Labelling
from asterism.report import LabelledRecording, label_report, player_script, player_style
from asterism.report.page import plain
from asterism.report.player import RULES, ShownRecording, pack_recordings
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

FILES, FRAMES, MARKERS, GHOSTS = 13, 10_000, 60, 5
SECONDS = 5.0
LONGEST = 120.0
"""s that the browser has for all of it."""

_PAGE = """<!doctype html><meta charset="utf-8">
<style>:root { --line: #ccc; --ink: #000; --paper: #fff; --accent: #077; --soft: #555; } body { margin: 0; width: 1080px; } STYLE</style>
<div id="view"></div><div id="rows"></div>
<script type="application/json" id="data">DATA</script>
<script>SCRIPT</script>
<script>
const painted = () => new Promise(ok => requestAnimationFrame(() => requestAnimationFrame(ok)));
async function rate(seconds, draw) {
  let pictures = 0;
  const from = performance.now();
  await new Promise(ok => {
    const next = () => { draw(); pictures++; if (performance.now() - from < 1000 * seconds) requestAnimationFrame(next); else ok(); };
    requestAnimationFrame(next);
  });
  return 1000 * pictures / (performance.now() - from);
}
(async () => {
  const packed = JSON.parse(document.getElementById("data").textContent), recording = await Asterism.unpack(packed);
  const player = new Asterism.Player(document.getElementById("view"), recording, { names: "doubtful" });
  await painted();
  const first = performance.now(), codes = await Asterism.inflate(packed.timeline.data);
  const { block, columns, frames, labelled } = packed.timeline, rows = packed.markers.map((name, m) => ({ name, share: labelled[m] }));
  const timeline = new Asterism.Timeline(document.getElementById("rows"));
  timeline.set({ rows, codes, columns, block, frames });
  player.onFrame = frame => timeline.at(frame);
  let drawn = 0;
  const draw = player.drawNow.bind(player);
  player.drawNow = () => { drawn++; draw(); };
  player.start();
  const asked = await rate(SECONDS, () => {});
  player.pause();
  const context = player.canvas.getContext("2d");
  const cleared = await rate(SECONDS, () => context.fillRect(0, 0, 2000, 2000));
  await fetch("/measured", { method: "POST", body: JSON.stringify({ first, drawn: drawn / SECONDS, asked, cleared }) });
})();
</script>
"""


def pages(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The size needs no browser; without Chromium the others are left out, and that is said."""
    yield Figure(
        f"label page of {FILES} walks of 39 markers with gaps and ghosts: size", "<= 2.5", _page_of_a_batch(benchmark.quick), "MB", FILES
    )
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        benchmark.report("Chromium is not installed; the rows on drawing and playing are left out.")
        return
    measured = _in_browser(browser, _packed(FRAMES // 10 if benchmark.quick else FRAMES))
    what = f"{FRAMES:,} frames x {MARKERS} markers"
    yield Figure(f"{what}: first picture after the page is asked for", "<= 1000", measured["first"], "ms", FRAMES)
    yield Figure(f"{what}: pictures per second while it plays, headless", ">= 50", measured["drawn"], "1/s", int(SECONDS))
    yield Figure("a page that only clears its canvas, in the same run", "none", measured["cleared"], "1/s", int(SECONDS))


def _page_of_a_batch(quick: bool) -> float:
    """MB of the label page of thirteen walks."""
    shown = []
    for number, walk in enumerate(simulate_walks(FILES, frames=100 if quick else 400, markers="plug-in-gait", seed=1)):
        clouds, truth = simulate_gaps_and_ghosts(walk, 3, 2, seed=number)
        noisy = replace(clouds, xyz=clouds.xyz + np.random.default_rng(number).normal(0.0, 5e-4, clouds.xyz.shape))
        shown.append(LabelledRecording(Labelling(truth, np.where(truth >= 0, 0.995, 0.1), walk.labels), noisy))
    with tempfile.TemporaryDirectory() as made:
        page = Path(made) / "page.html"
        label_report(page, shown, title="walks", files=[{"file": f"walk{number}.c3d"} for number in range(FILES)])
        return page.stat().st_size / 1e6


def _packed(frames: int) -> dict[str, Any]:
    """A body of many markers that wanders about, a tenth of the labels missing for a second each, as the player takes it."""
    rng = np.random.default_rng(0)
    seconds = np.arange(frames) / 100.0
    path = np.stack([1.2 * seconds, 0.2 * np.sin(seconds), 0.02 * np.sin(6 * seconds)], axis=1)[:, None]
    swing = 0.1 * np.sin(6 * seconds[:, None, None] + rng.uniform(0, 6, (1, MARKERS, 3)))
    body = rng.normal(0, 0.35, (MARKERS, 3)) + np.array([0, 0, 1]) + path + swing + rng.normal(0, 5e-4, (frames, MARKERS, 3))
    every = np.concatenate([body, rng.normal(0, 1, (frames, GHOSTS, 3)) + path + np.array([0, 0, 1])], axis=1)
    count = MARKERS + GHOSTS
    columns = np.tile(np.arange(count), frames)
    clouds = Clouds(every.reshape(-1, 3), count * np.arange(frames + 1), 100.0, np.array([0.0, 0.0, 1.0]), columns)
    indices = np.tile(np.arange(MARKERS), (frames, 1))
    indices[np.repeat(rng.random((frames // 100, MARKERS)) < 0.1, 100, axis=0)] = -1
    confidence = np.broadcast_to(rng.uniform(0.8, 1.0, MARKERS), indices.shape)
    labelling = Labelling(indices, confidence, tuple(f"{'LR'[m % 2]}MK{m // 2:02d}" for m in range(MARKERS)))
    shown = ShownRecording("wanderer", labelling, clouds, unsure=indices < 0)
    return pack_recordings([shown], replace(RULES, bytes=10**9))[0]


def _in_browser(browser: str, packed: dict[str, Any]) -> dict[str, float]:
    """What the page measured. Raises RuntimeError where it did not answer in time."""
    page = _PAGE.replace("STYLE", player_style()).replace("SECONDS", str(SECONDS))
    page = page.replace("DATA", json.dumps(plain(packed))).replace("SCRIPT", player_script())
    answered, measured = threading.Event(), dict[str, float]()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(page.encode())

        def do_POST(self) -> None:
            measured.update(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            self.send_response(200)
            self.end_headers()
            answered.set()

        def log_message(self, *words: object) -> None:
            pass

    with (
        http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server,
        tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as made,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        words = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={made}", "--remote-debugging-port=0"]
        run = subprocess.Popen([*words, "--window-size=1200,1000", f"http://127.0.0.1:{server.server_port}/"], stderr=subprocess.DEVNULL)
        try:
            if not answered.wait(LONGEST):
                raise RuntimeError("the browser did not answer; open the page by hand to see why.")
        finally:
            run.terminate()
            run.wait()
            server.shutdown()
    return measured
