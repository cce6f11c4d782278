"""The pages of docs/, README.md and CONTRIBUTING.md: their links lead somewhere, and the glossary is complete and in order."""

from __future__ import annotations

import importlib
import re
import sys
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
COPIES = {ROOT / "docs" / "index.md", *(ROOT / "docs" / "project").glob("*.md")}  # made when the site is built
PAGES = sorted({*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")} - COPIES)
GLOSSARY = ROOT / "docs" / "glossary.md"


@cache
def anchors_of(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    found: Counter[str] = Counter()
    anchors = set()
    for heading in re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL), re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading).lower()).replace(" ", "-")
        anchors.add(f"{slug}-{found[slug]}" if found[slug] else slug)
        found[slug] += 1
    return anchors


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"\w+:", target):
            continue
        file, _, anchor = target.partition("#")
        there = (page.parent / file).resolve() if file else page
        assert there.exists(), f"{page.name} links to {target}, which does not exist"
        if anchor and there.suffix == ".md":
            assert anchor in anchors_of(there), f"{page.name} links to {target}: no such heading"


def test_every_fence_of_a_page_is_closed() -> None:
    for page in PAGES:
        fences = re.findall(r"^ *```(\w*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert len(fences) % 2 == 0 and not any(fences[1::2]), f"{page.name}: {fences}"


def test_the_glossary_lists_all_its_terms_and_each_section_is_in_alphabetical_order() -> None:
    text = GLOSSARY.read_text(encoding="utf-8")
    terms = re.findall(r"^### (.+)$", text, re.MULTILINE)
    assert len(set(terms)) == len(terms)
    index = re.findall(r"\[([^\]]+)\]\(#", text.split("\n## ")[0])
    assert index == sorted(terms, key=str.lower)
    for section in text.split("\n## ")[1:]:
        found = re.findall(r"^### (.+)$", section, re.MULTILINE)
        assert found == sorted(found, key=str.lower)


def test_every_python_file_that_a_page_names_is_there() -> None:
    there = [path.as_posix() for folder in ("src", "tests", "tools", "benchmarks", "docs") for path in (ROOT / folder).rglob("*.py")]
    for page in PAGES:
        text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
        named = set(re.findall(r"`([\w/]+\.py)`", text)) - {"_kernels.py"}
        missing = [name for name in named if not any(path.endswith(f"/{name}") for path in there)]
        assert missing == [], f"{page.name} names files that are not there: {missing}"


def test_every_benchmark_that_a_page_names_is_there() -> None:
    sys.path.insert(0, str(ROOT))
    chapters = importlib.import_module("benchmarks.chapters").CHAPTERS
    named = {
        words
        for page in PAGES
        for words in re.findall(r"`python -m benchmarks (\w+)(?: ([a-z][\w-]*))?`", page.read_text(encoding="utf-8"))
    }
    assert len(named) > 5
    for chapter, row in named - {("release", ""), ("docs", "")}:
        assert chapter in chapters and (not row or row in chapters[chapter]), f"python -m benchmarks {chapter} {row}"
