"""The one exception that a user of Asterism is meant to read."""

__all__ = ["AsterismError"]


class AsterismError(Exception):
    """Input that cannot be worked with.

    The message is one sentence: which file or argument, what is wrong with it, and how to mend it.
    The command line prints it and leaves with status 2 (or goes on with the next file of a batch).
    """
