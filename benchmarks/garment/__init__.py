"""Garments: printed circles read, and composed to points."""
