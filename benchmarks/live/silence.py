"""A tone that sounds in the page, and what ends it: how long it is still heard."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import asterism
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure
from tests.browser import CHROMIUM, Tab

RULE = '[[rule]]\nheight = "LHEE"\nsound = "tone"\nlow = 0.0\nhigh = 0.3\n'
AUDIBLE = 1e-4
"""Of the full scale: -80 dB, a fiftieth of the quietest tone of the row. At half and double the last 20 ms differ by a tenth."""
_METER = """(() => {
  const { context, gain } = Asterism.live.sounds, meter = context.createAnalyser(), samples = new Float32Array(256);
  meter.fftSize = 256;
  gain.connect(meter);
  globalThis.isLoud = () => { meter.getFloatTimeDomainData(samples); return samples.some(value => Math.abs(value) > AUDIBLE); };
  setInterval(() => { if (isLoud()) globalThis.heard = performance.timeOrigin + performance.now(); }, 5);
})()"""


def silence(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """A tone over a walk: the sound switched off, the session that hangs, ends, is killed; from each to the last sample that is heard."""
    if CHROMIUM is None:
        benchmark.report("Chromium is not installed.")
        return
    times: dict[str, list[float]] = {}
    count = 1 if benchmark.quick else 10
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        asterism.write(folder / "walk.c3d", asterism.simulation.simulate_walks(1, frames=1500, seed=1)[0])
        (folder / "tone.toml").write_text(RULE)
        for _ in range(count):
            for last, name in ((signal.SIGINT, "session ends"), (signal.SIGKILL, "session killed")):
                with _sounding(folder) as (tab, session):
                    switch, send = partial(tab.value, "document.getElementById('sound').click()"), partial(os.kill, session.pid)
                    times.setdefault("sound switched off", []).append(_heard(tab, switch))
                    switch()
                    tab.wait("isLoud()")
                    times.setdefault("session hangs", []).append(_heard(tab, partial(send, signal.SIGSTOP)))
                    send(signal.SIGCONT)
                    tab.wait("isLoud()")
                    times.setdefault(name, []).append(_heard(tab, partial(send, last)))
    for name, each in times.items():
        yield Figure(f"live page, a tone is heard after: {name}, longest", "< 0.6", max(each), "s", len(each))


@contextmanager
def _sounding(folder: Path) -> Iterator[tuple[Tab, subprocess.Popen[str]]]:
    """A page in which a tone sounds, and the process of its session."""
    words = [sys.executable, "-u", "-m", "asterism.cli", "live", "--replay", str(folder / "walk.c3d"), "--loop", "--markers", "helen-hayes"]
    words += ["--no-analysis", "--page", "--feedback", str(folder / "tone.toml")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as session:
        assert session.stdout is not None
        address = next(found[0] for line in session.stdout if (found := re.search(r"http://\S+", line)))
        try:
            with Tab(address) as tab:
                tab.wait("Asterism.live && Asterism.live.clock.isKnown && Asterism.live.rules.length")
                tab.value("document.getElementById('sound').click()")
                tab.wait("Asterism.live.sounds.context.state === 'running'")
                tab.value(_METER.replace("AUDIBLE", str(AUDIBLE)))
                tab.wait("isLoud()")
                yield tab, session
        finally:
            session.kill()


def _heard(tab: Tab, end: Callable[[], object]) -> float:
    """s from what ends a sound to its last sample."""
    begin = time.time()
    end()
    time.sleep(1.5)
    return max(0.0, float(tab.value("isLoud() ? Infinity : heard / 1000") or float("inf")) - begin)
