"""Clutter, strangers, and what the confidence is worth."""
