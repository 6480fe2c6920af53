"""The base class of all errors that the user can correct."""


class NightError(ValueError):
    """A request that cannot be fulfilled, for a reason that the user can correct.

    The message is one sentence: what is wrong, where, and what to do. The commands print it and end with exit
    code 2.
    """
