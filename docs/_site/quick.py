"""Extension of Sphinx: what no page shows is not worked out, and what is asked a thousand times is looked up once.

Everything here leaves the pages as they are. `searchable`, a setting, says whether they can be searched; a build that nobody reads needs no
index of its words.
"""

from __future__ import annotations

from typing import Any

from sphinx.domains.python import PythonDomain
from sphinx.pycode.parser import Parser


def _no_definitions(self: Parser) -> None:
    """Where each definition begins and ends is for pages that show sources. To find it is an eighth of a build."""


def _once(find: Any) -> Any:
    """`PythonDomain.find_obj`, which looks through all objects for a name: once for each name, while there are no more objects."""
    found: dict[tuple[Any, ...], Any] = {}

    def find_obj(self: PythonDomain, env: Any, *asked: Any, **named: Any) -> Any:
        key = (id(self), len(self.objects), asked, *sorted(named.items()))
        if key not in found:
            found[key] = find(self, env, *asked, **named)
        # Who asked may change the list.
        return list(found[key])

    return find_obj


def _without_search(app: Any) -> None:
    if not app.config.searchable:
        app.builder.search = False


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    if hasattr(Parser, "parse_definition"):
        Parser.parse_definition = _no_definitions  # type: ignore[method-assign]
    PythonDomain.find_obj = _once(PythonDomain.find_obj)  # type: ignore[method-assign]
    app.add_config_value("searchable", True, "env", [bool])
    app.connect("builder-inited", _without_search)
    return {"parallel_read_safe": True}
