"""The installed package in; its public modules, and in which of them each public name is described, out.

A name is public if the `__all__` of a public package lists it, or the `__all__` of a room that is one module. A package is public if no
part of its dotted name begins with an underscore. `asterism.cli` exports nothing: its interface is the command line; nor does
`asterism.files`, on which the rooms stand.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache

import asterism

NOT_OFFERED = ("asterism.cli", "asterism.files")


@cache
def public_modules() -> tuple[str, ...]:
    """The dotted names of `asterism`, of its rooms and of their public subpackages, each before what is below it."""
    found = ["asterism"]
    for module in pkgutil.walk_packages(asterism.__path__, "asterism."):
        is_room = module.name.count(".") == 1
        hidden = any(part.startswith("_") for part in module.name.split("."))
        if not hidden and not module.name.startswith(NOT_OFFERED) and (module.ispkg or is_room):
            found.append(module.name)
    return tuple(found)


def exports(module: str) -> list[str]:
    """What a public module exports, in alphabetical order; empty where it has no `__all__`."""
    return sorted(getattr(importlib.import_module(module), "__all__", ()), key=str.lower)


def modules_of(room: str) -> list[str]:
    """A room and its public subpackages, those that export something; for `asterism` the front door alone."""
    below = [module for module in public_modules() if module.startswith(room + ".") and room != "asterism"]
    return [module for module in (room, *below) if exports(module)]


@cache
def rooms() -> tuple[str, ...]:
    """The front door and the rooms that export something, themselves or in a subpackage."""
    return tuple(module for module in public_modules() if module.count(".") <= 1 and modules_of(module))


@cache
def homes() -> dict[tuple[str, str], str]:
    """For each (module, name) the module that describes the name: the deepest one that exports the same object."""
    deepest: dict[object, str] = {}
    for module in public_modules():
        for name in exports(module):
            key = _identity(module, name)
            if key not in deepest or module.count(".") > deepest[key].count("."):
                deepest[key] = module
    return {(module, name): deepest[_identity(module, name)] for module in public_modules() for name in exports(module)}


@cache
def places() -> dict[str, str]:
    """The full name of each public name that is described once only; names that mean several things are left out."""
    found: dict[str, set[str]] = {}
    for (_, name), home in homes().items():
        found.setdefault(name, set()).add(f"{home}.{name}")
    return {name: next(iter(full)) for name, full in found.items() if len(full) == 1}


def _identity(module: str, name: str) -> object:
    """What tells an exported object from others: constants and aliases go by name, for equal ones may be one object."""
    thing = getattr(importlib.import_module(module), name)
    return id(thing) if inspect.isclass(thing) or inspect.isroutine(thing) else name
