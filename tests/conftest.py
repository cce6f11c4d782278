"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run, here and in CI; HYPOTHESIS_PROFILE=explore draws new ones.
settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.register_profile("explore", deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))


@pytest.fixture(scope="session")
def data() -> Path:
    """The real recordings, where this machine has them."""
    folder = os.environ.get("ASTERISM_DATA")
    if not folder:
        pytest.skip("ASTERISM_DATA is not set: no real recordings on this machine")
    return Path(folder)


@pytest.fixture(autouse=True)
def no_terminal_width(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables are as wide as they need, whatever width the environment tells."""
    monkeypatch.delenv("COLUMNS", raising=False)
