"""Findings: every code that the source gives stands in docs/findings.md, and the exit status follows from the severities."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import asterism
from asterism.findings import Finding, Severity, exit_status, worst

SOURCES = sorted(Path(asterism.__file__).parent.rglob("*.py"))
PAGE = Path(__file__).parents[1] / "docs" / "findings.md"


def calls(path: Path) -> Iterator[ast.Call]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding":
            yield node


def code_of(call: ast.Call) -> str | None:
    given = call.args[0] if call.args else next((k.value for k in call.keywords if k.arg == "code"), None)
    return given.value if isinstance(given, ast.Constant) and isinstance(given.value, str) else None


def users() -> list[Path]:
    return [path for path in SOURCES if re.search(r"from asterism\.findings import .*\bFinding\b", path.read_text(encoding="utf-8"))]


def documented() -> dict[str, list[str]]:
    rows = re.findall(r"^\| ([a-z]+(?:-[a-z0-9]+)+) \|(.*)\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {code: [cell.strip() for cell in rest.split("|")] for code, rest in rows}


@pytest.mark.parametrize("path", users(), ids=lambda path: path.stem)
def test_codes_are_literals(path: Path) -> None:
    assert [call.lineno for call in calls(path) if code_of(call) is None] == []


def test_source_and_page_name_the_same_codes() -> None:
    given = {code_of(call) for path in users() for call in calls(path)}
    assert given == set(documented())
    assert given, "the search finds calls"


def test_each_code_has_severity_cause_and_mend() -> None:
    for code, cells in documented().items():
        assert len(cells) == 3, code
        severity, cause, mend = cells
        assert set(re.split(r", | or ", severity)) <= {"note", "warning", "error"}, code
        assert cause and mend, code


def test_a_code_appears_once_on_the_page() -> None:
    codes = re.findall(r"^\| ([a-z]+(?:-[a-z0-9]+)+) \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(codes) == len(set(codes))


@pytest.mark.parametrize(
    ("severities", "status"),
    [((), 0), (("NOTE",), 0), (("NOTE", "WARNING"), 1), (("ERROR",), 1)],
    ids=lambda value: str(value),
)
def test_exit_status(severities: tuple[str, ...], status: int) -> None:
    findings = [Finding("a-b", Severity[name], "cam1", "cam1 has moved.", "Calibrate again.") for name in severities]
    assert exit_status(findings) == status
    assert worst(findings) == max((Severity[name] for name in severities), default=Severity.NOTE)


def test_a_finding_reads_as_sentence_and_mend() -> None:
    assert str(Finding("a-b", Severity.NOTE, "cam1", "cam1 has moved.", "Calibrate again.")) == "cam1 has moved. Calibrate again."
    assert str(Finding("a-b", Severity.NOTE, "cam1", "cam1 has moved.")) == "cam1 has moved."
