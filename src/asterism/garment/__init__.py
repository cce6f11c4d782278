"""Garments of coded circles: patterns in which every circle has an identity."""

from asterism.garment.identities import count_identities, count_rings
from asterism.garment.pattern import Pattern, Piece

__all__ = ["Pattern", "Piece", "count_identities", "count_rings"]
