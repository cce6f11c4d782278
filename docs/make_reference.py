"""Writes docs/reference/: the API reference, made of the installed package's signatures and docstrings.

    python docs/make_reference.py

A name is public if the `__all__` of a public package lists it, or the `__all__` of a room that is one module. A package is public
if no part of its dotted name begins with an underscore. `asterism.cli` exports nothing: its interface is the command line. One page
describes one room with all its subpackages. A name that several packages export is described in the deepest
of them; the others refer to it.
"""

from __future__ import annotations

import ast
import dataclasses
import enum
import importlib
import inspect
import pkgutil
import re
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import asterism

FOLDER = Path(__file__).with_name("reference")
GLOSSARY = Path(__file__).with_name("glossary.md")
PACKAGE = Path(asterism.__file__).parent
NOT_PYTHON = ("asterism.cli",)
WIDTH = 110
EVERYDAY = (
    "event finding frame gap label labelling marker missed mount ray recording right "
    "room rules seed settings subject trial vertical vote world"
)
"""Glossary terms that are too frequent to be linked."""


def public_modules() -> list[str]:
    """The dotted names of `asterism`, of its rooms and of their public subpackages, each before what is below it."""
    found = ["asterism"]
    for module in pkgutil.walk_packages(asterism.__path__, "asterism."):
        is_room = module.name.count(".") == 1
        hidden = any(part.startswith("_") for part in module.name.split("."))
        if not hidden and not module.name.startswith(NOT_PYTHON) and (module.ispkg or is_room):
            found.append(module.name)
    return found


def exports(module: str) -> list[str]:
    """What a public module exports, in alphabetical order; empty where it has no `__all__`."""
    return sorted(getattr(importlib.import_module(module), "__all__", ()), key=str.lower)


def homes() -> dict[int | tuple[str, str], str]:
    """For each exported object the module in whose section it is described: the deepest one that exports it."""
    found: dict[int | tuple[str, str], str] = {}
    for module in public_modules():
        for name in exports(module):
            key = _key(module, name)
            if key not in found or module.count(".") > found[key].count("."):
                found[key] = module
    return found


@cache
def pages() -> dict[str, str]:
    """The text of each page by its file's name."""
    modules = public_modules()
    described = homes()
    rooms = [module for module in modules if module.count(".") <= 1 and (exports(module) or _below(module, modules))]
    made = {}
    for room in rooms:
        parts = [room, *(_below(room, modules) if room != "asterism" else [])]
        text = "\n".join(part for module in parts for part in _section(module, described))
        made[page_of(room)] = f"# `{room}`\n\n{_notice()}\n\n{text}"
    made["index.md"] = _index(rooms, modules, described)
    return {name: re.sub(r"\n{3,}", "\n\n", text).rstrip() + "\n" for name, text in made.items()}


def _below(room: str, modules: list[str]) -> list[str]:
    return [module for module in modules if module.startswith(room + ".") and exports(module)]


def page_of(module: str) -> str:
    """The name of the page that describes a module."""
    return (module.split(".")[1] if "." in module else "asterism") + ".md"


def _key(module: str, name: str) -> int | tuple[str, str]:
    """What tells an exported object from others: constants and aliases go by name, for equal ones may be one object."""
    thing = getattr(importlib.import_module(module), name)
    return id(thing) if inspect.isclass(thing) or inspect.isroutine(thing) or hasattr(thing, "py_func") else ("constant", name)


def _notice() -> str:
    return "Written by `python docs/make_reference.py` from the docstrings; do not edit. [All names](index.md)."


def _index(rooms: list[str], modules: list[str], described: dict[Any, str]) -> str:
    lines = ["# API reference", "", "Written by `python docs/make_reference.py` from the docstrings; do not edit.", ""]
    lines += ["A name that is not listed here is private and may change without notice. [Conventions](../conventions.md) says what"]
    lines += ["arrays mean, the [glossary](../glossary.md) what words mean.", "", "| module | what it is | names |", "|---|---|---|"]
    for room in rooms:
        for module in [room, *(_below(room, modules) if room != "asterism" else [])]:
            names = ", ".join(f"[{name}]({_place(module, name, described)})" for name in exports(module))
            lines.append(f"| `{module}` | {_first_sentence(importlib.import_module(module))} | {names} |")
    return "\n".join(lines)


def _place(module: str, name: str, described: dict[Any, str]) -> str:
    home = described[_key(module, name)]
    return f"{page_of(home)}#{_anchor(home, name)}"


def heading(module: str, name: str) -> str:
    """Classes are headed as such: the anchors of `Capturability` and `capturability` would else be the same."""
    kind = "class " if inspect.isclass(getattr(importlib.import_module(module), name)) else ""
    return f"{kind}`{module}.{name}`"


def _anchor(module: str, name: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading(module, name).lower()).replace(" ", "-")


def _first_sentence(thing: object) -> str:
    return _inline((inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " "))


