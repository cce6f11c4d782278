"""A file in; its bytes, its text, its lines, cells and numbers out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from asterism.errors import AsterismError, guarded_reading

_MISSING = {"", "na", "n/a", "#n/a", "null", "none", "-", "--", "nan", "-nan", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind", "1.#ind"}
_EXCEL_SEPARATOR = re.compile(r'(?i)"?sep=."?[;,]*\s*')
_LONGEST_CELL = 1000
LATIN, EUROPEAN, JAPANESE = "latin-1", ("cp1252", "cp1250"), "cp932"
"""Latin-1 reads every byte; Windows' encodings have signs and letters where that has control characters; Windows' form of Shift-JIS."""
_EUROPEAN_SIGNS = "’–—°²³µ·®™§"
_RUN_OF_FOREIGN = re.compile(rb"[\x80-\xff]{3}")
_JAPANESE_LEAD = re.compile(rb"[\x81-\x9f]")
_FORMULA = ("=", "+", "-", "@")
"""How a cell begins that spreadsheets run."""
_NUMBER = re.compile(r"[+-]?(\d++(\.\d*+)?|\.\d++)(e[+-]?\d++)?|[+-]?inf(inity)?|[+-]?nan", re.IGNORECASE)
"""Digits are never given back (`++`), so that a long cell takes time with its length, not with its square."""


def read_bytes(path: Path) -> bytes:
    """The whole file. Raises AsterismError where it cannot be read or is empty."""
    with guarded_reading(path):
        data = path.read_bytes()
    # Blocks of zeros are what a broken copy leaves.
    if not data.strip(b"\x00 \t\r\n"):
        raise AsterismError(f"{path} is empty; export it again.")
    return data


def decoded(path: Path, data: bytes) -> str:
    """The text of a file: UTF-8 or UTF-16 with its mark, else what `encoding_of` says, else Latin-1. Raises AsterismError for no text."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", errors="replace")
    # A zero byte is in no text but UTF-16.
    if b"\x00" in data[:4096]:
        raise AsterismError(f"{path} is not a text file; if it is a C3D, MAT or NPZ file, give it that suffix.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Where no encoding fits, names may be wrong, numbers are not.
        return data.decode(encoding_of([data]) or LATIN, errors="replace")


def encoding_of(texts: Iterable[bytes]) -> str | None:
    """The encoding that texts which are no UTF-8 share: Windows' for the West or the middle of Europe, or Shift-JIS; None where none fits.

    European text has single accented letters or signs among plain letters. In Shift-JIS the first byte of most characters is one from
    0x81 to 0x9F, which is no letter in Europe, mostly. Chinese, Korean and Cyrillic encodings have neither.
    """
    foreign = [text for text in texts if not text.isascii()]
    # Three accented letters in a row are a word of another script.
    for encoding in () if any(_RUN_OF_FOREIGN.search(text) for text in foreign) else EUROPEAN:
        text = "".join(text.decode(encoding, errors="replace") for text in foreign)
        if all(sign.isascii() or (sign.isalpha() and sign != "ƒ") or sign in _EUROPEAN_SIGNS for sign in text):
            return encoding
    for cut in (0, 1):
        # A field of fixed width may end within a character.
        try:
            japanese = "".join(text[: len(text) - cut].decode(JAPANESE) for text in foreign)
        except UnicodeDecodeError:
            continue
        if any(_JAPANESE_LEAD.search(text) for text in foreign) and not any("\ue000" <= sign <= "\uf8ff" for sign in japanese):
            return JAPANESE
    return None


def lines_of(text: str) -> list[str]:
    """Lines without their ends, whichever of CRLF, LF and CR the file uses. A first line `sep=;`, by which Excel reads, becomes empty."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return ["", *lines[1:]] if _EXCEL_SEPARATOR.fullmatch(lines[0]) else lines


def delimiter_of(line: str) -> str | None:
    """What separates the cells of a line: tab, semicolon or comma; None is any blank."""
    # A tab decides before a semicolon, and that before a comma: decimals have commas.
    for candidate in "\t;,":
        if candidate in line:
            return candidate
    return None


def cell_text(name: str) -> str:
    """A name as a cell of a spreadsheet that shows it: one that begins like a formula gets an apostrophe before it."""
    return f"'{name}" if name.startswith(_FORMULA) else name


def name_of_cell(cell: str) -> str:
    """The inverse of `cell_text`."""
    return cell[1:] if len(cell) > 1 and cell[0] == "'" and cell[1] in _FORMULA else cell


def cells_of(line: str, delimiter: str | None) -> list[str]:
    """The cells of a line, without surrounding blanks and quotes. Raises AsterismError where one is too long to be a cell."""
    cells = _split(line, delimiter)
    longest = max(map(len, cells), default=0)
    # A damaged line would end up as a name in every message.
    if longest > _LONGEST_CELL:
        begins = max(cells, key=len)[:20]
        raise AsterismError(f"a cell that begins {begins!r} has {longest:,} characters, which is no name or number; find and correct it.")
    return [name_of_cell(cell) for cell in cells] if "'" in line else cells


def _split(line: str, delimiter: str | None) -> list[str]:
    if delimiter is None:
        return line.split()
    if '"' in line:
        import csv

        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
        except csv.Error:  # a cell of more than 131,072 characters: as if it had no quotes, and whoever reads it names the place
            pass
    return [cell.strip() for cell in line.split(delimiter)]


def some_of(names: Sequence[str], most: int = 5) -> str:
    """The first few names, each cut to a readable length, for a message."""
    short = [name if len(name) <= 40 else name[:37] + "..." for name in names[:most]]
    return ", ".join(short) + (", ..." if len(names) > most else "") if short else "none"


def number_of(cell: str) -> float | None:
    """A number in any common spelling, NaN for a spelling of missing, None for anything else. A single comma is a decimal sign."""
    cell = cell.strip().strip('"').strip()
    if cell.casefold() in _MISSING:
        return float("nan")
    # The cell is cut out already, so that its comma separates no cells.
    if cell.count(",") == 1 and "." not in cell and cell[-1] != ",":
        cell = cell.replace(",", ".")
    return float(cell) if _NUMBER.fullmatch(cell) else None
