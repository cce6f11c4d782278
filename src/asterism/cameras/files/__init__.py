"""Rig files in, rigs out, and back; what a file holds chooses who reads it, its name who writes it."""

from asterism.cameras.files._dispatch import describe_rig, guesses, is_rig_file, read_rig, write_rig

__all__ = ["describe_rig", "guesses", "is_rig_file", "read_rig", "write_rig"]
