"""Garments of coded circles: patterns in which every circle has an identity, made for an outline, read from images."""

from asterism.garment.design import DesignRules, design_pattern, tapered
from asterism.garment.identities import count_identities, count_rings
from asterism.garment.pattern import Pattern, Piece

__all__ = ["DesignRules", "Pattern", "Piece", "count_identities", "count_rings", "design_pattern", "tapered"]
