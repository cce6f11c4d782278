"""A folder of results is one run's: who it is, and what becomes of a run that was lost."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from asterism import AsterismError
from asterism.files.addresses import RemoteFolder
from asterism.session import LOCK, held, lock
from asterism.session.lock import LOST, Holder


@pytest.fixture(params=["disk", "memory"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Any]:
    if request.param == "disk":
        yield tmp_path
        return
    fsspec = pytest.importorskip("fsspec")
    memory = fsspec.filesystem("memory")
    yield RemoteFolder("memory://held")
    memory.rm("/held", recursive=True)


def put(folder: Any, holder: Holder, tmp_path: Path, age: float) -> None:
    """The lock of a run, as old as that by the disk's clock."""
    path = tmp_path / LOCK
    path.write_text(json.dumps(asdict(holder)))
    if isinstance(folder, RemoteFolder):
        folder.store(path, LOCK)
        import fsspec

        stored = fsspec.filesystem("memory").store[f"/held/{LOCK}"]
        stored.modified = stored.created = stored.modified.fromtimestamp(time.time() - age, stored.modified.tzinfo)
    else:
        os.utime(path, (time.time() - age,) * 2)


def read(folder: Any, tmp_path: Path) -> str:
    path = tmp_path / LOCK
    if isinstance(folder, RemoteFolder):
        folder.fetch(LOCK, path)
    return path.read_text()


def refuse(sentence: str) -> None:
    raise AssertionError(sentence)


def test_a_run_says_who_it_is_and_leaves_nobody_behind(folder: Any, tmp_path: Path) -> None:
    with held(folder, refuse) as one:
        assert Holder.read(read(folder, tmp_path)) == one.holder
        assert one.holder.machine == platform.node() and one.holder.process == os.getpid()
        said = rf"{one.holder.user} on .* \(process {os.getpid()}, begun .* is at work in it"
        with pytest.raises(AsterismError, match=said), held(folder, refuse):
            pass
    assert read(folder, tmp_path) == ""
    with held(folder, refuse):
        pass


def test_the_run_of_another_machine_is_left_alone_until_it_is_lost(folder: Any, tmp_path: Path) -> None:
    other = replace(Holder.here(), user="bob", machine="lab 2", process=7)
    for age in (5.0, -3600.0):
        put(folder, other, tmp_path, age)
        with pytest.raises(AsterismError, match=r"bob on lab 2 \(process 7.*wait for its end, or remove"), held(folder, refuse):
            pass
    put(folder, other, tmp_path, LOST + 5.0)
    said: list[str] = []
    with held(folder, said.append):
        pass
    assert "bob on lab 2" in said[0] and "this run goes on from there" in said[0]


def test_a_killed_run_of_this_machine_is_taken_over_at_once(folder: Any, tmp_path: Path) -> None:
    # a process that has ended
    process = os.posix_spawn("/bin/true", ["true"], {}) if hasattr(os, "posix_spawn") and Path("/bin/true").exists() else 0
    if not process:
        pytest.skip("no process to end")
    os.waitpid(process, 0)
    put(folder, replace(Holder.here(), process=process), tmp_path, 1.0)
    said: list[str] = []
    with held(folder, said.append):
        pass
    assert len(said) == 1


def test_a_run_that_slept_sees_that_it_was_taken_over(folder: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "BEAT", 0.02)
    with held(folder, refuse) as one:
        one.check()
        put(folder, replace(Holder.here(), user="bob", word="another"), tmp_path, 0.0)
        until = time.monotonic() + 60.0
        while one._taken is None and time.monotonic() < until:
            time.sleep(0.01)
        with pytest.raises(AsterismError, match=r"bob on .* has taken over the folder"):
            one.check()


def test_a_file_that_is_no_lock_names_nobody() -> None:
    assert Holder.read("") is None and Holder.read("[]") is None and Holder.read('{"user": "x"}') is None
