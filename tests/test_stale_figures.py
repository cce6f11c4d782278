"""Kept figures know what measured them: which changes of sources or recordings make a row stale, and that a stale row is never reached."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest

from asterism.errors import AsterismError

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
benchmark_data, docs, figures, main, read_values, runs, schedule, sources, stale = (
    import_module(f"benchmarks.{name}")
    for name in ("data", "docs", "figures", "__main__", "read_values", "runs", "schedule", "sources", "stale")
)

FILES = {
    "src/asterism/__init__.py": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from asterism.heart import label\n",
    "src/asterism/heart/__init__.py": "from asterism.heart.frames import label\nfrom asterism.heart.pages import show\n",
    "src/asterism/heart/frames.py": (
        '"""Labels frames."""\n'
        'def label(cloud):\n    """Text."""\n    from asterism.heart.search import best  # late\n    return best(cloud)\n'
    ),
    "src/asterism/heart/search.py": "LIMIT = 1\n\n\ndef best(cloud):\n    return cloud[:LIMIT]\n",
    "src/asterism/heart/pages.py": "def show(page):\n    return page\n",
    "benchmarks/__main__.py": "from benchmarks import chapter\nCHAPTERS = {'chapter': chapter}\n",
    "benchmarks/chapter/__init__.py": (
        "from benchmarks.chapter.walks import pages, walks\nROWS: dict[str, object] = {'walks': walks, 'pages': pages}\n"
    ),
    "benchmarks/chapter/walks.py": (
        "import asterism\nfrom asterism.heart import show\nfrom benchmarks.run import Run\nfrom benchmarks.data import gait\nMOST = 3\n"
        "def walks(benchmark: Run):\n    benchmark.tell('walks')\n    return [asterism.label(walk) for walk in gait()[:MOST]]\n"
        "def pages(benchmark: Run):\n    return [show(page) for page in benchmark.each([1])]\n"
    ),
    "benchmarks/run.py": (
        "from asterism.heart.frames import label\nclass Run:\n    def tell(self, text):\n        print(text)\n"
        "    def each(self, items):\n        return items\n    def train(self):\n        return label\n"
    ),
    "benchmarks/data.py": (
        "from pathlib import Path\nfrom asterism.formats import read\ndef folder():\n    return Path('.')\n"
        "def gait():\n    return [read(path) for path in (folder() / 'gait' / 'walks').iterdir()]\n"
    ),
    "src/asterism/errors.py": "class AsterismError(Exception):\n    pass\n",
    "src/asterism/formats/__init__.py": "from asterism.formats.table import read\n",
    "src/asterism/formats/table.py": (
        "from asterism.formats.text import number\nfrom asterism.recording.marker_set import MarkerSet\n"
        "def read(path):\n    return MarkerSet.load(number(path))\n"
    ),
    "src/asterism/formats/text.py": (
        "from asterism.errors import AsterismError\ndef number(text):\n    if not text:\n        raise AsterismError('no number')\n"
        "    return float(text)\n"
    ),
    "src/asterism/recording/marker_set.py": (
        "class MarkerSet:\n    @classmethod\n    def load(cls, path):\n        return cls(path)\n    def names(self):\n        return 1\n"
    ),
}
HELD = {"gait": sources.Folder("names", "values")}
WALKS, PAGES = ("chapter", "walks"), ("chapter", "pages")


def _sources(**changed: str) -> sources.Sources:
    """The small repository, with the text of some files changed; a file's key has `_` for `/`."""
    files = {path: text for path, text in FILES.items()}
    for key, text in changed.items():
        (path,) = (path for path in FILES if path.endswith(key.replace("__", "/") + ".py"))
        files[path] = text
    return sources.Sources({path: text.encode() for path, text in files.items()})


def _hashes(of: sources.Sources, held: dict[str, sources.Folder] = HELD) -> tuple[str, str]:
    return tuple(sources.hash_of(of, *row, held) for row in (WALKS, PAGES))


