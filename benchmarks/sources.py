"""What a row measures: from the sources and a row of a chapter to the modules that the row imports, the recordings it reads, and a hash.

The benchmark's own functions are followed one by one, so that a change of one row leaves the others alone. Of the package a module counts
as a whole, with all that it imports, in functions too; an `__init__` that only hands names on is seen through. Comments, docstrings and
layout do not count. Readers do not count where reading is not what the row is about: in their place count the values that they gave
(`benchmarks/read_values.py`).
"""

from __future__ import annotations

import ast
import hashlib
import io
import subprocess
import tarfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE, BENCHMARKS = "asterism", "benchmarks"
FOLDERS = ("src", BENCHMARKS, "tests", "tools", "docs/reference", ".ci", "pyproject.toml")

BOOKKEEPING = tuple(f"benchmarks.{name}" for name in ("figures", "docs", "plots", "sources", "read_values", "runs", "stale"))
"""Modules that keep and print figures, and change none."""

READERS = (
    "asterism.errors",
    "asterism.findings",
    "asterism.progress",
    "asterism.recording._marker_set_file",
    "asterism.formats",
    "asterism.cameras.files",
    "asterism.detection.claimed_sizes",
    "asterism.detection.sources",
    "asterism.detection.times",
    "asterism.labelling.training.model_file",
    "asterism.labelling.training.model_schema",
    "asterism.labelling.training.people",
)
"""Modules that read and write files, what they say of them, and whose labels a file holds. They do not count, with what only they import,
where a row only reads: the values read do. A model is written and read by the same code; tests hold that it comes back as it was."""

READING_FUNCTIONS = {
    "asterism.recording.marker_set": ("MarkerSet.load", "MarkerSet.from_toml"),
    "asterism.calibration.boards.board": ("Board.from_toml", "_caliscope_square"),
    "asterism.labelling.training.model_state": (
        *("ModelState.load", "_marker_set", "_certainty", "_label_calibration", "_solvers"),
        *("_with_prefix", "_body", "_two_curves", "_finite", "_check_shapes"),
    ),
}
"""Functions that read files, in modules that do something else too; they do not count either."""

ABOUT_FILES = {("labelling", "conformance"), ("labelling", "physical"), ("recordings", "loop"), ("cameras", "rig-files")}
"""Rows about reading and writing, for which readers count as other modules do; as for all of the chapters in `CHAPTERS_ABOUT_FILES`."""

CHAPTERS_ABOUT_FILES = ("house", "hostile")

DATA_OF = {
    "asterism.recording.marker_set": tuple(
        f"src/asterism/marker_sets/{name}.toml" for name in ("helen-hayes", "oxford-foot", "plug-in-gait")
    ),
    "asterism.report.page": ("src/asterism/report/templates/",),
}
"""Files of the package that a module reads. Of the marker sets those that rows name: what else is shipped changes no figure."""

BEYOND_IMPORTS = {
    ("house", "structure"): ("src/",),
    ("house", "reference"): ("src/", "docs/reference/"),
    ("house", "kernels"): ("tests/deciding_kernels.py",),
    ("house", "faults"): (
        *(f"src/asterism/{room}/" for room in ("labelling", "reconstruction", "cameras", "formats")),
        "benchmarks/faults.json",
        "tools/faults.py",
    ),
    ("house", "startup"): ("src/asterism/cli/", "src/asterism/formats/", "src/asterism/recording/"),
    ("house", "install"): ("src/", "pyproject.toml"),
    ("house", "ci"): ("src/", "tests/", ".ci/", "pyproject.toml"),
    ("house", "ci-fresh"): ("src/", "tests/", ".ci/", "pyproject.toml"),
}
"""What rows read or start without importing it."""

Symbol = tuple[str, str | None]
"""A module and a name in it; None for the module itself."""


@dataclass(frozen=True)
class Folder:
    """A folder of recordings: hashes of the names and sizes of its files, and of the values that the readers give of them."""

    index: str
    values: str


