"""Extension of Sphinx: the house's docstrings in, reStructuredText out.

A docstring is plain text: paragraphs, code in single backticks, lists whose lines are `name   explanation`, indented blocks that stay as
they are, and examples behind `>>>`. Nothing else in it is markup, so every other character is escaped. Code that is one public name becomes
a link to where the name is described.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, get_origin

from docutils import nodes
from public_names import homes, places, public_modules
from sphinx import addnodes


def as_rst(docstring: str) -> str:
    """A docstring in reStructuredText."""
    return "\n\n".join(_paragraph(text.splitlines()) for text in re.split(r"\n\s*\n", docstring.strip("\n")))


def _paragraph(lines: list[str]) -> str:
    if lines and lines[0].lstrip().startswith(">>>"):
        return "\n".join(line.strip() if line.lstrip().startswith((">>>", "...")) else line for line in _dedented(lines))
    if lines and all(line.startswith("    ") for line in lines):
        return "::\n\n" + "\n".join(lines)
    return _list_or_text(lines)


def _dedented(lines: list[str]) -> list[str]:
    margin = min(len(line) - len(line.lstrip()) for line in lines)
    return [line[margin:] for line in lines]


def _list_or_text(lines: list[str]) -> str:
    """Lines of `name   text`, continued by indented lines, as a list; anything else as running text."""
    blocks: list[str] = []  # of running text, or of one entry of a list, which begins with a dash
    column = next((entry.start(2) for line in lines if (entry := _ENTRY.match(line))), 0)
    for line in lines:
        entry = _ENTRY.match(line) or _longest_name(line, column)
        inside = bool(blocks) and blocks[-1].startswith("- ")
        if line.startswith("- "):
            blocks.append(line)
        elif entry:
            blocks.append(f"- {_names(entry[1])}: {entry[2]}")
        elif blocks and inside == line.startswith(" "):
            blocks[-1] += "\n" + ("  " if inside else "") + line.strip()
        else:
            blocks.append(line.strip())
    return "\n\n".join(_inline(block) for block in blocks)


_ENTRY = re.compile(r"(\S(?:.*?\S)?) {2,}(\S.*)$")
"""A line of a list: what is explained, two blanks or more, and the explanation."""


def _longest_name(line: str, column: int) -> re.Match[str] | None:
    """The same for the longest name of a list, whose explanation stands in the column of the others behind a single blank."""
    return re.match(rf"(?=.{{{column - 1}}} \S)([\w., *]{{{column - 1}}}) (\S.*)$", line) if column > 1 and line[:1] != " " else None


def _names(text: str) -> str:
    """What stands before an explanation, as code where it is one name or several."""
    names = text.split(", ")
    return ", ".join(f"`{name}`" for name in names) if all(re.fullmatch(r"[\w.*]+", name) for name in names) else text


def _inline(text: str) -> str:
    """Code spans as literals or links, and all else without what reStructuredText would take for markup."""
    parts = re.split(r"(`[^`]+`)", text)
    shown = [_code(part[1:-1]) if part.startswith("`") else re.sub(r"([\\*|`]|_(?!\w))", r"\\\1", part) for part in parts]
    # markup ends where a blank or punctuation follows: `rotation`s needs an escaped blank between
    return "".join(part + ("\\ " if n % 2 and n + 1 < len(shown) and shown[n + 1][:1].isalnum() else "") for n, part in enumerate(shown))


def _code(code: str) -> str:
    known = places().get(code)
    return f":py:obj:`~{known}`" if known else f"``{code}``"


def convert(app: Any, what: str, name: str, thing: object, options: object, lines: list[str]) -> None:
    """Replace the lines of a docstring; called by autodoc for each name. A constant's docstring stands below it in the sources."""
    text = "\n".join(lines)
    if what == "data":
        text = _constant_docstring(name)
    lines[:] = as_rst(text).splitlines()


def keep_aliases(app: Any, config: Any) -> None:
    """Show the package's own aliases of types, such as `Floats`, as they are written; called when the settings are known."""
    public_modules()
    loaded = [module for name, module in sys.modules.items() if name.split(".")[0] == "asterism"]
    config.autodoc_type_aliases = {
        name: name
        for module in loaded
        for name, value in vars(module).items()
        if not isinstance(value, type) and (get_origin(value) is not None or isinstance(value, TypeVar))
    }


def plain_signature(
    app: Any, what: str, name: str, thing: object, options: object, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """A signature as one would write it: aliases by their names, and in place of long values three dots."""
    return _plain(signature), _plain(returned)


def _plain(text: str | None) -> str | None:
    if not text:
        return text
    text = re.sub(r"TypeAliasForwardRef\('([\w.]+)'\)", r"\1", text).replace("<factory>", "...")
    return _without_private(_RECORD.sub(r"\1(...)", text))


def _without_private(signature: str) -> str:
    """A signature without the fields of a record that begin with an underscore: they are not for callers."""
    if not signature.startswith("("):
        return signature
    parts, depth = [""], 0
    for letter in signature[1:-1]:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    return f"({', '.join(part.strip() for part in parts if part.strip() and not part.strip().startswith('_'))})"


_NESTED = r"(?:[^()]|\((?:[^()]|\([^()]*\))*\))+"
_RECORD = re.compile(rf"(?<== )([A-Z]\w+)\({_NESTED}\)")
"""A record with its fields as a default, such as `Rules(limit=2, search=Search(width=3))`."""


def link_names(app: Any, page: Any) -> None:
    """Make links of the public names that a page writes out in full as code; called with each page after it was parsed."""
    for code in list(page.findall(nodes.literal)):
        written = re.match(r"(asterism(?:\.\w+)*)\.(\w+)", code.astext())
        home = homes().get((written[1], written[2])) if written else None
        if home and written and not isinstance(code.parent, nodes.reference | addnodes.pending_xref):
            target = f"{home}.{written[2]}"
            link = addnodes.pending_xref("", refdomain="py", reftype="obj", reftarget=target, refexplicit=True, refwarn=True)
            code.replace_self(link)
            link += code


def skip(app: Any, what: str, name: str, thing: object, skipped: bool, options: object) -> bool | None:
    """Leave out what Python writes itself on the fields of named tuples; called by autodoc for each member."""
    return True if str(getattr(thing, "__doc__", "")).startswith("Alias for field number") else None


def _constant_docstring(full_name: str) -> str:
    """The string below a constant, in the module of the package that defines it."""
    module, _, name = full_name.rpartition(".")
    if name == "__version__":
        return "The installed version."
    package = sorted(known for known in sys.modules if known.split(".")[0] == "asterism" and getattr(sys.modules[known], "__file__", None))
    # the exporting module and what is below it first: another room may have a constant of the same name
    inside = [sys.modules[known] for known in sorted(package, key=lambda known: not known.startswith(module))]
    return next((found[name] for loaded in inside if name in (found := _documented_constants(loaded.__file__ or ""))), "")


@cache
def _documented_constants(file: str) -> dict[str, str]:
    """Constants of a file with the string below each; names that are assigned together share it."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body if file.endswith(".py") else []
    found = {}
    for statement, below in pairwise(body):
        targets = [statement.target] if isinstance(statement, ast.AnnAssign) else getattr(statement, "targets", [])
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant) and isinstance(below.value.value, str)
        for target in targets if is_text else ():
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            found.update({name.id: " ".join(below.value.value.split()) for name in names if isinstance(name, ast.Name)})
    return found


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.connect("config-inited", keep_aliases)
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("autodoc-process-docstring", convert)
    app.connect("autodoc-skip-member", skip)
    app.connect("doctree-read", link_names)
    return {"parallel_read_safe": True}
