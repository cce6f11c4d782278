"""Rows of numbers in; a CSV or Parquet file, or a data frame of pandas, out."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from asterism.errors import AsterismError
from asterism.files.atomic import utf8, write_atomically

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class NumberTable:
    """A table: the type of each column by its name, str, int or float, and the rows, None where a cell has nothing.

    The column "kind" says what a row is.
    """

    columns: Mapping[str, type]
    rows: tuple[tuple[Any, ...], ...]

    def of(self, *kinds: str) -> NumberTable:
        """The rows of these kinds."""
        at = list(self.columns).index("kind")
        return NumberTable(self.columns, tuple(row for row in self.rows if row[at] in kinds))

    def to_dataframe(self) -> pandas.DataFrame:
        """The table for pandas. Needs pandas, which Asterism does not install; raises AsterismError where it is missing."""
        try:
            import pandas
        except ImportError:
            raise AsterismError("a data frame needs pandas; install it with `pip install pandas`.") from None
        kinds = {name: {int: "Int64", str: "str", float: "float64"}[kind] for name, kind in self.columns.items()}
        return pandas.DataFrame(list(self.rows), columns=list(self.columns)).astype(kinds)

    def write(self, path: str | Path) -> None:
        """Write it whole or not at all, as CSV or Parquet by the end of its name.

        Raises AsterismError for another name, for Parquet where pyarrow is missing, and where the file cannot be written.
        """
        path = Path(path)
        check_table(path)
        write_atomically(path, self._parquet() if path.suffix.casefold() == ".parquet" else utf8(self._csv()))

    def _csv(self) -> str:
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(self.columns)
        # Seven digits are more than any of these numbers is certain to. Column by column, since a cell's kind is its column's.
        cells = zip(self.columns.values(), zip(*self.rows, strict=True), strict=False)
        written = [[None if one is None else f"{one:.7g}" for one in column] if kind is float else column for kind, column in cells]
        lines.writerows(zip(*written, strict=True))
        return text.getvalue()

    def _parquet(self) -> bytes:
        import pyarrow
        import pyarrow.parquet

        types = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64()}
        cells = [pyarrow.array([row[at] for row in self.rows], types[kind]) for at, kind in enumerate(self.columns.values())]
        out = io.BytesIO()
        pyarrow.parquet.write_table(pyarrow.table(cells, names=list(self.columns)), out)
        return out.getvalue()


def check_table(path: Path) -> None:
    """Raise AsterismError where a table cannot be written under this name: it is neither CSV nor Parquet, or pyarrow is missing."""
    from importlib.util import find_spec

    if path.suffix.casefold() not in (".csv", ".parquet"):
        raise AsterismError(f"{path}: a table is CSV or Parquet; give it a name that ends in .csv or .parquet.")
    if path.suffix.casefold() == ".parquet" and find_spec("pyarrow") is None:
        raise AsterismError(f"{path}: Parquet needs pyarrow; install it with `pip install pyarrow`, or write a .csv.")
