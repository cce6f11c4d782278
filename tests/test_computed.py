"""What tests keep of dear functions is what these would give now."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import computed
import models
import numpy as np
import pytest

import asterism

calls: list[object] = []


def doubled(value: object, times: int = 2) -> object:
    calls.append(value)
    return value * times


@dataclass(frozen=True)
class Row:
    values: np.ndarray

    @cached_property
    def total(self) -> float:
        return float(self.values.sum())


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(computed, "_folder", lambda: tmp_path)
    calls.clear()


def test_a_value_is_worked_out_once_for_all_that_it_depends_on() -> None:
    for _ in range(2):
        assert computed.computed(doubled, 3) == 6 and len(calls) == 1
    assert computed.computed(doubled, 3, times=3) == 9 and len(calls) == 2
    assert computed.computed(doubled, 3, beside="other rules") == 6 and len(calls) == 3


@pytest.mark.parametrize("name", ["NUMBA_BOUNDSCHECK", "NUMBA_DISABLE_JIT", "MUTANT_UNDER_TEST"])
def test_a_run_that_checks_otherwise_works_it_out_anew(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(name, raising=False)
    computed.computed(doubled, 3)
    for value, count in (("1", 2), ("2", 3), ("1", 3)):
        monkeypatch.setenv(name, value)
        assert computed.computed(doubled, 3) == 6 and len(calls) == count


def test_other_sources_or_tables_give_another_value(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "asterism"
    (package / "room").mkdir(parents=True)
    files = {"__init__.py": "", "room/a.py": "from asterism.room import b\n", "room/b.py": "X = 1\n", "room/c.py": "", "room/t.toml": "1"}
    for name, text in files.items():
        (package / name).write_text(text)
    monkeypatch.setattr(asterism, "__file__", str(package / "__init__.py"))

    def now() -> bytes:
        models.sources.cache_clear()
        computed.sources.cache_clear()
        return computed.sources(package / "room" / "a.py")

    try:
        first = now()
        (package / "room" / "c.py").write_text("Y = 1\n")
        assert now() == first, "nothing imports it"
        for name in ("room/a.py", "room/b.py", "room/t.toml"):
            (package / name).write_text(files[name] + "2\n")
            assert now() != first
            (package / name).write_text(files[name])
        assert now() == first
    finally:
        models.sources.cache_clear()
        computed.sources.cache_clear()


def test_values_that_differ_have_another_digest() -> None:
    values = [None, 0, 0.0, False, "", "0", b"0", (), (0,), ((0,),), [0], {}, {0: 0}, np.zeros(2), np.zeros(3), np.zeros(2, dtype=np.int64)]
    values += [np.zeros((2, 1)), Row(np.zeros(2)), Row(np.ones(2)), ("a", "bc"), ("ab", "c")]
    assert len({computed.digest(value) for value in values}) == len(values)
    remembered = Row(np.ones(2))
    assert remembered.total == 2.0 and computed.digest(remembered) == computed.digest(Row(np.ones(2)))
    assert computed.digest(np.arange(6).reshape(2, 3).T) == computed.digest(np.arange(6).reshape(2, 3).T.copy())
    for value in ({1}, object(), np.array([None])):
        with pytest.raises(TypeError, match="give arrays"):
            computed.digest(value)
