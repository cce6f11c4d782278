"""Extension of Sphinx: the table of contents, and a page of the API reference for each room, made of what the room exports.

The pages in docs/ are read on the web pages of the repository, too. So they hold no directives: the tables of contents are added here when
the site is built. The pages of the reference are written to docs/reference/, and README.md and the like are copied to docs/: none of these
is under version control.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from public_names import exports, homes, modules_of, rooms
from sphinx.errors import ExtensionError

GUIDE = {
    "First steps": ["from-the-box", "commands", "process", "cluster", "cluster-slurm", "cluster-kubernetes", "python", "gallery/README"],
    "How it works": [
        "how-it-works",
        "labelling",
        "virtual-people",
        "recordings",
        "confidence",
        "cameras",
        "views",
        "live",
        "live-sources",
        "live-cameras",
        "live-outputs",
        "live-angles",
        "live-feedback",
        "garment",
        "motion",
        "characters",
        "opensim",
        "thesis",
    ],
    "Look it up": ["reference", "findings", "formats", "marker-sets", "conventions", "glossary"],
    "Figures": ["figures"],
    "Project": ["project/contributing", "project/changes", "project/security"],
}
BESIDE_DOCS = {
    "README.md": "index",
    "CONTRIBUTING.md": "project/contributing",
    "CHANGELOG.md": "project/changes",
    "SECURITY.md": "project/security",
}
"""Pages at the top of the repository, and where in docs/ their copies are; the site opens with the first."""


def contents(caption: str, pages: list[str]) -> str:
    """A table of contents in MyST, which the side bar shows."""
    return f"\n\n```{{toctree}}\n:hidden:\n:caption: {caption}\n:maxdepth: 1\n\n" + "\n".join(pages) + "\n```\n"


def add_contents(app: Any, page: str, source: list[str]) -> None:
    """Add the tables of contents to the first page and to that of the reference; called with each page before it is parsed."""
    for file, copy in BESIDE_DOCS.items():
        source[0] = source[0].replace(f"](../{file}", f"]({'../' * page.count('/')}{copy}.md")
    if page == "index":
        present = {path.relative_to(app.srcdir).with_suffix("").as_posix() for path in Path(app.srcdir).rglob("*.md")}
        source[0] += "".join(contents(caption, [name for name in pages if name in present]) for caption, pages in GUIDE.items())
    elif page == "reference":
        source[0] += contents("Rooms", [f"reference/{_file_name(room)}" for room in rooms()])


def write_pages(app: Any) -> None:
    """Write a page for each room, and copy those beside docs/."""
    docs = Path(app.srcdir)
    pages = {f"reference/{_file_name(room)}.rst": "\n".join(_page(room)) for room in rooms()}
    for file, copy in BESIDE_DOCS.items():
        pages[f"{copy}.md"] = _moved((docs.parent / file).read_text(encoding="utf-8"), to=copy)
    for old in (*docs.glob("reference/*"), *docs.glob("project/*")):
        if old.relative_to(docs).as_posix() not in pages:
            old.unlink()
    for name, text in pages.items():
        (docs / name).parent.mkdir(exist_ok=True)
        (docs / name).write_text(text, encoding="utf-8")


def _moved(text: str, to: str) -> str:
    """A page beside docs/ with the links that it has from its place in docs/."""
    for file, copy in BESIDE_DOCS.items():
        text = text.replace(f"]({file}", f"](docs/{copy}.md")
    up = "../" * to.count("/")
    return re.sub(r"\]\((?!\w+:|#)(docs/)?", lambda link: f"]({up}" if link[1] else f"](../{up}", text)


def _file_name(room: str) -> str:
    return room.partition(".")[2] or "asterism"


def _page(room: str) -> Iterator[str]:
    yield from _heading(room, "=")
    for module in modules_of(room):
        if module != room:
            yield from _heading(module, "-")
        # the module's docstring alone: its names follow one by one, so that a name which is missing ends the build
        yield from (f".. automodule:: {module}", "   :no-members:", "")
        elsewhere = [name for name in exports(module) if homes()[module, name] != module]
        if elsewhere:
            links = ", ".join(f":py:obj:`~{homes()[module, name]}.{name}`" for name in elsewhere)
            yield from (f"Described elsewhere: {links}.", "")
        for name in exports(module):
            if name not in elsewhere:
                yield from (f".. {_directive(module, name)}:: {module}.{name}", "")


def _heading(module: str, underline: str) -> Iterator[str]:
    yield from (module, underline * len(module), "")


def _directive(module: str, name: str) -> str:
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, BaseException) else "autoclass"
    return "autofunction" if inspect.isroutine(thing) else "autodata"


def ask_for_nothing_outside(app: Any, failure: Exception | None) -> None:
    """A page that loads a script, a style, a font or a picture from another server is an error; called when the site is built."""
    loads = re.compile(
        r"""<(?:script|img|iframe|source)\b[^>]*\bsrc\s*=\s*["']?(?:https?:)?//|<link\b[^>]*\bhref\s*=\s*["']?(?:https?:)?//|url\(["']?(?:https?:)?//"""
    )
    for page in sorted(Path(app.outdir).rglob("*.[hc][ts][ms]*")) if failure is None else ():
        if found := loads.search(page.read_text(encoding="utf-8")):
            raise ExtensionError(f"{page.relative_to(app.outdir)} loads something from outside: {found[0]}...")


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("builder-inited", write_pages)
    app.connect("source-read", add_contents)
    app.connect("build-finished", ask_for_nothing_outside)
    return {"parallel_read_safe": True}