@dataclass(frozen=True)
class Module:
    """A parsed file: the statements that bind each name at its top level, where imported names come from, and what else is executed."""

    tree: ast.Module
    package: bool
    bound: Mapping[str, list[ast.stmt]]
    imported: Mapping[str, Symbol]
    handed_on: Mapping[str, Symbol]
    loose: list[ast.stmt]


class Sources:
    """All files of a state of the repository, by path."""

    def __init__(self, files: Mapping[str, bytes]) -> None:
        self.files = files
        self.paths = {_module_name(path): path for path in files if path.endswith(".py") and path.startswith(("src/", f"{BENCHMARKS}/"))}
        self._parsed: dict[str, Module] = {}
        self._imports: dict[str, set[str]] = {}
        self._closures: dict[tuple[str, bool], set[str]] = {}
        self._needs: dict[Symbol, list[Symbol]] = {}

    @classmethod
    def working(cls, root: Path = ROOT) -> Sources:
        """The files as they are on disk."""
        paths = (path for folder in FOLDERS for path in _files_in(root / folder))
        return cls({path.relative_to(root).as_posix(): path.read_bytes() for path in paths})

    @classmethod
    def at(cls, commit: str, root: Path = ROOT) -> Sources | None:
        """The files of a commit; None where git does not know it."""
        packed = subprocess.run(["git", "-C", str(root), "archive", commit], capture_output=True, check=False)
        if packed.returncode:
            return None
        with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
            found = ((member.name, archive.extractfile(member)) for member in archive.getmembers() if member.name.startswith(FOLDERS))
            return cls({name: file.read() for name, file in found if file is not None})

    def module(self, name: str) -> Module:
        """A module by name, parsed once."""
        if name not in self._parsed:
            path = self.paths[name]
            self._parsed[name] = _parse(self.files[path], path.endswith("__init__.py"))
        return self._parsed[name]

    def rows(self) -> dict[tuple[str, str], Symbol]:
        """(chapter, row) of the benchmark, with the function that measures it."""
        found: dict[tuple[str, str], Symbol] = {}
        for chapter in _dictionary(self.module(f"{BENCHMARKS}.__main__").bound["CHAPTERS"][0]):
            package = self.module(f"{BENCHMARKS}.{chapter}")
            for row, function in _dictionary(package.bound["ROWS"][0]).items():
                found[chapter, row] = package.imported[function]
        return found

    def measured_by(self, chapter: str, row: str) -> dict[str, str]:
        """Everything that a row measures, by name, with a hash of each: modules, functions of the benchmark, and other files."""
        readers = is_about_files(chapter, row)
        modules, symbols = self._followed(self.rows()[chapter, row], readers)
        found = self._hashes_of(modules, readers)
        for module, name in symbols:
            statements = self.module(module).bound[name] if name else self.module(module).loose
            found[f"{module}.{name}" if name else module] = _digest("".join(_canonical(statement) for statement in statements))
        others = (*BEYOND_IMPORTS.get((chapter, row), ()), *(path for name, paths in DATA_OF.items() if name in modules for path in paths))
        for path, content in self.files.items():
            if path.startswith(others):
                found[path] = _hash(content) if path.endswith(".py") else _digest(content.decode("latin-1"))
        return found

    def hash_of_module(self, module: str) -> str:
        """One hash of a module of the package and of all that it imports, without readers."""
        return _digest(_lines(self._hashes_of(self._imported_by(module, readers=False), readers=False)))

    def hash_of_readers(self) -> str:
        """One hash of all readers, of what they import, and of how their values are hashed."""
        starts = [name for name in self.paths if _is_reader(name)] + [name for name in READING_FUNCTIONS if name in self.paths]
        modules = {found for start in starts for found in self._imported_by(start, readers=True)}
        own = {name: _hash(self.files[self.paths[name]]) for name in ("benchmarks.read_values",) if name in self.paths}
        return _digest(_lines({**self._hashes_of(modules, readers=True), **own}))[:16]

    def recordings_of(self, chapter: str, row: str) -> set[str]:
        """The folders of recordings that a row's functions name; "" stands for all."""
        _, symbols = self._followed(self.rows()[chapter, row], is_about_files(chapter, row))
        statements = (statement for module, name in symbols if name for statement in self.module(module).bound[name])
        found = {folder for statement in statements for folder in _folders_named(statement)}
        return {""} if "" in found else found

    def _hashes_of(self, modules: Iterable[str], readers: bool) -> dict[str, str]:
        """The hash of each module of the package, with or without its functions that read files."""
        without = {} if readers else READING_FUNCTIONS
        return {name: _hash(self.files[self.paths[name]], without.get(name, ())) for name in modules}

    def _followed(self, start: Symbol, readers: bool) -> tuple[set[str], set[Symbol]]:
        """The package's modules and the benchmark's symbols that a function needs, directly or not; with or without readers."""
        modules: set[str] = set()
        symbols: set[Symbol] = set()
        waiting = [start]
        while waiting:
            for module, name in self._resolved(waiting.pop()):
                if _belongs(module, PACKAGE):
                    modules |= self._imported_by(module, readers)
                elif module not in BOOKKEEPING and (module, name) not in symbols:
                    symbols |= {(module, name), (module, None)}
                    if (module, name) not in self._needs:
                        self._needs[module, name] = list(self._needed_by(module, name))
                    waiting += self._needs[module, name]
        return modules, symbols

    def _needed_by(self, module: str, name: str | None) -> Iterator[Symbol]:
        """What a name's statements use. Annotations need nothing; an argument's annotation says whose methods are called."""
        of = self.module(module)
        for statement in (*(of.bound[name] if name else ()), *of.loose):
            types = _types_of_arguments(statement)
            for first, *attributes in _names_used(statement, annotations=False):
                if first in types and attributes:
                    kind = types[first]
                    home, known = of.imported.get(kind, (module, kind))
                    if home in self.paths and f"{known}.{attributes[0]}" in self.module(home).bound:
                        yield home, f"{known}.{attributes[0]}"
                elif first in of.bound:
                    yield module, first
                elif first in of.imported:
                    yield self._attribute(of.imported[first], attributes)

    def _imported_by(self, start: str, readers: bool) -> set[str]:
        """A module of the package and all that it imports, directly or not; with or without readers and what only they import."""
        if (start, readers) not in self._closures:
            found: set[str] = set()
            waiting = [start]
            while waiting:
                name = waiting.pop()
                if name not in found and (readers or not _is_reader(name)):
                    found.add(name)
                    waiting += self._direct_imports(name)
            self._closures[start, readers] = found
        return self._closures[start, readers]

    def _direct_imports(self, name: str) -> set[str]:
        if name not in self._imports:
            of = self.module(name)
            wanted = {self._attribute(symbol, ()) for symbol in of.imported.values() if symbol[0] in self.paths}
            if any(not attribute for _, attribute in wanted):  # whole modules: what is taken from them
                chains = [(of.imported[first], rest) for first, *rest in _names_used(of.tree) if first in of.imported]
                used = {self._attribute(symbol, rest) for symbol, rest in chains if symbol[0] in self.paths}
                wanted = {symbol for symbol in wanted if symbol[1]} | used
            self._imports[name] = {module for symbol in wanted for module, _ in self._resolved(symbol)}
        return self._imports[name]

    def _attribute(self, symbol: Symbol, attributes: Sequence[str]) -> Symbol:
        """What `labelling.audit.audit` is where `labelling` is this symbol: a name in the innermost module."""
        module, name = symbol
        parts = [*((name,) if name else ()), *attributes]
        while parts and f"{module}.{parts[0]}" in self.paths:
            module = f"{module}.{parts.pop(0)}"
        return module, parts[0] if parts else None

    def _resolved(self, symbol: Symbol) -> list[Symbol]:
        """Where a symbol is defined, through the packages that hand it on; nothing for foreign modules."""
        module, name = self._attribute((symbol[0], None), [symbol[1]] if symbol[1] else [])
        if module not in self.paths:
            return []
        of = self.module(module)
        if name is None:
            names = (*of.bound, *of.handed_on) if of.package or _belongs(module, BENCHMARKS) else ()
            return [found for known in names for found in self._resolved((module, known))] or [(module, None)]
        if name not in of.bound and name in of.handed_on:
            return self._resolved(of.handed_on[name])
        return [(module, name if name in of.bound else None)]


