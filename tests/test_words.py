"""Terminal and pages speak the laboratory's language: no word of Python or of our own, no power of ten, one thing in the singular."""

from __future__ import annotations

import ast
import html
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest
from models import trained
from parsing import uncollected
from snapshot import SNAPSHOTS

import asterism
from asterism import formats
from asterism.cli import _EXAMPLES, _GROUPS, main
from asterism.labelling.simulated_occlusions import simulate_gaps_and_ghosts
from asterism.recording import Recording
from asterism.simulation import simulate_walks

SOURCES = Path(asterism.__file__).parent
OURS = r"\bnats?\b|\bFA\b|\bFO\b|\bfalse (?:assignment|occlusion)s?\b|\bis none\b|\bmakes no sense\b"
OF_PYTHON = r"\b[A-Z]\w*(?:Error|Exception)s?\b|\b[A-Z][a-z]+[A-Z]\w*\(|\{\}|\b(?:NoneType|dict|tuple|ndarray)\b"
VALUES_OF_PYTHON = r"\b(?:None|True|False|undefined|PosixPath|WindowsPath)\b|\[\]|\('|\blist\[|<path>|\d<=x"
NUMBERS = r"\d[eE][+-]?\d\d\b|(?<![\d.,+])\b1 (?:frame|marker|piece|trial|file|recording|subject|camera|joint|limb|group|point|person)s\b"
SAID = re.compile("|".join((OURS, OF_PYTHON, VALUES_OF_PYTHON, NUMBERS)))
"""What no output may hold."""
NAMED_IN_PYTHON = {"MarkerModel", "ReadRules"}
"""Classes that are named to whoever writes Python, in sentences that no command prints."""


@dataclass(frozen=True)
class Survey:
    """What the sources of the package hold: classes whose names are no words; sentences and formats of numbers, each behind its place."""

    classes: frozenset[str]
    sentences: list[tuple[str, str]]
    formats: list[tuple[str, str]]


@cache
@uncollected()
def survey() -> Survey:
    """All sources, read once. Docstrings are left out: they say things to whoever writes Python."""
    classes, sentences, patterns = set[str](), list[tuple[str, str]](), list[tuple[str, str]]()
    for path in sorted(SOURCES.rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        notes = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        file = path.relative_to(SOURCES).as_posix()
        for node in nodes:
            at = f"{file}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.ClassDef) and re.search(r"[a-z][A-Z]", node.name):
                classes.add(node.name)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in notes and " " in node.value.strip():
                sentences.append((at, node.value))
            elif isinstance(node, ast.JoinedStr) and len(node.values) > 1:
                given = [part.format_spec for part in node.values if isinstance(part, ast.FormattedValue)]
                patterns += [
                    (at, "".join(str(part.value) for part in one.values if isinstance(part, ast.Constant)))
                    for one in given
                    if isinstance(one, ast.JoinedStr)
                ]
    return Survey(frozenset(classes - NAMED_IN_PYTHON), sentences, patterns)


def wrong_words(text: str) -> list[str]:
    """What is wrong in a text, each with what stands around it."""
    text = " ".join(text.split())
    found = {match.span() for match in SAID.finditer(text)}
    found |= {match.span() for match in re.finditer(r"\b[A-Z]\w+\b", text) if match[0] in survey().classes}
    return [text[max(0, first - 40) : last + 40] for first, last in sorted(found)]


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("2.1 nats better", 1),
        ("FA 0.1 %, FO 2 %", 2),
        ("no CalibrationErrors were given", 1),
        ("is damaged (IndexError)", 1),
        ("partial_solvers: {}", 1),
        ("learned 1 trials", 1),
        ("a body of 1.44e+03 m", 1),
        ("vertical None", 1),
        ("1 trial of 11 trials, 101 frames; ERROR_2D.c3d: 3.5e of nothing", 0),
    ],
)
def test_wrong_words_are_found(text: str, number: int) -> None:
    assert len(wrong_words(text)) == number


def test_no_sentence_holds_a_word_of_our_own_or_of_python() -> None:
    unfit = re.compile(f"{OURS}|{OF_PYTHON}")
    found = [
        f"{at}: {text[:80]}"
        for at, text in survey().sentences
        if unfit.search(text) or survey().classes.intersection(re.findall(r"\b[A-Z]\w+\b", text))
    ]
    assert found == []


def test_no_format_turns_a_large_number_into_a_power_of_ten() -> None:
    # 123 with two digits would be 1.2e+02; `asterism.recording.display.significant` writes 120
    assert [f"{at}: {pattern}" for at, pattern in survey().formats if re.fullmatch(r"[+,]*(?:\.[1-5][geE]|\.?\d*[eE])", pattern)] == []


@pytest.mark.parametrize("path", sorted(SNAPSHOTS.glob("*.txt")), ids=lambda path: path.stem)
def test_no_output_of_a_command_holds_such_a_word(path: Path) -> None:
    # JSON is for programs
    text = re.sub(r"^\{$.*?^\}$", "", path.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    assert wrong_words(text) == []


COMMANDS = [(), *((verb,) for verb in _EXAMPLES), *((group,) for group in _GROUPS)]
COMMANDS += [(group, verb) for group, (_, verbs) in _GROUPS.items() for verb in verbs]


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_no_help_holds_such_a_word(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--help"]) == 0
    assert wrong_words(capsys.readouterr().out) == []


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model, a raw and a labelled file, and one of a single person."""
    place = tmp_path_factory.mktemp("words")
    walks = simulate_walks(5, 60, 50.0, markers="helen-hayes", seed=3)
    trained(walks[:3], miner=None).save(place / "walks.model")
    formats.write(place / "raw.c3d", Recording.from_clouds(simulate_gaps_and_ghosts(walks[3], 2, 1, seed=1)[0]))
    formats.write(place / "walk.c3d", walks[3])
    return place


PAGES = (
    "label raw.c3d -m walks.model -o out --report page.html",
    "label raw.c3d walk.c3d -m walks.model -o both --report page.html",
    "review raw.c3d -m walks.model --report page.html",
    "evaluate walk.c3d -m walks.model --occlusions 2 --ghosts 1 --report page.html",
    "name raw.c3d --report page.html",
    "segment walk.c3d --report page.html",
    "motion walk.c3d --report page.html",
)


@pytest.mark.parametrize("line", PAGES, ids=lambda line: line.split(" -")[0])
def test_no_page_and_no_line_beside_it_holds_such_a_word(
    line: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    Path("page.html").unlink(missing_ok=True)
    main(line.split())
    shown = capsys.readouterr()
    page = Path("page.html").read_text(encoding="utf-8")
    data = json.loads(page.split('id="data">')[1].split("</script>")[0]) if 'id="data">' in page else {}
    # titles and hints of the figures, too; the rest of the scripts is no text
    drawn = [text for text in texts(data.get("figures", {})) if " " in text]
    seen = re.sub(r"<(script|style)\b.*?</\1>", " ", page, flags=re.DOTALL)
    assert (
        wrong_words(shown.out + shown.err)
        == wrong_words(html.unescape(re.sub(r"<[^>]+>", " ", seen)))
        == wrong_words(" ".join(drawn))
        == []
    )


def texts(value: object) -> Iterator[str]:
    """All texts in nested plain values."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for item in value.values():
            yield from texts(item)
    elif isinstance(value, list):
        for item in value:
            yield from texts(item)


def test_what_info_says_of_a_model_and_a_recording_holds_no_such_word(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(place / "walks.model"), str(place / "raw.c3d")]) == 0
    assert wrong_words(capsys.readouterr().out) == []
