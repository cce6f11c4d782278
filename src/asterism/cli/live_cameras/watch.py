"""`asterism live cameras watch`: cameras in; how each of them does, each second, out."""

from __future__ import annotations

import dataclasses
import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import typer
from numpy.typing import NDArray

from asterism.cli import _console
from asterism.cli._command import takes
from asterism.cli._options import Json
from asterism.cli._printable import printable
from asterism.cli.live_cameras._which import Addresses, Cameras, cameras_of, opened_cameras, opening_findings
from asterism.errors import AsterismError
from asterism.findings import exit_status

if TYPE_CHECKING:
    from rich.table import Table

    from asterism.live.cameras import CameraHealth, LiveCamera, SettingValue

_EVERY = 1.0
"""s from one line of a camera to the next. Half of it cannot be read, with twice as much a hand before the lens is told late."""
_BLOBS_EVERY = 0.25
"""s from one image in which blobs are counted to the next: four webcams cost a tenth of a core.

Half of it costs twice as much; with twice as much a second has two counts.
"""


@dataclass(frozen=True)
class WatchCamerasOptions:
    """What `asterism live cameras watch` is asked to do."""

    cameras: Cameras = None
    addresses: Addresses = field(default_factory=lambda: [])
    no_blobs: Annotated[bool, typer.Option("--no-blobs", help="Count no blobs; else in four images a second.")] = False
    seconds: Annotated[float | None, typer.Option("--seconds", metavar="S", min=0.0, help="Stop after so long.", show_default=False)] = None
    lines: Annotated[bool, typer.Option("--lines", help="Print a line of JSON for each camera and second.")] = False
    json: Json = None


@takes(WatchCamerasOptions)
def watch(options: WatchCamerasOptions) -> None:
    """Watch cameras: rate, lost images, brightness, saturation, blobs, temperature and clock, each second.

    On a terminal a table; elsewhere a line for each camera and second. A camera that disappears is opened again and told. What should be
    looked at is said at the end. Stop with Ctrl-C.
    """
    from asterism.detection.running import compile_search
    from asterism.live.blobs.camera_clock import compile_fit
    from asterism.live.cameras import camera_findings

    if options.lines and options.json == "-":
        raise AsterismError("--lines and --json - both print to standard output; give --json a file.")
    _console.check_outputs([options.json], [options.cameras], overwrite=True)
    specs = cameras_of(options.cameras, options.addresses)
    if not options.no_blobs:
        compile_search()
    compile_fit()
    group = opened_cameras(specs, options.cameras)
    watched: list[_Watched] = []
    try:
        group.start()
        watched += [_Watched(camera, not options.no_blobs) for camera in group.cameras]
        until = math.inf if options.seconds is None else time.monotonic() + options.seconds
        with suppress(KeyboardInterrupt):
            _show(watched, until, _shown_by(options))
    finally:
        for one in watched:
            one.stop()
        for one in watched:
            one.thread.join()
        group.close()
    healths = [one.health for one in watched]
    findings = [*opening_findings(group), *camera_findings(healths, group.outcomes)]
    for finding in findings:
        _console.report(finding)
    content = {
        "command": "live cameras watch",
        "cameras": [dataclasses.asdict(health) for health in healths],
        "findings": [finding.to_dict() for finding in findings],
    }
    _console.write_json(options.json, content)
    raise typer.Exit(exit_status(findings))


class _Watched:
    """A camera that is read in a thread of its own."""

    def __init__(self, camera: LiveCamera, blobs: bool) -> None:
        from asterism.live.cameras import CameraWatch

        self.camera, self._blobs, self._watch = camera, blobs, CameraWatch(camera)
        self.health = self._watch.health()
        self.ended = False
        self._stop = threading.Event()
        self.thread = threading.Thread(target=self._run, name=f"watch {camera.name}", daemon=True)
        self.thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stop.set()

    def _run(self) -> None:
        from asterism.live import SourceEnded

        next_count, next_health = 0.0, 0.0
        try:
            while not self._stop.is_set():
                image, now = self.camera.read(0.1), time.monotonic()
                if image is not None:
                    self._watch.image(image)
                if image is not None and self._blobs and now >= next_count:
                    self._watch.blobs(_blobs_of(image.image, self.camera.get("threshold")))
                    next_count = now + _BLOBS_EVERY
                if now >= next_health:
                    self.health, next_health = self._watch.health(), now + _EVERY / 2
        except SourceEnded:
            self.health = self._watch.health()
        except Exception as problem:
            # One bad camera costs itself; it is told with its own words.
            self.health = dataclasses.replace(self._watch.health(), problem=_console.reason(problem))
        else:
            self.health = self._watch.health()
        self.ended = True


