"""Labelled movements and rules in; events such as the top of a backswing, phases, extremes and the order of fastest segments out."""

from asterism.motion.events.finding import Extreme, FoundMovement, MovementEvent, Phase, SequencePeak, find_movement, movement_table
from asterism.motion.events.rules import MovementRules, shipped_movements

__all__ = [
    "Extreme",
    "FoundMovement",
    "MovementEvent",
    "MovementRules",
    "Phase",
    "SequencePeak",
    "find_movement",
    "movement_table",
    "shipped_movements",
]
