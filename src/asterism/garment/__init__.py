"""Garments of coded circles: patterns in which every circle has an identity, made for an outline, printed, and checked by photos."""

from asterism.garment.check import PhotoCheck, check_photo
from asterism.garment.design import DesignRules, design_pattern, tapered
from asterism.garment.identities import count_identities, count_rings
from asterism.garment.pattern import Pattern, Piece
from asterism.garment.sheet import SheetRules, ink_findings, print_pattern

__all__ = [
    "DesignRules",
    "Pattern",
    "PhotoCheck",
    "Piece",
    "SheetRules",
    "check_photo",
    "count_identities",
    "count_rings",
    "design_pattern",
    "ink_findings",
    "print_pattern",
    "tapered",
]
