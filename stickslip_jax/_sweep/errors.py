"""The exception for mistakes that the user of a study can correct."""


class StudyError(ValueError):
    """A study that cannot run: bad input in its file or options, a folder that cannot be used, points that failed.

    The message is one sentence, which says what to do.
    """
