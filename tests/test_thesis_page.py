"""docs/thesis.md: every name on the page exists, and every numbered part of the thesis' chapters 3 to 6 is on it."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

from asterism.labelling.features.registry import THESIS, feature_pool
from asterism.labelling.partial.full_solver_study import PRINTED_RULES, SIZES
from asterism.labelling.partial.solver_search import PRINTED, PRINTED_FEATURES

PAGE = (Path(__file__).parent.parent / "docs" / "thesis.md").read_text(encoding="utf-8")
NAMES = sorted(set(re.findall(r"`((?:asterism|benchmarks)\.[\w.]+)`", PAGE)))


def resolve(name: str) -> object:
    """The module, class or function of a dotted name."""
    parts = name.split(".")
    for split in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:split]))
        except ModuleNotFoundError:
            continue
        for part in parts[split:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_on_the_page_exists(name: str) -> None:
    assert resolve(name) is not None


def test_a_name_that_does_not_exist_is_noticed() -> None:
    assert len(NAMES) > 40
    with pytest.raises(AttributeError):
        resolve("asterism.labelling.partial.solver_search.sideways")


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("eq.", ["3.1", "3.5", "3.6", "3.7", "3.8", "3.9", "3.10", "4.1", "4.2", "4.3", "4.4", "4.5", "6.1", "6.2"]),
        ("algorithm", ["3.1", "3.2", "4.1", "4.2"]),
        ("table", ["4.1", "5.1", "5.2", "5.3", "5.5"]),
        ("fig.", [*(f"3.{n}" for n in (3, 5, 6, 7, 8, 9, 10, 11)), *(f"4.{n}" for n in (1, 2, 3, 5, 6, 7, 8)), "5.1", "5.2"]),
        ("section", ["3.1.1", "3.1.2", "3.2", "3.3", "3.4", "4.1", "4.2", "4.3", "4.4.1", "4.4.2", "4.5.1", "4.5.2", "4.5.3", "4.5.4"]),
        ("section", ["5.1", "5.2", "6.1", "6.2", "6.3"]),
    ],
)
def test_the_parts_of_the_thesis_are_on_the_page(kind: str, numbers: list[str]) -> None:
    first_column = " ".join(line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| thesis"))
    missing = [number for number in numbers if not re.search(rf"(?<![\d.]){re.escape(number)}(?![\d.]*\d)", first_column)]
    assert missing == [], f"{kind} {missing}"


def test_each_line_says_whether_it_is_faithful() -> None:
    rows = [line.split("|")[1:-1] for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("| thesis")]
    assert len(rows) > 45
    for part, _, how in rows:
        assert re.match(r" (faithful|improved|planned|other data)", how), f"{part.strip()}: {how.strip()}"


def test_the_full_solver_is_as_large_as_the_page_says() -> None:
    """Of the features of the thesis over its 15 markers."""
    [(chosen, among)] = re.findall(r"full solver of (\d+) of (\d+) classifiers", PAGE)
    assert (PRINTED_RULES.weak_classifiers, len(feature_pool(15, THESIS)[0])) == (int(chosen), int(among)) == (SIZES[-1], 665)


def test_small_partial_solvers_take_all_classifiers_as_the_page_says() -> None:
    [(largest, pool, most)] = re.findall(
        r"up to (\d+) markers it takes all classifiers over its markers \((\d+) at 8\), above that the first ([\d,]+)", PAGE
    )
    sizes = [len(feature_pool(markers, PRINTED_FEATURES)[0]) for markers in (int(largest), int(largest) + 1)]
    assert sizes[0] == int(pool) <= PRINTED.max_classifiers < sizes[1]
    assert PRINTED.max_classifiers == int(most.replace(",", ""))