def is_about_files(chapter: str, row: str) -> bool:
    """Whether a row is about reading and writing files, so that readers count among its sources."""
    return (chapter, row) in ABOUT_FILES or chapter in CHAPTERS_ABOUT_FILES


def index_of(root: Path, folders: Iterable[str]) -> str:
    """The hash of the names and sizes of all files in some folders of the recordings."""
    files = sorted({path for folder in folders for path in _files_in(root / folder)})
    return _digest("\n".join(f"{path.relative_to(root).as_posix()} {path.stat().st_size}" for path in files))


def hash_of(sources: Sources, chapter: str, row: str, contents: Mapping[str, Folder]) -> str:
    """One hash of all that a row measures, of the recordings in the folders that it names included."""
    named = sources.recordings_of(chapter, row)
    held = {folder: own for folder, own in contents.items() if any(_within(folder, name) or _within(name, folder) for name in named)}
    about_files = is_about_files(chapter, row)
    recordings = {folder: own.index if about_files else f"{own.index} {own.values}" for folder, own in held.items()}
    return _digest(_lines(recordings) + _lines(sources.measured_by(chapter, row)))[:16]


def commit(root: Path = ROOT) -> str:
    """The commit of the sources, with "+" where they have changed since."""
    head, changed = (
        subprocess.run(["git", "-C", str(root), *words], capture_output=True, text=True, check=False).stdout.strip()
        for words in (("rev-parse", "--short=12", "HEAD"), ("status", "--porcelain", "--", "src", "benchmarks/*.py"))
    )
    return f"{head}+" if changed else head


