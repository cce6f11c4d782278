"""What a command loads before it does anything: heavy libraries only where they are used."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import asterism
from asterism.simulation import simulate_walks

HEAVY = ("numba", "llvmlite", "scipy", "cv2", "plotly", "jinja2")

SCRIPT = """
import sys
from asterism.cli import main
try:
    status = main(sys.argv[1:])
except SystemExit as end:
    status = end.code
assert not status, status
print("LOADED", *sorted({name.partition(".")[0] for name in sys.modules}))
"""


def loaded(*args: str) -> set[str]:
    run = subprocess.run([sys.executable, "-c", SCRIPT, *args], capture_output=True, text=True, check=True)
    return set(run.stdout.splitlines()[-1].split()[1:])


@cache
def loaded_by_typer() -> set[str]:
    """What Typer imports itself: the oldest release that is allowed imports Rich."""
    run = subprocess.run([sys.executable, "-c", "import sys, typer; print(*sys.modules)"], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


@pytest.mark.parametrize("args", [("--help",), ("label", "--help"), ("calibrate", "wand", "--help"), ("--version",)], ids=" ".join)
def test_help_needs_no_numbers(args: tuple[str, ...]) -> None:
    assert loaded(*args) & ({*HEAVY, "numpy", "rich"} - loaded_by_typer()) == set()


@pytest.mark.parametrize("suffix", ["c3d", "npz", "csv"])
def test_info_needs_neither_kernels_nor_scipy(suffix: str, tmp_path: Path) -> None:
    asterism.write(tmp_path / f"walk.{suffix}", simulate_walks(1, 20, 100.0, seed=1)[0])
    modules = loaded("info", str(tmp_path / f"walk.{suffix}"))
    assert "numpy" in modules, "the measure works"
    assert modules & set(HEAVY) == set()


def test_every_name_of_the_front_door_is_listed_and_found() -> None:
    assert set(asterism.__all__) <= set(dir(asterism))
    for name in asterism.__all__:
        assert getattr(asterism, name) is getattr(asterism, name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        asterism.nothing  # noqa: B018
