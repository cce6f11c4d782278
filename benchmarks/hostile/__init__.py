"""Damaged files and long recordings."""
