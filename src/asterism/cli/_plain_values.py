"""A command's parameters in; the same parameters, which convert what needs no checking without Pydantic and have help in words, out.

Releases of Typer that convert by Pydantic import it for the first parameter of any command: a third of the time that a short command
takes. Paths, texts and what is not given need no checking. All else goes Typer's way, which also words the errors.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args, get_origin

from typer.core import TyperCommand, TyperGroup


class PlainValuesCommand(TyperCommand):
    """A command of Typer; where Typer converts in another way than this file knows, it is no other than Typer's."""

    def get_params(self, ctx: Any) -> Any:
        """The command's parameters, `--help` among them."""
        return _taking_plain_values(super().get_params(ctx))


class PlainValuesGroup(TyperGroup):
    """A group of commands, whose own options are converted likewise."""

    def get_params(self, ctx: Any) -> Any:
        """The group's own parameters, `--help` among them."""
        return _taking_plain_values(super().get_params(ctx))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The commands by their headings (`rich_help_panel`), each with its whole first sentence: nothing is cut at the page's width."""
        headings: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if command is not None and not command.hidden:
                heading = getattr(command, "rich_help_panel", None)
                rows = headings.setdefault(heading if isinstance(heading, str) else "Commands", [])
                rows.append((name, command.get_short_help_str(10_000)))
        # The same columns under all headings, as of one list.
        width = max((len(name) for rows in headings.values() for name, _ in rows), default=0)
        for heading, rows in headings.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), text) for name, text in rows])


_CHECKED = ("exists", "writable", "resolve_path", "parser")
"""What a parameter may ask Typer to check or to do with its values: these are not plain."""


def _taking_plain_values(parameters: Any) -> Any:
    for parameter in parameters:
        _in_words(parameter)
        converter, wanted = getattr(parameter, "get_runtime_param", None), getattr(parameter, "type_descriptor", None)
        # another release of Typer: all goes its own way
        if converter is None or wanted is None or isinstance(converter, _Converter):
            continue
        if not any(getattr(wanted.parameter_info, check, None) for check in _CHECKED):
            parameter.get_runtime_param = _Converter(wanted.annotation, converter)
    return parameters


def _in_words(parameter: Any) -> None:
    """Have the help say nothing of types of Python, and ranges in words."""
    # what an argument is says its help; of options, the metavar and the choices
    if getattr(parameter, "param_type_name", "") == "argument":
        parameter.display_type_rich = lambda ctx: None
    low, high = getattr(parameter, "min", None), getattr(parameter, "max", None)
    ends = [f"{low:g}" if low is not None else "", f"{high:g}" if high is not None else ""]
    said = " to ".join(ends) if all(ends) else f"{ends[0]} or more" if ends[0] else f"{ends[1]} or less" if ends[1] else None
    parameter._get_number_range_help_str = lambda: said


class _Converter:
    """Stands for what Typer converts a parameter's values with, which is made only where it is needed."""

    def __init__(self, annotation: Any, converter: Callable[[], Any]) -> None:
        self.annotation, self.converter = annotation, converter

    def __call__(self) -> _Converter:
        return self

    def coerce(self, value: Any, **where: Any) -> Any:
        """The value as the parameter's type; where: the parameter and its context."""
        try:
            return as_plain(value, self.annotation)
        except TypeError:
            return self.converter().coerce(value, **where)


def as_plain(value: Any, annotation: Any) -> Any:
    """A value as a path, a text, a list of paths, or None; TypeError where it is or should be something else."""
    if get_origin(annotation) is list and isinstance(value, list | tuple) and value:
        return [as_plain(item, get_args(annotation)[0]) for item in value]
    # not given, and no default: Typer has checked by now that this may be
    if annotation in (Path, str, int, float, bool) and value is None:
        return None
    if annotation is Path and isinstance(value, str | Path):
        return Path(value)
    if annotation is str and type(value) is str:
        return value
    raise TypeError
