"""Frames labelled one by one, and the files they come from."""
