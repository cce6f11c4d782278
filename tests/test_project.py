"""The project as a stranger meets it: the README's commands, the documents, the version, the order of the rooms."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

import asterism

ROOT = Path(__file__).parent.parent


def _project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_the_readme_checks_what_ci_checks() -> None:
    [line] = re.findall(r'^pip install -e ".*', (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"\n{line}\n" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert line.endswith("&& python tools/check.py")


def test_the_workflow_runs_the_two_commands_of_the_readme() -> None:
    workflow = (ROOT / ".github" / "workflows" / "checks.yml").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for command in ("pip install . && asterism demo", 'pip install -e ".[dev]" && python tools/check.py'):
        assert command in workflow and command in readme
    for python in re.findall(r"Python :: (3\.\d+)", "\n".join(_project()["project"]["classifiers"])):
        assert f'"{python}"' in workflow


def test_one_version() -> None:
    version = _project()["project"]["version"]
    assert asterism.__version__ in (version, "0+unknown"), "0+unknown: a source tree that is not installed"
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_every_room_stands_in_the_contract_and_in_the_documents() -> None:
    package = Path(asterism.__file__).parent
    rooms = {p.stem for p in package.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()} - {"__init__", "__main__"}
    [contract] = [contract for contract in _project()["tool"]["importlinter"]["contracts"] if contract["type"] == "layers"]
    assert rooms == set(contract["layers"])
    text = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    assert [room for room in rooms if f"`{room}`" not in text] == []


@pytest.mark.parametrize("name", asterism.__all__)
def test_every_export_exists_and_explains_itself(name: str) -> None:
    exported = getattr(asterism, name)
    assert isinstance(exported, str) or inspect.getdoc(exported)
