"""The exceptions that a user of Asterism is meant to read: one, and its kind for files that are in order but hold no markers."""

__all__ = ["AsterismError", "NoMarkers"]


class AsterismError(Exception):
    """Input that cannot be worked with.

    The message is one sentence: which file or argument, what is wrong with it, and how to mend it.
    The command line prints it and leaves with status 2 (or goes on with the next file of a batch).
    """


class NoMarkers(AsterismError):
    """A file that holds something else than markers: forces, joint angles, points of cameras. In a folder of files it is passed over."""
