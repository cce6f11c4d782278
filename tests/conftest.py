"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data() -> Path:
    """The real recordings, where this machine has them."""
    folder = os.environ.get("ASTERISM_DATA")
    if not folder:
        pytest.skip("ASTERISM_DATA is not set: no real recordings on this machine")
    return Path(folder)