def test_a_row_measures_the_modules_it_reaches_by_whatever_way_and_no_others() -> None:
    found = _sources().measured_by(*WALKS)
    assert {name for name in found if name.startswith("asterism")} == {"asterism.heart.frames", "asterism.heart.search"}
    assert {name for name in found if name.startswith("benchmarks")} == {
        *("benchmarks.chapter.walks", "benchmarks.chapter.walks.walks", "benchmarks.chapter.walks.MOST"),
        *("benchmarks.data", "benchmarks.data.folder", "benchmarks.data.gait", "benchmarks.run", "benchmarks.run.Run.tell"),
    }
    assert _sources().recordings_of(*WALKS) == {"gait/walks"}
    assert {name for name in _sources().measured_by(*PAGES) if name.startswith("asterism")} == {"asterism.heart.pages"}
    assert _sources().recordings_of(*PAGES) == set()


@pytest.mark.parametrize(
    ("file", "old", "new", "walks_stale", "pages_stale"),
    [
        ("heart__search", "LIMIT = 1", "LIMIT = 2", True, False),
        ("heart__search", "def best", "# which is best\ndef best", False, False),
        ("heart__frames", '"""Text."""', '"""Another text."""', False, False),
        ("heart__frames", "return best(cloud)", "return best(cloud[1:])", True, False),
        ("heart__pages", "return page", "return [page]", False, True),
        ("chapter__walks", "MOST = 3", "MOST = 4", True, False),
        ("chapter__walks", "show(page)", "show(page + 1)", False, True),
        ("benchmarks__run", "return items", "return items[1:]", False, True),
        ("benchmarks__run", "return label", "return label, label", False, False),
    ],
)
def test_a_change_makes_stale_what_it_can_move(file: str, old: str, new: str, walks_stale: bool, pages_stale: bool) -> None:
    before, after = _hashes(_sources()), _hashes(_sources(**_changed(file, old, new)))
    assert (before[0] != after[0], before[1] != after[1]) == (walks_stale, pages_stale)


def _changed(file: str, old: str, new: str) -> dict[str, str]:
    (text,) = (text for path, text in FILES.items() if path.endswith(file.replace("__", "/") + ".py"))
    assert old in text
    return {file: text.replace(old, new)}


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("errors", "pass", "sentence = ''"),
        ("formats__text", "'no number'", "'no number; give one'"),
        ("formats__text", "float(text)", "float(text) + 1"),
        ("formats__table", "number(path)", "number(path[1:])"),
        ("recording__marker_set", "cls(path)", "cls(path, 1)"),
    ],
)
def test_a_change_of_a_reader_makes_only_rows_about_files_stale(monkeypatch: pytest.MonkeyPatch, file: str, old: str, new: str) -> None:
    changed = _sources(**_changed(file, old, new))
    assert _hashes(_sources()) == _hashes(changed)
    assert _sources().hash_of_readers() != changed.hash_of_readers(), "so that the recordings are read again"
    monkeypatch.setattr(sources, "ABOUT_FILES", {WALKS})
    before, after = _hashes(_sources()), _hashes(changed)
    assert before[0] != after[0] and before[1] == after[1]


def test_what_a_reader_shares_with_other_code_counts() -> None:
    changed = _sources(**_changed("recording__marker_set", "return 1", "return 2"))
    search = FILES["src/asterism/heart/search.py"]
    plain = _sources(heart__search=f"from asterism.recording.marker_set import MarkerSet\n{search}")
    both = _sources(
        heart__search=f"from asterism.recording.marker_set import MarkerSet\n{search}",
        recording__marker_set=FILES["src/asterism/recording/marker_set.py"].replace("return 1", "return 2"),
    )
    assert _hashes(_sources()) == _hashes(changed), "only readers import it"
    assert _hashes(plain)[0] != _hashes(both)[0], "another module imports it too"


def test_other_recordings_make_a_row_stale_that_reads_them() -> None:
    before = _hashes(_sources())
    assert _hashes(_sources(), {**HELD, "movement": sources.Folder("others", "others")}) == before
    for other in (sources.Folder("names", "other values"), sources.Folder("other names", "values")):
        for folder in ("gait", "gait/walks", "gait/walks/deeper"):
            after = _hashes(_sources(), {folder: other})
            assert after[0] != before[0] and after[1] == before[1]


