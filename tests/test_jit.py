"""The kernel decorator and its compile cache: what it keeps, when it compiles again, and where it writes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import asterism

CALLEE = """
from asterism._jit import kernel


@kernel
def weight(x):
    return {factor} * x
"""
CALLER = """
from asterism._jit import kernel
from tiny.inner_kernels import weight


@kernel
def total(value):
    return weight(value) + weight(1.0)
"""
MAIN = """
from asterism.progress import on_first_compile

on_first_compile(lambda kept: print("compiles", kept))
from tiny.outer_kernels import total

print(total(5.0))
"""


def write_package(folder: Path, factor: float, decorator: str = "") -> None:
    """A package of two modules: the kernel of one calls the kernel of the other."""
    package = folder / "tiny"
    package.mkdir(parents=True, exist_ok=True)
    (package / "__init__.py").write_text("")
    for name, text in (("inner_kernels.py", CALLEE.format(factor=factor)), ("outer_kernels.py", CALLER)):
        if decorator:
            text = text.replace("from asterism._jit import kernel", "from numba import njit").replace("@kernel", decorator)
        (package / name).write_text(text)


def run(folder: Path, code: str = MAIN, **environment: str) -> list[str]:
    """Lines that a new process prints which calls the package's kernel."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    source = str(Path(asterism.__file__).parents[1])
    kept |= {"PYTHONPATH": os.pathsep.join([str(folder), source]), "PYTHONDONTWRITEBYTECODE": "1"} | environment
    result = subprocess.run([sys.executable, "-c", code], env=kept, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout.split("\n")[:-1]


def test_a_changed_callee_is_seen(tmp_path):
    write_package(tmp_path, 2.0)
    assert run(tmp_path) == ["compiles True", "12.0"]
    assert run(tmp_path) == ["12.0"], "the second run takes the first one's compiled kernels"
    before = set((tmp_path / "tiny" / "__pycache__").glob("*.nbc"))
    write_package(tmp_path, 3.0)
    assert run(tmp_path) == ["compiles True", "18.0"]
    after = set((tmp_path / "tiny" / "__pycache__").glob("*.nbc"))
    assert len(before) == len(after) == 3, "what the caller links, what others link of the caller, and its program"
    assert not before & after, "what was compiled from the old sources is removed"


@pytest.mark.slow
def test_numbas_own_cache_does_not_see_it(tmp_path):
    write_package(tmp_path, 2.0, "@njit(cache=True)")
    assert run(tmp_path) == ["12.0"]
    write_package(tmp_path, 3.0, "@njit(cache=True)")
    assert run(tmp_path) == ["12.0"], "stale: this is what our cache is for"


@pytest.mark.slow
def test_equal_sources_in_another_folder_share_a_cache(tmp_path):
    kernels = str(tmp_path / "kernels")
    write_package(tmp_path / "one", 2.0)
    write_package(tmp_path / "two", 2.0)
    write_package(tmp_path / "three", 3.0)
    assert run(tmp_path / "one", NUMBA_CACHE_DIR=kernels) == ["compiles True", "12.0"]
    assert run(tmp_path / "two", NUMBA_CACHE_DIR=kernels) == ["12.0"]
    assert run(tmp_path / "three", NUMBA_CACHE_DIR=kernels) == ["compiles True", "18.0"]


@pytest.mark.slow
def test_damaged_files_compile_again(tmp_path):
    write_package(tmp_path, 2.0)
    run(tmp_path)
    inner, linked, program = sorted((tmp_path / "tiny" / "__pycache__").glob("*.nbc"))
    inner.write_bytes(b"nothing that was ever compiled")
    linked.write_bytes(b"")
    program.write_bytes(program.read_bytes()[:-1])
    assert run(tmp_path) == ["compiles True", "12.0"]
    assert run(tmp_path) == ["12.0"]


def test_without_the_compiler(tmp_path):
    write_package(tmp_path, 2.0)
    assert run(tmp_path, NUMBA_DISABLE_JIT="1") == ["12.0"]


def unwritable(folder: Path) -> dict[str, str]:
    """A package and a home in which no cache can be made: files stand where the folders would be (permissions do not bind root)."""
    (folder / "tiny" / "__pycache__").write_text("")
    (folder / "home").write_text("")
    return {"HOME": str(folder / "home"), "XDG_CACHE_HOME": str(folder / "home"), "LOCALAPPDATA": str(folder / "home")}


@pytest.mark.slow
def test_the_users_cache_where_the_package_is_read_only(tmp_path):
    write_package(tmp_path, 2.0)
    home = unwritable(tmp_path)
    home["XDG_CACHE_HOME"] = home["LOCALAPPDATA"] = str(tmp_path / "cache")
    if sys.platform == "darwin":
        home["HOME"] = str(tmp_path / "cache")
    assert run(tmp_path, **home) == ["compiles True", "12.0"]
    assert run(tmp_path, **home) == ["12.0"]


@pytest.mark.slow
def test_a_temporary_cache_where_nothing_else_can_be_written(tmp_path):
    write_package(tmp_path, 2.0)
    (tmp_path / "tmp").mkdir()
    nowhere = unwritable(tmp_path) | {"TMPDIR": str(tmp_path / "tmp"), "TEMP": str(tmp_path / "tmp"), "TMP": str(tmp_path / "tmp")}
    assert run(tmp_path, **nowhere) == ["compiles False", "12.0"]
    assert run(tmp_path, **nowhere) == ["compiles False", "12.0"], "every run compiles again, and says so"
    assert not list((tmp_path / "tmp").iterdir()), "the temporary folder goes with its run"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such locks: there both compile")
@pytest.mark.parametrize("comes", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_what_another_process_compiles_is_waited_for(comes: bool, tmp_path: Path) -> None:
    """If it never comes, because the other process was killed, it is compiled after all."""
    import fcntl

    write_package(tmp_path, 2.0)
    run(tmp_path)
    (outer,) = (tmp_path / "tiny" / "__pycache__").glob("*.run.nbc")
    aside = outer.rename(tmp_path / "aside")
    for linked in outer.parent.glob("outer_kernels.total*.link.nbc"):
        linked.unlink()
    source = str(Path(asterism.__file__).parents[1])
    kept = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    kept["PYTHONPATH"] = os.pathsep.join([str(tmp_path), source])
    code = MAIN.replace("kept))", "kept, flush=True))") + "print(sum(total.stats.cache_hits.values()))"
    with (outer.parent / f"{outer.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        process = subprocess.Popen([sys.executable, "-c", code], env=kept, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        with process.stdout:
            assert process.stdout.readline() == "compiles True\n"
            if comes:
                aside.rename(outer)
            lock.close()
            assert process.stdout.read().split() == ["12.0", str(int(comes))]
    assert process.wait() == 0 and outer.exists()


PAIR = """
from typing import NamedTuple

import numpy as np
from asterism._jit import kernel


class Pair(NamedTuple):
    first: np.ndarray
    second: np.ndarray


@kernel
def make_pair(n):
    return Pair(np.zeros(n), np.ones(n))


@kernel
def total(n):
    pair = make_pair(n)
    return pair.first.sum() + pair.second.sum()
"""
CALLS = """
from tiny.pair_kernels import make_pair, total

print(total(2), make_pair(2))
print(len(make_pair.nopython_signatures), sum(total.stats.cache_hits.values()) + sum(make_pair.stats.cache_hits.values()))
"""


def test_a_kernel_that_kernels_and_python_call_is_the_same_when_it_was_kept(tmp_path: Path) -> None:
    """What Python gets is made of constants that only the kernel's own program brings along, not the one that it is linked into."""
    write_package(tmp_path, 2.0)
    (tmp_path / "tiny" / "pair_kernels.py").write_text(PAIR)
    pair = "2.0 Pair(first=array([0., 0.]), second=array([1., 1.]))"
    assert run(tmp_path, code=CALLS) == [pair, "1 0"]
    assert run(tmp_path, code=CALLS) == [pair, "1 2"]


def test_only_what_python_calls_becomes_machine_code(tmp_path: Path) -> None:
    write_package(tmp_path, 2.0)
    run(tmp_path)
    programs = [path.name.partition("-")[0] for path in (tmp_path / "tiny" / "__pycache__").glob("*.run.nbc")]
    assert programs == ["outer_kernels.total"]
