"""The exceptions of studies."""


class StudyError(ValueError):
    """A study that cannot run: bad input in its file or options, a folder that cannot be used, points that failed.

    The message is one sentence, which says what to do.
    """


class DamagedPieceError(ValueError):
    """The bytes of a piece are not what was written. It is removed and done again."""


class UnreadableError(ValueError):
    """A text that is no manifest, or a damaged one."""


class OtherProgramError(UnreadableError):
    """A text that another program wrote."""
