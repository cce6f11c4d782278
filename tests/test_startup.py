"""What a command loads before it does anything: heavy libraries only where they are used."""

from __future__ import annotations

import shlex
import subprocess
import sys
import warnings
from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
import typer

import asterism
from asterism.cli._options import SearchStrategy
from asterism.cli._plain_values import PlainValuesCommand
from asterism.recording.arrays import nan_mean, nan_median, nan_quantile, nan_var
from asterism.simulation import simulate_walks

HEAVY = ("numba", "llvmlite", "scipy", "cv2", "plotly", "jinja2", "pydantic", "numpy.ma")

SCRIPT = """
import sys
from asterism.cli import main
try:
    status = main(sys.argv[1:])
except SystemExit as end:
    status = end.code
assert not status, status
print("LOADED", *sorted({name.partition(".")[0] for name in sys.modules} | {"numpy.ma"} & set(sys.modules)))
"""


def loaded(*args: str) -> set[str]:
    run = subprocess.run([sys.executable, "-c", SCRIPT, *args], capture_output=True, text=True, check=True)
    return set(run.stdout.splitlines()[-1].split()[1:])


@cache
def loaded_by(package: str) -> set[str]:
    """What a package imports itself: the oldest Typer that is allowed imports Rich, the oldest NumPy `numpy.ma`."""
    run = subprocess.run([sys.executable, "-c", f"import sys, {package}; print(*sys.modules)"], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


@pytest.mark.parametrize("args", [("--help",), ("label", "--help"), ("calibrate", "wand", "--help"), ("--version",)], ids=" ".join)
def test_help_needs_no_numbers(args: tuple[str, ...]) -> None:
    assert loaded(*args) & ({*HEAVY, "numpy", "rich"} - loaded_by("typer")) == set()


@pytest.mark.parametrize("suffix", ["c3d", "npz", "csv"])
def test_info_needs_neither_kernels_nor_scipy(suffix: str, tmp_path: Path) -> None:
    asterism.write(tmp_path / f"walk.{suffix}", simulate_walks(1, 20, 100.0, seed=1)[0])
    modules = loaded("info", str(tmp_path / f"walk.{suffix}"))
    assert "numpy" in modules, "the measure works"
    assert modules & (set(HEAVY) - loaded_by("numpy")) == set()


def answer(arguments: list[str], cls: type | None) -> object:
    """What a command's function is called with, or how the call is refused."""
    called: list[object] = []
    app = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False)

    @app.command(cls=cls)
    def command(
        files: Annotated[list[Path], typer.Argument()],
        model: Annotated[Path | None, typer.Option()] = None,
        text: Annotated[str, typer.Option()] = "usual",
        number: Annotated[int, typer.Option(min=1)] = 3,
        share: Annotated[float | None, typer.Option()] = None,
        force: Annotated[bool, typer.Option("--force")] = False,
        miner: Annotated[SearchStrategy | None, typer.Option()] = None,
        there: Annotated[Path | None, typer.Option(exists=True)] = None,
    ) -> None:
        called.append((files, model, text, number, share, force, miner, there))

    try:
        app(args=arguments, standalone_mode=False)
    except Exception as problem:
        return type(problem).__name__, str(problem)
    return called


@pytest.mark.parametrize(
    ("line", "taken"),
    [
        ("a.c3d", True), ("a.c3d b/c.c3d --model m --text t --number 7 --share 0.5 --force --miner genetic", True),
        ("a.c3d --text ''", True), ("a.c3d --model ''", True), ("", False), ("a.c3d --number 0", False), ("a.c3d --number many", False),
        ("a.c3d --miner none", False), ("a.c3d --nothing", False), ("a.c3d --there nowhere", False),
    ],
)  # fmt: skip
def test_plain_values_are_taken_as_typer_takes_them(line: str, taken: bool) -> None:
    plain, typers = (answer(shlex.split(line), cls) for cls in (PlainValuesCommand, None))
    assert plain == typers
    assert isinstance(plain, list) is taken


def test_statistics_of_what_is_there_are_those_of_numpy_without_its_warnings() -> None:
    values = np.random.default_rng(0).normal(size=(40, 7, 3))
    values[np.random.default_rng(1).random((40, 7)) < 0.4] = np.nan
    values[0] = np.nan
    shares = [0.0, 0.03, 0.5, 0.97, 1.0]
    for axis in (0, 1):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            median, quantiles = np.nanmedian(values, axis), np.nanquantile(values, shares, axis)
            mean, var = np.nanmean(values, axis), np.nanvar(values, axis)
        np.testing.assert_allclose(nan_median(values, axis), median, rtol=1e-13)
        np.testing.assert_allclose(nan_quantile(values, shares, axis), quantiles, rtol=1e-12)
        np.testing.assert_array_equal(nan_mean(values, axis), mean)
        np.testing.assert_array_equal(nan_var(values, axis), var)
    assert np.isnan(nan_mean(values[:0], axis=0)).all()


def test_every_name_of_the_front_door_is_listed_and_found() -> None:
    assert set(asterism.__all__) <= set(dir(asterism))
    for name in asterism.__all__:
        assert getattr(asterism, name) is getattr(asterism, name)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        asterism.nothing  # noqa: B018
