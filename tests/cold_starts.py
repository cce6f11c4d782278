"""Wand calibrations that begin from fewer first pairs of cameras, for tests of what comes after."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from asterism.calibration.wand import initialise, two_view


@contextmanager
def few_starts() -> Iterator[None]:
    """Two first pairs instead of six, each from three focal lengths instead of six, one of which is near that of the simulated cameras.

    A cold start takes most of a calibration's time. What the rig, its world and its findings are does not depend on how it was found.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(initialise, "RULES", replace(initialise.RULES, pairs=(2, 2)))
        patch.setattr(two_view, "RULES", replace(two_view.RULES, focal_guesses=(0.55, 0.8, 1.15)))
        yield
