"""Whole recordings with gaps and ghosts."""
