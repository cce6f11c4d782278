"""Asterism."""
