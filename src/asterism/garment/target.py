"""A printed pattern in; the same sheet as a calibration target out."""

from __future__ import annotations

from asterism.calibration.coded_target import CodedTarget
from asterism.errors import AsterismError
from asterism.garment.pattern import Pattern


def coded_target(pattern: Pattern) -> CodedTarget:
    """The flat sheet of a pattern as a calibration target: all its circles that have an identity, at the pattern's pitch.

    Raises AsterismError where the pattern has several pieces, which do not lie on one board, or fewer than six identities.
    """
    if len(pattern.pieces) > 1:
        raise AsterismError(
            f"this pattern is a garment of {len(pattern.pieces)} pieces, not a calibration target; print one with a single sheet."
        )
    inner = pattern.ids >= 0
    return CodedTarget.of(pattern.ids[inner], pattern.positions()[inner], pattern.pitch, pattern.diameter)