def _section(module: str, described: dict[Any, str]) -> Iterator[str]:
    loaded = importlib.import_module(module)
    if "." in module and module.count(".") > 1:
        yield f"## `{module}`\n"
    yield prose(inspect.getdoc(loaded) or "")
    for name in exports(module):
        yield f"### {heading(module, name)}\n"
        home = described[_key(module, name)]
        if home != module:
            yield f"See [`{home}.{name}`]({page_of(home)}#{_anchor(home, name)}).\n"
        else:
            yield from _entry(loaded, name)


def _entry(module: ModuleType, name: str) -> Iterator[str]:
    thing = getattr(module, name)
    if inspect.isclass(thing):
        yield from _class(thing)
    elif callable(thing) and (inspect.isroutine(thing) or hasattr(thing, "py_func")):
        yield _fenced(signature(thing, name))
        yield prose(inspect.getdoc(thing) or "") + _source(thing)
    else:
        value = repr(thing).replace("numpy.", "np.") if not isinstance(thing, dict) else f"{{{', '.join(map(repr, thing))}}}"
        if not name.startswith("__"):
            yield _fenced(textwrap.shorten(f"{name} = {value}", WIDTH, placeholder=" ..."))
        yield prose("The installed version." if name == "__version__" else _constant_docstring(module, name))


def _class(thing: type) -> Iterator[str]:
    if issubclass(thing, enum.Enum):
        yield _fenced(f"class {thing.__name__}: " + ", ".join(member.name for member in thing))
    elif issubclass(thing, Exception) or getattr(thing, "_is_protocol", False):
        yield _fenced(f"class {thing.__name__}({thing.__mro__[1].__name__})")
    else:
        yield _fenced(signature(thing, thing.__name__))
    yield prose(inspect.getdoc(thing) or "") + _source(thing)
    fields = _field_docstrings(thing)
    if fields:
        yield "\n".join(f"- `{name}`: {_inline(' '.join(text.split()))}" for name, text in fields.items()) + "\n"
    for name, member in vars(thing).items():
        if name.startswith("_") or not (
            inspect.isroutine(member) or isinstance(member, (property, classmethod, staticmethod)) or _is_cached(member)
        ):
            continue
        yield from _member(thing, name, member)


def _is_cached(member: object) -> bool:
    return type(member).__name__ == "cached_property"


def _member(thing: type, name: str, member: Any) -> Iterator[str]:
    if isinstance(member, property) or _is_cached(member):
        function = member.fget if isinstance(member, property) else member.func
        kind = inspect.signature(function).return_annotation
        yield f"#### `.{name}`" + (f" : `{kind}`" if isinstance(kind, str) else "") + "\n"
        yield prose(inspect.getdoc(function) or "")
        return
    function = member.__func__ if isinstance(member, (classmethod, staticmethod)) else member
    owner = thing.__name__ if isinstance(member, (classmethod, staticmethod)) else ""
    yield f"#### `.{name}()`\n"
    yield _fenced(signature(getattr(thing, name) if owner else function, f"{owner}.{name}", without_self=not owner))
    yield prose(inspect.getdoc(function) or "")


def signature(thing: Any, name: str, without_self: bool = False) -> str:
    """A call as a reader writes it: on one line where it fits, else a parameter a line."""
    form = inspect.signature(getattr(thing, "py_func", thing))
    parameters = list(form.parameters.values())[1 if without_self else 0 :]
    words: list[str] = []
    for before, parameter in zip([None, *parameters], parameters, strict=False):
        if parameter.kind is parameter.KEYWORD_ONLY and (
            before is None or before.kind not in (parameter.KEYWORD_ONLY, parameter.VAR_POSITIONAL)
        ):
            words.append("*")
        words.append(_parameter(parameter))
    result = "" if inspect.isclass(thing) or form.return_annotation is form.empty else f" -> {_annotation(form.return_annotation)}"
    line = f"{name}({', '.join(words)}){result}"
    return line if len(line) <= WIDTH else f"{name}(\n" + "".join(f"    {word},\n" for word in words) + f"){result}"


def _parameter(parameter: inspect.Parameter) -> str:
    stars = {parameter.VAR_POSITIONAL: "*", parameter.VAR_KEYWORD: "**"}.get(parameter.kind, "")
    text = stars + parameter.name
    if parameter.annotation is not parameter.empty:
        text += f": {_annotation(parameter.annotation)}"
    if parameter.default is not parameter.empty:
        text += f" = {_default(parameter.default)}"
    return text


def _annotation(annotation: object) -> str:
    return annotation if isinstance(annotation, str) else inspect.formatannotation(annotation)


def _default(value: Any) -> str:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        try:
            plain = value == type(value)()
        except (TypeError, ValueError):
            plain = False
        return f"{type(value).__name__}({'' if plain is True else '...'})"
    if callable(value) and hasattr(value, "__name__"):
        return value.__name__
    if type(value).__name__ == "_HAS_DEFAULT_FACTORY_CLASS":
        return "..."
    shown = repr(value)
    return shown if len(shown) <= 40 and " at 0x" not in shown else "..."


