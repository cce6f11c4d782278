"""The shape of the source: how long, how branched and how wide its functions are outside kernels, read from the syntax tree."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import asterism
from asterism.errors import AsterismError
from benchmarks.benchmark_run import BenchmarkRun
from benchmarks.figures import Figure

PACKAGE = Path(asterism.__file__).parent
MOST_ARGUMENTS, MOST_COMPLEX, MOST_LINES = 8, 15, 60
REACH = "< 0.005"


@dataclass(frozen=True)
class Function:
    """One `def` of the package, methods and nested functions included.

    arguments  how many it takes, `self` and `cls` not counted, `*args` and `**options` as one each
    lines      of code: without its docstring, empty lines and comments; a nested function's lines count for both
    command    whether the command line registers it: its arguments are the options that a user sees
    """

    file: Path
    name: str
    line: int
    arguments: int
    lines: int
    kernel: bool
    command: bool


def functions(package: Path = PACKAGE) -> list[Function]:
    """All functions of a package."""
    return [function for file in sorted(package.rglob("*.py")) for function in _of_file(file, package)]


def too_complex(package: Path = PACKAGE, most: int = MOST_COMPLEX) -> set[tuple[Path, int]]:
    """File and line of the functions whose cyclomatic complexity (McCabe, as ruff's C901 counts it) is above a limit.

    Raises AsterismError where ruff cannot be run.
    """
    words = [sys.executable, "-m", "ruff", "check", "--isolated", "--no-cache", "--select", "C901", "--output-format", "json"]
    done = subprocess.run(
        [*words, "--config", f"lint.mccabe.max-complexity={most}", str(package)], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1):
        raise AsterismError(f"ruff could not be run: {done.stderr.strip()}; install it with pip install -e '.[dev]'.")
    return {(Path(found["filename"]), found["location"]["row"]) for found in json.loads(done.stdout)}


def structure(benchmark: BenchmarkRun) -> Iterator[Figure]:
    """The share of functions outside kernels that are above each limit. A command's options do not count as arguments of a function."""
    found = [function for function in functions() if not function.kernel]
    plain = [function for function in found if not function.command]
    complex_places = too_complex()
    wide = [function for function in plain if function.arguments > MOST_ARGUMENTS]
    branched = [function for function in found if (function.file, function.line) in complex_places]
    long = [function for function in found if function.lines > MOST_LINES]
    for function in {*wide, *branched, *long}:
        place = f"{function.file.relative_to(PACKAGE)}:{function.line} {function.name}"
        benchmark.report(f"{place}: {function.arguments} arguments, {function.lines} lines, complex: {function in branched}")
    row = "functions outside kernels"
    yield Figure(f"{row}: more than {MOST_ARGUMENTS} arguments", REACH, len(wide) / len(plain), "fraction", len(plain))
    yield Figure(f"{row}: complexity above {MOST_COMPLEX}", REACH, len(branched) / len(found), "fraction", len(found))
    yield Figure(f"{row}: more than {MOST_LINES} lines", REACH, len(long) / len(found), "fraction", len(found))


def _of_file(file: Path, package: Path) -> Iterator[Function]:
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    commands = _commands(file, package)
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            kernel = any("kernel" in ast.unparse(decorator) or "njit" in ast.unparse(decorator) for decorator in node.decorator_list)
            length = _code_lines(node, lines)
            yield Function(file, node.name, node.lineno, _arguments(node), length, kernel, node.name in commands)


def _commands(file: Path, package: Path) -> set[str]:
    """The functions of a file of `cli` that have `Annotated` or aliased options: its file is named after the verb."""
    is_command = (package / "cli") in file.parents and not file.name.startswith("_")
    return {file.stem, f"{file.stem}_", file.stem.replace("-", "_")} if is_command else set()


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = node.args
    names = [argument.arg for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs]]
    bound = bool(names) and names[0] in ("self", "cls")
    return len(names) - bound + (given.vararg is not None) + (given.kwarg is not None)


def _code_lines(node: ast.FunctionDef | ast.AsyncFunctionDef, lines: list[str]) -> int:
    docstring = node.body[0] if ast.get_docstring(node) is not None else None
    left_out = range(docstring.lineno, (docstring.end_lineno or 0) + 1) if docstring else range(0)
    numbers = (number for number in range(node.lineno, (node.end_lineno or node.lineno) + 1) if number not in left_out)
    return sum(bool(lines[number - 1].strip()) and not lines[number - 1].lstrip().startswith("#") for number in numbers)
