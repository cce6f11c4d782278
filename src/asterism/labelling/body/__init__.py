"""The whole-body look."""
