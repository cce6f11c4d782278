"""Rig files in, rigs out, and back; content and suffix choose the format."""

from asterism.cameras.files._dispatch import read_rig, write_rig

__all__ = ["read_rig", "write_rig"]
