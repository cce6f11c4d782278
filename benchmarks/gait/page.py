"""How large the gait page is, when a browser first draws it, and how evenly its player plays a minute; in Chromium without a window."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from statistics import median, quantiles
from tempfile import TemporaryDirectory

import asterism
from asterism.formats import force_plates
from asterism.gait import analyse_gait
from asterism.report.gait import gait_report
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.data import folder
from benchmarks.figures import Figure
from tests.browser import CHROMIUM, Tab

PAGES = {"six walks": ("gait-events/plates/NP100[1-4]/*.c3d", 6), "a minute on a treadmill": ("gait-events/treadmill/vanderzee10.c3d", 1)}
PAINT = "performance.getEntriesByName('first-contentful-paint').map(entry => entry.startTime)[0] || 0"
PLAY = """new Promise(done => { const player = Asterism.shownRecordings[0].player, gaps = []; let before = null, first = null;
  const tick = now => { if (before !== null) gaps.push(now - before); first ??= now; before = now;
    if (now - first < SECONDS * 1000) requestAnimationFrame(tick); else done(gaps); };
  player.toggle(1); requestAnimationFrame(tick); })"""


def page(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """Bytes; ms from the request to the first content; ms from picture to picture while it plays, 60 a second at best."""
    with TemporaryDirectory() as where:
        for name, (pattern, most) in PAGES.items():
            path = Path(where) / "page.html"
            recordings = [asterism.read(one) for one in sorted(folder().glob(pattern))[:most]]
            gait_report(path, [(f"walk {at}", analyse_gait(one, force_plates(one)[0])) for at, one in enumerate(recordings)])
            yield Figure(f"gait page, {name}: size", "< 3", path.stat().st_size / 1e6, "MB", len(recordings))
            if CHROMIUM is None:
                benchmark.report("Chromium is not installed.")
                continue
            paint, gaps = _seen(path, 5.0 if benchmark.quick else 60.0)
            yield Figure(f"gait page, {name}: first drawn", "< 1000", paint, "ms", 1)
            yield Figure(f"gait page, {name}: from picture to picture, median", "< 20", median(gaps), "ms", len(gaps))
            yield Figure(f"gait page, {name}: from picture to picture, 95 %", "none", quantiles(gaps, n=20)[-1], "ms", len(gaps))


def _seen(path: Path, seconds: float) -> tuple[float, list[float]]:
    """ms to the first content, and between pictures while the player plays."""
    with Tab(path.as_uri(), 1400, 1000) as tab:
        tab.wait("globalThis.Asterism?.shownRecordings?.[0]?.player ? 1 : 0")
        return float(tab.value(PAINT)), tab.value(PLAY.replace("SECONDS", str(seconds)))
