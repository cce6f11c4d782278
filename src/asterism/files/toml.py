"""Plain values in, TOML text out: what the standard library reads but does not write."""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from asterism.errors import AsterismError, guarded_reading
from asterism.files.text import decoded, read_bytes

_WIDTH = 120

_TEXTS = re.compile(r"""\"{3}.*?\"{3}|'{3}.*?'{3}|"(?:\\.|[^"\\\n])*+"|'[^'\n]*+'|\#[^\n]*+""", re.DOTALL)
_DEEP_KEY = re.compile(r"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){64}")
"""A key of more than 64 parts: ours have three, and the standard library's time goes with the square of their number."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises AsterismError where it is not TOML, or breaks off."""
    with guarded_reading(path, "write it again"):
        try:
            return tables_of_toml(decoded(path, read_bytes(path)))
        except ValueError as problem:
            raise AsterismError(f"{path} is damaged: it is no TOML ({problem}); write it again.") from problem


def tables_of_toml(text: str) -> dict[str, Any]:
    """The tables of a text.

    Raises ValueError where it is not TOML, or a key has more than 64 parts; RecursionError where it nests too deeply.
    """
    if _DEEP_KEY.search(_TEXTS.sub("s", text)):
        raise ValueError("a key has more than 64 parts")
    return tomllib.loads(text)


def toml_line(key: str, value: Any) -> str:
    """One `key = value`; floats keep their bits. Values are plain (numbers, texts, lists, mappings, None left out) or NumPy's."""
    text = f"{_key(key)} = {_value(value)}"
    # Long lists of lists have a line for each: matrices stay readable.
    if len(text) > _WIDTH and isinstance(value, list) and value and isinstance(value[0], list | str):
        text = f"{_key(key)} = [\n" + "".join(f"    {_value(item)},\n" for item in value) + "]"
    return text


def _key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else toml_text(key)


def _value(value: Any) -> str:
    # NumPy's values become Python's.
    if hasattr(value, "tolist"):
        value = value.tolist()
    # Before the numbers: True is an int to Python.
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        # repr gives the shortest text with the same bits.
        return repr(value) if math.isfinite(value) else "nan" if math.isnan(value) else f"{'-' if value < 0 else ''}inf"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(str(k))} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value if item is not None) + "]"
    return toml_text(str(value))


def toml_text(text: str) -> str:
    """A text in quotes, as TOML reads it back."""
    # JSON's escapes are TOML's, but for this one.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