def _blobs_of(image: NDArray[Any], threshold: SettingValue | None) -> int:
    """The number of blobs of an image above a threshold, else the automatic one."""
    from asterism.detection import BlobSettings, find_blobs
    from asterism.detection.grey import grey_of_colour

    return len(find_blobs(grey_of_colour(image), BlobSettings(threshold=threshold if isinstance(threshold, float) else None)))


Shown = Callable[["list[CameraHealth]"], None]


def _show(watched: list[_Watched], until: float, shown: Shown) -> None:
    """Show how cameras do, each second, until it is late enough or all files have ended."""
    try:
        while time.monotonic() < until and not all(one.ended for one in watched):
            time.sleep(max(0.0, min(_EVERY, until - time.monotonic())))
            shown([one.health for one in watched])
    finally:
        shown([])


def _shown_by(options: WatchCamerasOptions) -> Shown:
    """What shows the state of cameras: a table on a terminal, else lines; nothing beside JSON."""
    if options.lines:
        return _as_json
    if options.json == "-":
        return lambda healths: None
    return _LiveTable() if sys.stdout.isatty() else _as_lines


def _as_lines(healths: list[CameraHealth]) -> None:
    for health in healths:
        cells = dict(zip(_COLUMNS, _cells(health), strict=True))
        told = [f"{cells[name]} {name}" for name in _COLUMNS[1:-1] if cells[name] != "–"]
        _console.result(f"{health.camera}: {', '.join(told)}{'; ' + health.problem if health.problem else ''}")


def _as_json(healths: list[CameraHealth]) -> None:
    import json

    from asterism.files.plain import as_json

    for health in healths:
        _console.result(json.dumps(as_json(dataclasses.asdict(health)), ensure_ascii=False, allow_nan=False))


_COLUMNS = ("camera", "images/s", "lost", "not fetched", "brightness", "% saturated", "blobs", "°C", "ppm", "s ago", "what is wrong")


def _cells(health: CameraHealth) -> tuple[str, ...]:
    def number(value: float, digits: int) -> str:
        return f"{value:.{digits}f}" if math.isfinite(value) else "–"

    return (
        health.camera,
        number(health.rate, 1),
        _console.count(health.lost),
        _console.count(health.dropped),
        number(health.brightness, 0),
        number(100 * health.saturated, 1),
        number(health.blobs, 1),
        number(health.temperature, 0),
        f"{health.drift:.0f} ± {health.drift_sd:.0f}" if math.isfinite(health.drift) else "–",
        number(health.last_seen, 1),
        health.problem,
    )


class _LiveTable:
    """A table on the terminal that is drawn anew each second."""

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(console=_console.console(), auto_refresh=False)
        self._begun = False
        self._told = set[int]()

    def __call__(self, healths: list[CameraHealth]) -> None:
        from rich.console import Group
        from rich.text import Text

        if not healths:
            self._live.stop()
            return
        if not self._begun:
            self._live.start()
            self._begun = True
        rows = [[printable(cell) for cell in _cells(health)[:-1]] for health in healths]
        # A column that has said something stays.
        self._told |= {place for row in rows for place, cell in enumerate(row) if place in _ALWAYS or cell not in _NOTHING}
        told = sorted(self._told)
        least = [[place for place in told if place not in _LEAST[:left_out]] for left_out in range(len(_LEAST) + 1)]
        forms = [(list(range(len(_COLUMNS) - 1)), False), (told, False), *((columns, True) for columns in least)]
        tables = [_table(rows, healths, columns, narrow=narrow) for columns, narrow in forms]
        # As much as there is room for, and words are never cut.
        console = self._live.console
        wide = console.options.update(max_width=_WIDE)
        table = next((each for each in tables if console.measure(each, options=wide).maximum <= console.width), tables[-1])
        wrong = [Text(printable(f"{health.camera}: {health.problem}"), style="bold red") for health in healths if health.problem]
        self._live.update(Group(table, *wrong), refresh=True)


_ALWAYS = (0, 1, 4, 6)
"""Columns that are shown whatever they say: camera, images a second, brightness, blobs."""
_LEAST = (9, 7, 8, 5, 3)
"""Columns that a terminal does without where it has no room, the first one first: s ago, temperature, clock, saturation, not fetched."""
_WIDE = 1000
"""Letters in which any table has room, so that it says how many it needs. Half and double do as well."""
_NOTHING = ("0", "0.0", "–")
"""What a column says that says nothing."""


def _table(rows: list[list[str]], healths: list[CameraHealth], columns: Sequence[int], *, narrow: bool) -> Table:
    """The columns of all cameras; narrow: with the words of a heading one below the other."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0) if narrow else (0, 1))
    for place in columns:
        heading = _COLUMNS[place].replace(" ", "\n") if narrow else _COLUMNS[place]
        table.add_column(heading, justify="left" if place == 0 else "right", no_wrap=True)
    for row, health in zip(rows, healths, strict=True):
        table.add_row(*(Text(row[place], style="bold red" if health.problem else "") for place in columns))
    return table