def test_values_that_were_read_are_kept_until_files_or_readers_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(read_values, "KEPT", tmp_path / "read.json")
    data = tmp_path / "data"
    for folder in ("gait/walks", "cameras/one", "cameras/two"):
        (data / folder).mkdir(parents=True)
        (data / folder / "walk.csv").write_text("time,A_x,A_y,A_z,B_x,B_y,B_z\n" + "".join(f"{i / 100},1,2,{i},4,5,6\n" for i in range(20)))
    read: list[str] = []

    def held(of: sources.Sources, where: Path | None = data) -> dict[str, sources.Folder]:
        read.clear()
        return read_values.contents(of, where, lambda share, what: read.append(what))

    first = held(_sources())
    assert list(first) == ["cameras/one", "cameras/two", "gait"] == read[:-1]
    assert held(_sources()) == first and read == []
    (data / "cameras" / "two" / "walk.csv").write_text("damaged")
    second = held(_sources())
    assert read[:-1] == ["cameras/two"] and second["cameras/two"].values != first["cameras/two"].values
    assert second["gait"] == first["gait"]
    mended = held(_sources(**_changed("formats__text", "'no number'", "'no number; give one'")))
    assert len(read) == 4 and mended == second, "other readers that give the same values"
    assert held(_sources(), None) == second and read == [], "without recordings the kept ones are taken"


def test_values_differ_by_a_bit_and_not_by_what_is_said_of_a_file(tmp_path: Path) -> None:
    def values(last: str, note: str = "") -> str:
        header = f"{note}time,A_x,A_y,A_z,B_x,B_y,B_z\n"
        (tmp_path / "gait").mkdir(exist_ok=True)
        (tmp_path / "gait" / "walk.csv").write_text(header + "".join(f"{i / 100},1,2,{i},4,5,{last}\n" for i in range(20)))
        return read_values.values_of(tmp_path, "gait")

    assert values("6") == values("6.0") != values("6.000000000000001") != values("")
    assert values("6") == values("6.0 ")


def test_kept_values_are_those_of_the_recordings(data: Path) -> None:
    kept = read_values.load()
    assert set(kept) == set(read_values._folders(data))
    for folder, own in kept.items():
        assert own.index == sources.index_of(data, [folder]), folder
    for folder in ("cameras/easywand", "cameras/qualisys", "cameras/chessboard-stereo"):
        assert kept[folder].values == read_values.values_of(data, folder), f"{folder}: run `python -m benchmarks stale`"


def test_readers_are_there() -> None:
    of = sources.Sources.working()
    for reader in sources.READERS:
        assert any(sources._belongs(module, reader) for module in of.paths), reader
    for module, functions in sources.READING_FUNCTIONS.items():
        for function in functions:
            assert function in of.module(module).bound, f"{module}.{function}"
    for chapter, row in sources.ABOUT_FILES:
        assert (chapter, row) in of.rows()


def _entry(row: str, command: str, sources: str, asked: str = "none", measured: float = 0.0) -> figures.Entry:
    return figures.Entry(
        "issue", row, asked, measured, "fraction", 7, command, "2026-01-01", sources=sources, commit="" if sources else "x"
    )


def test_stale_are_rows_of_other_sources_rows_never_measured_and_figures_of_no_row() -> None:
    of, current = _sources(), _hashes(_sources())[0]
    commands = [stale.command_of(*row) for row in (WALKS, PAGES, ("chapter", "gone"))]
    entries = [_entry("a", commands[0], current), _entry("b", commands[0], current), _entry("c", commands[2], current)]
    found = stale.stale_rows(entries, of, HELD, explain=False)
    assert [(row.row, row.figures) for row in found] == [("pages", 0), ("gone", 1)]
    entries[1] = _entry("b", commands[0], "other")
    found = stale.stale_rows(entries, of, HELD, explain=False)
    assert [(row.row, row.figures) for row in found] == [("walks", 2), ("pages", 0), ("gone", 1)]
    told = stale.report(found, {WALKS: runs.Run(*WALKS, 90.0, 150.0, 2, "", "other", "2026-01-01")})
    assert "python -m benchmarks chapter --rows walks    (90 s with 2 jobs)" in told
    assert "chapter pages: never measured" in told and "3 figures of 2 rows are stale, 1 rows were never measured; 2 min" in told
    assert stale.report([], {}) == "No figure is stale."


