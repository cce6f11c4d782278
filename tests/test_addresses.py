"""Files at addresses of fsspec: brought and taken whole, and what is said where an address, a disk or a package fails."""

from __future__ import annotations

import multiprocessing
import sys
import threading
import warnings
import zipfile
from pathlib import Path
from typing import Any

import pytest

from asterism import AsterismError
from asterism.cli._process_places import SessionPlaces
from asterism.files import addresses, stalls
from asterism.files.addresses import RemoteFolder, below, is_address, local_path
from asterism.files.stalls import digest, that_answer, unless_stalled
from asterism.session.spread import no_room

fsspec = pytest.importorskip("fsspec")
from fsspec.implementations.memory import MemoryFile, MemoryFileSystem  # noqa: E402


class Failing(MemoryFileSystem):
    """A file system in memory that fails as a test wants."""

    protocol = "failing"
    store: dict[str, Any] = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012
    fail: Any = None

    def _open(self, path: str, mode: str = "rb", **more: Any) -> Any:
        if Failing.fail is not None:
            Failing.fail(path, mode)
        return super()._open(path, mode, **more)


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> type[Failing]:
    fsspec.register_implementation("failing", Failing, clobber=True)
    Failing.store.clear()
    monkeypatch.setattr(Failing, "fail", None)
    addresses._opened.cache_clear()
    return Failing


@pytest.fixture
def some(tmp_path: Path) -> Path:
    path = tmp_path / "some"
    path.write_bytes(bytes(range(256)) * 9000)
    return path


@pytest.mark.parametrize(
    ("text", "address"),
    [("s3://b/x", True), ("zip://x::/a.zip", True), ("file:///a", False), ("C:\\x", False), ("a/b", False), ("C:/x", False)],
)
def test_an_address_is_told_from_a_path(text: str, address: bool) -> None:
    assert is_address(text) == address


def test_a_path_may_be_written_as_an_address() -> None:
    assert local_path("file:///data/a%20b") == Path("/data/a b") and local_path("data") == Path("data")


@pytest.mark.parametrize("where", ["memory://lab one/people", "dir://people::file://{}"])
def test_a_file_goes_to_an_address_and_comes_back(where: str, some: Path, tmp_path: Path) -> None:
    folder = RemoteFolder(where.format(tmp_path))
    assert not folder.fetch("an n/ä.c3d", tmp_path / "back")
    for _ in range(2):
        folder.store(some, "an n/ä.c3d")
    assert folder.files() == ["an n/ä.c3d"], "no other name is left"
    assert folder.exists("an n/ä.c3d") and not folder.exists("an n")
    assert folder.fetch("an n/ä.c3d", tmp_path / "back" / "ä.c3d")
    assert (tmp_path / "back" / "ä.c3d").read_bytes() == some.read_bytes()
    folder.remove("an n/ä.c3d")
    folder.remove("an n/ä.c3d")
    assert folder.files() == []


def test_an_archive_is_read_and_not_written(some: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        archive.write(some, "people/ann/walk.c3d")
    folder = RemoteFolder(f"zip://people::{tmp_path / 'all.zip'}")
    assert folder.files() == ["ann/walk.c3d"]
    assert folder.fetch("ann/walk.c3d", tmp_path / "walk.c3d") and (tmp_path / "walk.c3d").read_bytes() == some.read_bytes()
    with pytest.raises(AsterismError, match="cannot be written"):
        folder.check(tmp_path)


def test_what_breaks_off_leaves_what_was_there(failing: type[Failing], some: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = RemoteFolder("failing://lab")
    folder.store(some, "walk.c3d")
    other = tmp_path / "other"
    other.write_bytes(b"other")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        # after the file was made
        patched.setattr(MemoryFile, "write", full, raising=False)
        with pytest.raises(AsterismError, match=r"failing://lab/walk.c3d cannot be written \(No space left on device\)") as problem:
            folder.store(other, "walk.c3d")
    assert no_room(problem.value)
    assert folder.files() == ["walk.c3d"] and folder.fetch("walk.c3d", other) and other.read_bytes() == some.read_bytes()


def test_a_disk_that_stalls_is_given_up_and_a_slow_one_is_not(
    failing: type[Failing], some: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # ten times as long as what is slow: a busy machine may let a thread wait for some tenths of a second
    monkeypatch.setattr(stalls, "STALLED", 0.5)
    released = threading.Event()
    RemoteFolder("failing://lab").store(some, "walk.c3d")
    failing.fail = staticmethod(lambda path, mode: released.wait(20.0))
    with pytest.raises(AsterismError, match=r"failing://lab/walk.c3d: its disk has not answered for 0 s"):
        RemoteFolder("failing://lab").fetch("walk.c3d", tmp_path / "back")
    released.set()

    def slowly(came: Any) -> str:
        for count in range(12):
            came(count)
            threading.Event().wait(0.05)
        return "all"

    assert unless_stalled("slow", slowly) == "all"


def test_a_file_of_this_disk_that_never_comes_is_left_out(some: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stalls, "STALLED", 0.5)
    released, reads = threading.Event(), Path.open

    def open_(path: Path, *more: Any, **other: Any) -> Any:
        if path.name == "dead":
            released.wait(20.0)
        return reads(path, *more, **other)

    monkeypatch.setattr(Path, "open", open_)
    paths = [tmp_path / "dead", some, tmp_path / "none"]
    assert that_answer(paths) == paths[1:]
    with pytest.raises(AsterismError, match="dead: its disk has not answered"):
        digest(tmp_path / "dead")
    released.set()
    assert len(digest(some)) == 64
    with pytest.raises(OSError, match="none"):
        digest(tmp_path / "none")


@pytest.mark.parametrize(
    ("address", "said"),
    [("nope://x/y", "no address that fsspec knows"), ("memory://none", "holds no file"), ("github://a:b@c/x", "")],
)
def test_an_address_that_fails_is_told(address: str, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if not said:
        monkeypatch.setitem(sys.modules, "fsspec.core", None)
        said = r"install it with `pip install 'asterism\[cluster\]'`"
    places = SessionPlaces()
    with pytest.raises(AsterismError, match=said):
        places.show(places.path(address))


def _makes_a_scratch(pipe: Any) -> None:
    places = SessionPlaces()
    (places.scratch / "walk.c3d").touch()
    pipe.send(places.scratch)
    # as what labels the person of the last task
    _KEPT.append(places)


_KEPT = list[Any]()


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="processes are not forked here")
def test_temporary_files_of_a_process_go_with_it() -> None:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe()
    process = context.Process(target=_makes_a_scratch, args=(there,))
    with warnings.catch_warnings():
        # that threads are not forked: this child needs none
        warnings.simplefilter("ignore", DeprecationWarning)
        process.start()
    scratch = here.recv()
    process.join()
    assert not scratch.exists()
    places = SessionPlaces()
    scratch = places.scratch
    del places
    assert not scratch.exists()


def test_two_addresses_have_two_paths_below_the_folder() -> None:
    paths = {below(Path("/t"), one) for one in ("s3://b/x", "gs://b/x", "s3://b/../x", "zip://x::s3://b/x.zip")}
    assert len(paths) == 4 and all(path.is_relative_to("/t") and ".." not in path.parts for path in paths)
