"""The release: a dirty tree is refused, what is stopped goes on, a script that fails costs its rows; the pages are what its file says."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))
chapters, docs, key, release = (import_module(f"benchmarks.{name}") for name in ("chapters", "docs", "key", "release"))


MISSED = key.README[0].rows[1][0]
"""The row that misses what is asked; the README shows it."""


def a_release(**changes: Any) -> dict[str, Any]:
    """A release whose figures all reach what is asked, but for one, and one that was not measured."""
    rows = [row for group in key.KEY for row in group.rows]
    entries = [{"chapter": "c", "row": row, "asked": ">= 0.9", "measured": 0.995, "unit": "fraction", "n": 1234} for row in rows[1:]]
    next(entry for entry in entries if entry["row"] == MISSED).update({"asked": "<= 0.0001", "measured": 0.02})
    machine = {"cores": 2, "processor": "A processor", "system": "Linux", "python": "3.12.1"}
    return {
        "version": "0.2.0",
        "commit": "0123456789abcdef",
        "date": "2026-11-27",
        "machine": machine,
        "recordings": "real",
        "rows": entries,
        "failed": {key.KEY[0].script: "exit status 1"},
        **changes,
    }


def test_every_key_figure_is_of_a_script_and_every_line_of_the_readme_of_key_figures() -> None:
    rows = [row for group in key.KEY for row in group.rows]
    assert len(set(rows)) == len(rows) and 40 <= len(rows) <= 90
    scripts = [group.script for group in key.KEY]
    assert all(row in chapters.CHAPTERS[chapter] for chapter, row in map(str.split, scripts)) and len(set(scripts)) == len(scripts)
    assert len(key.README) == 7 and {row for line in key.README for row, _ in line.rows} <= set(rows)


def test_a_tree_that_differs_from_its_commit_is_refused(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-c", "user.name=n", "-c", "user.email=e@e", *words], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    (tmp_path / "a.py").write_text("a = 1\n")
    git("add", ".")
    git("commit", "-m", "a")
    commit = release.commit_of(tmp_path, dirty_is_refused=True)
    assert len(commit) == 40
    (tmp_path / "docs" / "figures").mkdir(parents=True)
    (tmp_path / "docs" / "figures" / "0.1.0.json").write_text("{}")
    git("add", ".")
    assert release.commit_of(tmp_path, dirty_is_refused=True) == commit, "figures of a release are no change of the code"
    (tmp_path / "a.py").write_text("a = 2\n")
    with pytest.raises(release.Refused, match=r"1 files differ from the commit \(a.py\); commit or stash"):
        release.commit_of(tmp_path, dirty_is_refused=True)
    assert release.commit_of(tmp_path, dirty_is_refused=False) == commit
    with pytest.raises(release.Refused, match="needs a clone with git"):
        release.commit_of(tmp_path.parent, dirty_is_refused=True)


def test_what_was_stopped_goes_on_and_a_script_that_fails_costs_its_own_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    groups, ran, failing = key.KEY[:3], [], {key.KEY[1].script}

    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        script = " ".join(words[3:5])
        group = next(group for group in groups if group.script == script)
        ran.append(script)
        entries = [{"chapter": words[3], "row": row, "asked": "none", "measured": 1.0, "unit": "s", "n": 1} for row in group.rows]
        Path(words[words.index("--json") + 1]).write_text(json.dumps(entries), encoding="utf-8")
        return subprocess.CompletedProcess(words, int(script in failing))

    monkeypatch.setattr(release.subprocess, "run", run)
    failed = release.measure(groups, tmp_path, quick=False)
    assert list(failed) == [groups[1].script] and "exit status 1" in failed[groups[1].script]
    assert len(ran) == 3
    failing.clear()
    assert release.measure(groups, tmp_path, quick=False) == {}
    assert ran[3:] == [groups[1].script], "what has its result is not measured again"
    assert [row["row"] for row in release._rows(tmp_path)] == [row for group in groups for row in group.rows]


def test_a_script_that_does_not_give_its_row_has_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(words: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        Path(words[words.index("--json") + 1]).write_text("[]", encoding="utf-8")
        return subprocess.CompletedProcess(words, 0)

    monkeypatch.setattr(release.subprocess, "run", run)
    failed = release.measure(key.KEY[:1], tmp_path, quick=False)
    assert f"gave no row '{key.KEY[0].rows[0]}'" in failed[key.KEY[0].script]


def test_the_page_shows_what_was_measured_what_was_missed_and_what_is_not_there() -> None:
    page = docs.page_of(a_release())
    assert "Measured with 0.2.0, 27 November 2026, two cores (A processor" in page and "stale" not in page
    rows = [row for group in key.KEY for row in group.rows]
    assert f"| {rows[1]} | >= 90 % | 99.5 % | yes | 1,234 |" in page
    assert f"| {MISSED} | <= 0.01 % | 2 % | **no** | 1,234 |" in page
    assert f"| {rows[0]} | | not measured: `{key.KEY[0].script}` failed | **no** | |" in page
    assert f"{len(rows) - 2} of {len(rows) - 1} figures reach" in page
    assert "simulated ones" in docs.page_of(a_release(recordings="simulated"))


def test_the_table_of_the_readme_stands_between_its_marks() -> None:
    page = f"# A\n\n{docs.BEGIN}\nold\n{docs.END}\n\nafter\n"
    made = docs.with_table(page, a_release())
    assert made.startswith("# A\n") and made.endswith("after\n") and "old" not in made
    assert docs.with_table(made, a_release()) == made
    table = made.split(docs.BEGIN)[1].split(docs.END)[0].strip().splitlines()
    assert len(table) == 9 and table[0] == "| Measured with 0.2.0, 27 November 2026, two cores | | n |"
    assert any("2.00 % wrong (asked <= 0.01 %)" in line for line in table), "a miss is shown as one"
    with pytest.raises(ValueError, match="once each"):
        docs.with_table("# A\n", a_release())


def test_the_newest_release_is_the_highest_version(tmp_path: Path) -> None:
    assert docs.newest(tmp_path) is None
    for version in ("0.2.0", "0.10.0", "0.9.1"):
        (tmp_path / f"{version}.json").write_text(json.dumps({"version": version}), encoding="utf-8")
    assert docs.newest(tmp_path) == {"version": "0.10.0"}


def test_the_pages_are_those_of_the_newest_release() -> None:
    assert (ROOT / "docs" / "figures.md").read_text(encoding="utf-8") == docs.page_of(docs.newest()), "run `python -m benchmarks docs`"
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    if docs.BEGIN in readme:
        assert readme == docs.with_table(readme, docs.newest()), "run `python -m benchmarks docs`"
