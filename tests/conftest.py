"""What all tests share."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir

# The same examples in every run, here and in CI; HYPOTHESIS_PROFILE=explore draws new ones.
settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))
# Which constants our sources hold, from which it draws, Hypothesis keeps by their hash: in a fresh checkout each worker parses all of them,
# for five seconds of a processor.
if "ASTERISM_TEST_CACHE" in os.environ:
    set_hypothesis_home_dir(Path(os.environ["ASTERISM_TEST_CACHE"]) / "hypothesis")


# While test files are imported nearly nothing is garbage: looking for it is a quarter of the time.
gc.disable()


QUICK_SHARE = 3
"""Hypothesis tries a third of the examples, the first ones, where slow tests are left out: `python tools/check.py --all` tries all."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("markexpr") == "not slow":
        for item in items:
            _try_fewer_examples(getattr(item, "obj", None))
    if hasattr(config, "workerinput"):
        from distribution import in_row

        items[:] = in_row(items)


def _try_fewer_examples(test: Any) -> None:
    function = getattr(test, "__func__", test)
    # Hypothesis has no public way to ask a test for its settings; where this one is gone, all examples are tried.
    given = getattr(function, "_hypothesis_internal_use_settings", None)
    if isinstance(given, settings) and not getattr(function, "tries_fewer", False):
        function._hypothesis_internal_use_settings = settings(given, max_examples=max(given.max_examples // QUICK_SHARE, 4))
        function.tries_fewer = True  # parametrized tests share their function


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """One more than there are cores: tests of browsers, sockets and processes wait, and a worker for each core left a sixth of them idle.

    Each worker imports all test files, which takes some four seconds, so that more than one would cost what it gains.
    """
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None  # xdist does as it says
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    if config.getoption("dist") != "loadfile":
        return None
    from distribution import FromBothEnds

    config.option.loadscopereorder = False
    return FromBothEnds(config, log)


def pytest_collection_finish() -> None:
    # What the imported packages hold stays till the end: the collector of garbage need not look through it again and again.
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--record-snapshots", action="store_true", help="write tests/snapshots anew instead of comparing with them")
    parser.addoption("--at-once", action="store_true", help="print a failure when it happens, not at the end")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--at-once") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(FailuresAtOnce(config))


class FailuresAtOnce:
    """Prints a failure when it happens, and not again at the end."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        terminal = self.config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and terminal is not None:
            terminal.write_sep("_", f"{report.nodeid} ({report.when})", red=True)
            report.toterminal(terminal._tw)

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionfinish(self) -> None:
        self.config.option.tbstyle = "no"


@pytest.fixture(scope="session")
def record_snapshots(request: pytest.FixtureRequest) -> bool:
    """Whether the outputs of the commands are recorded anew."""
    return bool(request.config.getoption("--record-snapshots"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The real recordings, where this machine has them."""
    folder = os.environ.get("ASTERISM_DATA")
    if not folder:
        pytest.skip("ASTERISM_DATA is not set: no real recordings on this machine")
    return Path(folder)


@pytest.fixture(scope="session", autouse=True)
def kept_virtual_people() -> Iterator[None]:
    """Models of virtual people and shapes of sets are made once for all files, workers and runs, beside the trained models of tests.

    Their names hold a hash of the sources and of what was asked for, so that none is taken for one of other sources.
    """
    import models  # with all of Asterism: not for the process that only hands out tests

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ASTERISM_CACHE", str(models.folder() / "virtual"))
        yield


REMEMBERED = 500
"""Frames that were held against the marker sets last, and are not held again: those of a test, and of what several tests share; 5 MB."""


@pytest.fixture(scope="session", autouse=True)
def frames_looked_at_once(kept_virtual_people: None) -> Iterator[None]:
    """The same points are held against all marker sets once, which takes up to a tenth of a second a frame, whichever doors ask.

    Half of the time of the tests that label without a model went into it, so that what was found is kept for the next run, too.
    """
    from computed import computed

    from asterism.session.worn import find

    look, seen = find.fit_frame, dict[tuple[object, ...], Any]()

    def remembered(points: Any, shapes: Any, rules: Any = None) -> Any:
        given = (points.tobytes(), points.shape, id(shapes), repr(rules))
        if given not in seen:
            # The shapes are kept, so that their number stays their own.
            seen[given] = computed(look, points, shapes, rules), shapes
            if len(seen) > REMEMBERED:
                del seen[next(iter(seen))]
        return seen[given][0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(find, "fit_frame", remembered)
        yield


@pytest.fixture(scope="session", autouse=True)
def parts_of_trainings_kept(kept_virtual_people: None) -> Iterator[None]:
    """A training takes its dear parts from the disk where the same people, rules and sources have given them, whichever test trained."""
    from kept_training import parts_kept

    with parts_kept():
        yield


@pytest.fixture
def training_anew() -> Iterator[None]:
    """For tests that hold one training against another of the same recordings."""
    from kept_training import parts_anew

    with parts_anew():
        yield


@pytest.fixture
def without_studies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sessions begin no process of studies: for tests of a whole session that are about something else.

    It is a fresh Python that reads all kernels, and the session waits for it: two seconds of a processor. Commands that begin one are run
    in `test_live_rig.py` and, with a model, in `test_live.py` by what a signal ends; what it says is tried in `test_live_studies.py`.
    """
    monkeypatch.setattr("asterism.session.live.StudyProcess", lambda rate, rules: "none")


@pytest.fixture(autouse=True)
def no_terminal_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are as wide as they need, whatever width the environment tells."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.hookimpl(hookwrapper=True)
def pytest_make_collect_report(collector: pytest.Collector) -> Iterator[None]:
    """One worker imports the test files from the first to the last, one from the last to the first, one from the middle on.

    So what one has compiled to bytecode the others need not.
    """
    outcome = yield
    if isinstance(collector, pytest.Dir):
        files = outcome.get_result().result
        way = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 3
        if way == 1:
            files.reverse()
        elif way == 2:
            files[:] = files[len(files) // 2 :] + files[: len(files) // 2]