def test_what_has_changed_since_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    now = _sources(heart__search=FILES["src/asterism/heart/search.py"].replace("LIMIT = 1", "LIMIT = 2"))
    monkeypatch.setattr(sources.Sources, "at", classmethod(lambda cls, commit: _sources()))
    entry = replace(_entry("a", stale.command_of(*WALKS), "old"), commit="1234567+")
    (walks, _) = stale.stale_rows([entry], now, HELD)
    assert walks.changed == ("asterism.heart.search",)
    assert stale.stale_rows([entry], _sources(), HELD)[0].changed == ("the recordings, or what is read of them",)
    assert str(walks) == "chapter walks: 1 figures by 1234567+; changed since: asterism.heart.search"


def test_the_sources_of_a_commit_are_those_that_git_keeps(tmp_path: Path) -> None:
    def git(*words: str) -> str:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        return subprocess.run(["git", *who, "-C", str(tmp_path), *words], check=True, capture_output=True, text=True).stdout.strip()

    git("init", "-q")
    for path, text in FILES.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    git("add", ".")
    git("commit", "-q", "-m", "as it was")
    first = sources.commit(tmp_path)
    assert first == git("rev-parse", "--short=12", "HEAD")
    (tmp_path / "src/asterism/heart/search.py").write_text("LIMIT = 2\n")
    assert sources.commit(tmp_path) == f"{first}+"
    kept, changed = sources.Sources.at(first, tmp_path), sources.Sources.working(tmp_path)
    assert _hashes(kept) == _hashes(_sources()) != _hashes(changed)
    assert sources.Sources.at("f" * 40, tmp_path) is None


def test_a_stale_row_counts_as_neither_reached_nor_missed() -> None:
    rows = [
        _entry("gaps, 3 hidden, whole recording: right", "old", "", ">= 0.9", 0.99),
        _entry("gaps, 3 hidden, whole recording: FA", "new", "h", "<= 0.1", 0.01),
        _entry("b", "old", "", ">= 0.9", 0.5),
        _entry("c", "new", "h", ">= 0.9", 0.5),
    ]
    page = docs.text(rows, {"old"})
    assert "1 of 2 figures asked for are reached" in page
    assert "| 3 hidden | 99 % (asked >= 90 %, stale) | 1 % (asked <= 10 %) |" in page
    assert "| b | >= 90 % | 50 % | stale | 7 |" in page and "| c | >= 90 % | 50 % | **no** | 7 |" in page
    assert "**99 %" not in page and page.count("| b |") == 1, "stale rows do not stand under those not reached"
    assert docs.stale_in(page) == [] and "- `old`, 2 figures" in page
    gone, never = "python -m benchmarks chapter --rows gone", "python -m benchmarks chapter --rows new"
    page = docs.text([replace(row, command=gone) for row in rows], {gone}, never=[never])
    assert (docs.stale_in(page), docs.never_in(page)) == ([gone], [never])
    readme = docs._RESULTS_BEGIN + docs._RESULTS_END
    rows += [_entry(f"gaps, 3 hidden, key poses: {what}", "new", "h", measured=0.5) for what in ("right", "FA")]
    assert "| 3 | 99.00 % (stale) | 1.00 % | 50.00 % | 50.00 % |" in docs.with_results(readme, rows, {"old"})
    assert "stale" not in docs.with_results(readme, rows)