def prose(docstring: str) -> str:
    """A docstring as Markdown: paragraphs; an aligned list of arguments becomes bullets; indented text stays as it is."""
    parts = []
    for paragraph in re.split(r"\n\s*\n", docstring):
        lines = paragraph.splitlines()
        if lines and all(line.startswith("    ") for line in lines):
            parts.append(_fenced(textwrap.dedent(paragraph), "text").rstrip())
        else:
            parts.append(_bullets(lines))
    return _linked("\n\n".join(parts)) + "\n"


def _bullets(lines: list[str]) -> str:
    """Lines of `name   text`, continued by indented lines, as bullets; anything else as it is."""
    shown: list[str] = []
    inside = False
    for line in lines:
        entry = re.match(r"(\S(?:.*?\S)?) {2,}(\S.*)$", line) or (inside and re.match(r"([a-z]+_\w+) (\S.*)$", line))
        if entry and not line.startswith(" "):
            if shown and not inside:
                shown.append("")
            shown.append(f"- {_names(entry[1])}: {_inline(entry[2])}")
            inside = True
        elif inside and line.startswith(" "):
            shown.append("  " + _inline(line.strip()))
        else:
            if inside:
                shown.append("")
            inside = False
            shown.append(_inline(line))
    return "\n".join(shown)


def _names(text: str) -> str:
    """What stands before an explanation: as code where it is one name or several."""
    names = text.split(", ")
    return ", ".join(f"`{name}`" for name in names) if all(re.fullmatch(r"[\w.*]+", name) for name in names) else f"**{_inline(text)}**"


def _inline(text: str) -> str:
    """Text outside code spans, without what Markdown would take for markup."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else re.sub(r"([*_<\[\]|])", r"\\\1", part) for part in parts)


@cache
def _terms() -> dict[str, str]:
    found = re.findall(r"^### (.+)$", GLOSSARY.read_text(encoding="utf-8"), re.MULTILINE)
    return {
        term: re.sub(r"[^\w\- ]", "", term.lower()).replace(" ", "-")
        for term in sorted(found, key=len, reverse=True)
        if term not in EVERYDAY.split()
    }


def _linked(text: str) -> str:
    """The first occurrence of each term of the glossary leads there."""
    parts = re.split(r"(```.*?```|`[^`]*`)", text, flags=re.DOTALL)
    for term, anchor in _terms().items():
        pattern = re.compile(rf"(?<![\w\[/#-])({re.escape(term)}s?)(?![\w\]-])", re.IGNORECASE)
        for number, part in enumerate(parts):
            if not part.startswith("`") and pattern.search(part):
                before, after = pattern.split(part, maxsplit=1)[0], pattern.split(part, maxsplit=1)[2]
                found = pattern.search(part)
                parts[number : number + 1] = [before, f"`\0`[{found[1] if found else term}](../glossary.md#{anchor})", after]
                break
    return "".join(parts).replace("`\0`", "")


def _fenced(text: str, language: str = "python") -> str:
    return f"```{language}\n{text}\n```\n"


def _source(thing: Any) -> str:
    file = inspect.getsourcefile(inspect.unwrap(getattr(thing, "py_func", thing)))
    if not file or not Path(file).is_relative_to(PACKAGE):
        return ""
    place = Path(file).relative_to(PACKAGE).as_posix()
    return f"\n[Source: `{place}`](../../src/asterism/{place})\n"


@cache
def _tree(file: str) -> ast.Module:
    return ast.parse(Path(file).read_text(encoding="utf-8"))


def _after_assignment(body: list[ast.stmt]) -> dict[str, str]:
    """The string literals that stand right below an assignment, by the name assigned."""
    found = {}
    for statement, below in pairwise(body):
        target = (
            statement.target
            if isinstance(statement, ast.AnnAssign)
            else statement.targets[0]
            if isinstance(statement, ast.Assign)
            else None
        )
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
        if isinstance(target, ast.Name) and is_text:
            found[target.id] = inspect.cleandoc(below.value.value)
    return found


def _field_docstrings(thing: type) -> dict[str, str]:
    file = inspect.getsourcefile(thing)
    nodes = ast.walk(_tree(file)) if file and Path(file).is_relative_to(PACKAGE) else ()
    return next((_after_assignment(node.body) for node in nodes if isinstance(node, ast.ClassDef) and node.name == thing.__name__), {})


def _constant_docstring(module: ModuleType, name: str) -> str:
    """The string below a constant, in the package's module that defines it."""
    prefix = module.__name__ if hasattr(module, "__path__") else module.__name__.rpartition(".")[0]
    for loaded in [module, *(m for n, m in sorted(sys.modules.items()) if n.startswith(prefix) and m is not None)]:
        found = _after_assignment(_tree(loaded.__file__).body) if getattr(loaded, "__file__", None) else {}
        if name in found:
            return found[name]
    return ""


def main() -> None:
    """Write all pages, and remove those of rooms that are no more."""
    FOLDER.mkdir(exist_ok=True)
    made = pages()
    for old in FOLDER.glob("*.md"):
        if old.name not in made:
            old.unlink()
    for name, text in made.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    print(f"{len(made)} pages in {FOLDER}")


if __name__ == "__main__":
    main()