def _files_in(place: Path) -> Iterator[Path]:
    if place.is_file():
        yield place
    for path in sorted(place.rglob("*")) if place.is_dir() else ():
        if path.is_file() and "__pycache__" not in path.parts:
            yield path


def _module_name(path: str) -> str:
    return path.removeprefix("src/").removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _belongs(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def _is_reader(module: str) -> bool:
    return any(_belongs(module, reader) for reader in READERS)


def _within(folder: str, other: str) -> bool:
    return not other or folder == other or folder.startswith(f"{other}/")


def _lines(hashes: Mapping[str, str]) -> str:
    return "".join(f"{name}={content}\n" for name, content in sorted(hashes.items()))


def _parse(content: bytes, package: bool) -> Module:
    tree = ast.parse(content)
    bound: dict[str, list[ast.stmt]] = {}
    loose: list[ast.stmt] = []
    for statement in tree.body:
        names = list(_names_bound(statement))
        for name in names:
            bound.setdefault(name, []).append(statement)
        if isinstance(statement, ast.ClassDef):
            bound.update((f"{statement.name}.{part.name}", [part]) for part in statement.body if isinstance(part, ast.FunctionDef))
        if not names and not isinstance(statement, ast.Import | ast.ImportFrom | ast.If) and not _is_docstring(statement):
            loose.append(statement)
    for name in ("__all__", "__getattr__", "__dir__"):
        bound.pop(name, None)
    for_types = {id(node) for statement in tree.body if _is_for_types(statement) for node in ast.walk(statement)}
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    at_run_time = dict(pair for node in imports if id(node) not in for_types for pair in _names_imported(node))
    return Module(tree, package, bound, at_run_time, dict(pair for node in imports for pair in _names_imported(node)), loose)


def _names_bound(statement: ast.stmt) -> Iterator[str]:
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
    elif isinstance(statement, ast.Assign | ast.AnnAssign | ast.AugAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        for target in targets:
            yield from (node.id for node in ast.walk(target) if isinstance(node, ast.Name))


def _names_imported(node: ast.Import | ast.ImportFrom) -> Iterator[tuple[str, Symbol]]:
    for alias in node.names:
        if isinstance(node, ast.ImportFrom):
            yield alias.asname or alias.name, (node.module or "", alias.name)
        else:
            yield alias.asname or alias.name.partition(".")[0], (alias.name if alias.asname else alias.name.partition(".")[0], None)


def _types_of_arguments(statement: ast.stmt) -> dict[str, str]:
    """The names of a function's arguments with those of their types, where these are plain names."""
    arguments = (node for node in ast.walk(statement) if isinstance(node, ast.arg))
    return {argument.arg: argument.annotation.id for argument in arguments if isinstance(argument.annotation, ast.Name)}


def _names_used(tree: ast.AST, annotations: bool = True) -> Iterator[list[str]]:
    """Names and chains of attributes, each as its parts: `a.b.c` gives a, b, c."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        parts: list[str] = []
        inner = node
        while isinstance(inner, ast.Attribute):
            parts.append(inner.attr)
            inner = inner.value
        if isinstance(inner, ast.Name):
            yield [inner.id, *parts[::-1]]
        else:
            skipped = () if annotations else (getattr(node, "annotation", None), getattr(node, "returns", None))
            waiting += (child for child in ast.iter_child_nodes(node) if child not in skipped)


def _folders_named(statement: ast.stmt) -> Iterator[str]:
    """The folders in `folder() / "cameras" / "selfcal"`, up to the first part that is no constant; "" for `folder()` alone."""
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop()
        parts: list[str | None] = []
        inner = node
        while isinstance(inner, ast.BinOp) and isinstance(inner.op, ast.Div):
            constant = isinstance(inner.right, ast.Constant) and isinstance(inner.right.value, str)
            parts.append(str(inner.right.value) if constant else None)  # type: ignore[attr-defined]
            inner = inner.left
        if isinstance(inner, ast.Call) and isinstance(inner.func, ast.Name) and inner.func.id == "folder":
            named = parts[::-1]
            yield "/".join(str(part) for part in (named[: named.index(None)] if None in named else named))
        else:
            waiting += ast.iter_child_nodes(node)


def _dictionary(statement: ast.stmt) -> dict[str, str]:
    """The keys of a dictionary of names, and the names."""
    value = statement.value if isinstance(statement, ast.Assign | ast.AnnAssign) else None
    if not isinstance(value, ast.Dict):
        raise ValueError("CHAPTERS and ROWS must be written as dictionaries of names")
    pairs = zip(value.keys, value.values, strict=True)
    return {str(key.value): node.id for key, node in pairs if isinstance(key, ast.Constant) and isinstance(node, ast.Name)}


def _is_for_types(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.If) and isinstance(statement.test, ast.Name) and statement.test.id == "TYPE_CHECKING"


def _is_docstring(statement: ast.AST) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str)


@cache
def _hash(content: bytes, without: tuple[str, ...] = ()) -> str:
    """The hash of a module's statements but for some functions and methods."""
    tree = ast.parse(content)
    holders: list[tuple[ast.Module | ast.ClassDef, str]] = [(tree, "")]
    holders += [(part, f"{part.name}.") for part in tree.body if isinstance(part, ast.ClassDef)]
    for holder, prefix in holders:
        holder.body = [part for part in holder.body if not (isinstance(part, ast.FunctionDef) and prefix + part.name in without)]
    return _digest(_canonical(tree))


def _canonical(node: ast.AST) -> str:
    """The tree as text, without places, docstrings and empty fields: the same for every version of Python."""
    parts = [type(node).__name__]
    for name, value in ast.iter_fields(node):
        if name in ("ctx", "kind", "type_comment") or value is None or value == []:
            continue
        if isinstance(value, list):
            shown = [_canonical(item) if isinstance(item, ast.AST) else repr(item) for item in value if not _is_docstring(item)]
            parts.append(f"{name}=[{','.join(shown)}]")
        else:
            parts.append(f"{name}={_canonical(value) if isinstance(value, ast.AST) else repr(value)}")
    return f"({' '.join(parts)})"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