def test_few_wrong_labels_are_no_merit_where_hardly_any_were_given() -> None:
    rows = [
        _entry("a: FA", "run", "h", "<= 0.1", 0.0),
        _entry("a: missed", "run", "h", measured=1.0),
        _entry("b: FA", "run", "h", "<= 0.1", 0.0),
        _entry("b: missed", "run", "h", measured=0.2),
        _entry("c: wrong", "run", "h", "<= 0.1", 0.01),
        _entry("c: right", "run", "h", measured=0.3),
        _entry("d: FA", "run", "h", "<= 0.1", 0.01),
        _entry("d: missed", "run", "h", measured=0.01),
        _entry("e: FA", "run", "h", "<= 0.1", 0.0),
    ]
    verdicts = {one.entry.row: (one.reached, one.unlabelled) for one in figures.judged(rows)}
    assert verdicts["a: FA"] == (False, 100.0) and verdicts["b: FA"] == (True, 20.0)
    assert verdicts["c: wrong"] == (False, pytest.approx(100 * (1 - 0.3 / 0.99)))
    assert verdicts["d: FA"] == verdicts["e: FA"] == (True, None)
    page = docs.text(rows)
    assert "| a: FA | <= 10 % | 0 % | **no**, 100 % without a label |" in page
    assert "| b: FA | <= 10 % | 0 % | yes, 20 % without a label |" in page


def test_draws_and_own_bounds_are_said() -> None:
    with pytest.raises(ValueError, match="fewer draws"):
        figures.Figure("a", "none", 1.0, "s", 10, draws=5)
    page = docs.text([replace(_entry("a", "run", "h", "<= 0.1", 0.05), draws=21, ours=True)])
    assert "| a | <= 10 % (ours) | 5 % | yes | 7, 21 draws |" in page


@pytest.fixture
def chapter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, list[str]]]:
    """Two rows that count their calls, in place of all chapters, with files of their own; the second fails while `broken` is filled."""
    calls: dict[str, list[str]] = {"measured": [], "broken": []}

    def row(name: str, benchmark: object) -> Iterator[figures.Figure]:
        calls["measured"].append(name)
        yield figures.Figure(f"{name}, first", "none", 1.0, "s", 1)
        if calls["broken"] and name == "two":
            raise AsterismError("stopped.")
        yield figures.Figure(f"{name}, second", "none", 2.0, "s", 1)

    rows = {name: lambda benchmark, name=name: row(name, benchmark) for name in ("one", "two")}
    monkeypatch.setattr(main, "CHAPTERS", {"labelling": SimpleNamespace(ISSUE="issue", ROWS=rows)})
    monkeypatch.setattr(main, "folder", lambda: tmp_path)
    monkeypatch.setattr(main, "commit", lambda: "")
    monkeypatch.setattr(main, "Sources", SimpleNamespace(working=lambda: None))
    monkeypatch.setattr(main.read_values, "contents", lambda *given: HELD)
    monkeypatch.setattr(main, "hash_of", lambda of, chapter, row, folder: calls.get("hash", ["now"])[0])
    monkeypatch.setattr(main.docs, "write", lambda rows: None)
    monkeypatch.setattr(main.stale, "stale_rows", lambda *given, **options: [])
    for module, name in ((figures, "FIGURES"), (runs, "RUNS")):
        monkeypatch.setattr(module, name, tmp_path / f"{name}.json")
    yield calls


def test_a_run_that_was_stopped_goes_on_with_what_is_not_yet_measured(chapter: dict[str, list[str]]) -> None:
    chapter["broken"].append("yes")
    assert main.main(["labelling", "--jobs", "1"]) == 1
    assert [entry.row for entry in figures.load()] == ["one, first", "one, second", "two, first"], "figures are kept as they come"
    chapter["broken"].clear()
    assert main.main(["labelling", "--jobs", "1"]) == 0
    assert chapter["measured"] == ["one", "two", "two"]
    assert main.main(["labelling", "--jobs", "1"]) == 0 and chapter["measured"] == ["one", "two", "two"]
    assert main.main(["labelling", "--rows", "one"]) == 0 and chapter["measured"][3:] == ["one"]
    assert main.main(["labelling", "--again", "--jobs", "1"]) == 0 and chapter["measured"][4:] == ["one", "two"]
    chapter["hash"] = ["changed"]
    assert main.main(["labelling", "--jobs", "1"]) == 0 and chapter["measured"][6:] == ["one", "two"]
    assert {entry.sources for entry in figures.load()} == {"changed"}


