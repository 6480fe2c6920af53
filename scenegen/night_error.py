"""The one base class of what NIGHT refuses."""


class NightError(ValueError):
    """What was asked for cannot be done, for a reason that the user can change.

    The message is one sentence: what is wrong, where, and what to do. The commands print it and end with exit
    code 2; every other exception that reaches them is a defect of NIGHT. `itof` imports no sibling and has an
    error of its own for this, `itof.ImageFileError`.
    """