def test_a_row_that_does_not_measure_a_figure_any_more_forgets_it(chapter: dict[str, list[str]]) -> None:
    command = stale.command_of("labelling", "one")
    figures.record("issue", [figures.Figure("one, third", "none", 3.0, "s", 1)], command)
    figures.record("issue", [figures.Figure("of another row", "none", 3.0, "s", 1)], "another")
    main.main(["labelling", "--jobs", "1"])
    rows = [entry.row for entry in figures.load()]
    assert "one, third" not in rows and "of another row" in rows


def test_no_row_is_begun_that_took_longer_than_is_left(chapter: dict[str, list[str]]) -> None:
    runs.record(runs.Run("labelling", "one", 120.0, 200.0, 2, "", "before", "2026-01-01"))
    assert main.main(["labelling", "--minutes", "1", "--jobs", "1"]) == 1
    assert chapter["measured"] == ["two"]


def _where_it_ran(row: tuple[str, str]) -> object:
    """A row that measures the number of its process."""
    return schedule.Measured((figures.Figure(f"process of {row[1]}", "none", os.getpid(), "pid", 1),), float(row[1]), 0.0)


def test_rows_side_by_side_begin_with_the_longest_each_in_a_process_of_its_own() -> None:
    rows = [("views", seconds) for seconds in ("1", "9", "2")]
    last = {row: runs.Run(*row, 1.0, float(row[1]), 1, "", "", "2026-01-01") for row in rows}
    begun: list[tuple[str, str]] = []
    done = list(schedule.side_by_side([*rows, ("views", "0")], _where_it_ran, 2, lambda row: begun.append(row) or row[1] != "2", last))
    assert begun == [("views", "0"), ("views", "9"), ("views", "2"), ("views", "1")], "an unknown row may be the longest"
    assert sorted(row[1] for row, _ in done) == ["0", "1", "9"]
    processes = {measured.figures[0].measured for _, measured in done}
    assert len(processes) == 3 and os.getpid() not in processes


def test_a_row_that_fails_tells_its_problem_and_what_came_before_it() -> None:
    def row(benchmark: object) -> Iterator[figures.Figure]:
        yield figures.Figure("first", "none", 1.0, "s", 1)
        raise AsterismError("no recordings.")

    measured = schedule.measured(row, None)
    assert [figure.row for figure in measured.figures] == ["first"] and measured.problem == "no recordings."


def test_the_expected_time_adds_rows_measured_alone_and_shares_the_others() -> None:
    def run(chapter: str, row: str, seconds: float, cpu: float) -> object:
        return runs.Run(chapter, row, seconds, cpu, 2, "", "", "2026-01-01")

    assert not schedule.may_have_company(("views", "parts")) and schedule.may_have_company(("views", "basin"))
    both = [run("views", "parts", 10.0, 15.0), run("views", "basin", 40.0, 60.0), run("views", "gait-views", 30.0, 40.0)]
    assert schedule.expected_seconds(both, 2) == 10.0 + 60.0, "no row is shared out"
    assert schedule.expected_seconds([*both, run("dirt", "riding", 5.0, 40.0)], 2) == 10.0 + 70.0
    assert schedule.expected_seconds([], 2) == 0.0


def test_rows_measured_alone_are_rows() -> None:
    assert all(set(rows) <= set(main.CHAPTERS[chapter].ROWS) for chapter, rows in schedule.ALONE.items())


def test_every_row_of_the_benchmark_can_be_followed_to_what_it_measures(data: Path) -> None:
    of = sources.Sources.working()
    assert set(of.rows()) == {(name, row) for name, chapter in main.CHAPTERS.items() for row in chapter.ROWS}
    tables, stereo = of.measured_by("labelling", "tables"), of.measured_by("cameras", "stereo")
    assert {"asterism.labelling.partial.matrix", "src/asterism/marker_sets/helen-hayes.toml"} <= set(tables)
    assert not any(name.startswith("asterism.labelling") for name in stereo)
    assert of.recordings_of("cameras", "stereo") == {"cameras/chessboard-stereo"} and of.recordings_of("labelling", "tables") == {"gait"}
    for row in of.rows():
        assert all((data / folder).exists() for folder in of.recordings_of(*row)), row
