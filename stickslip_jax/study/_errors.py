"""The exception for mistakes that the user of a study can correct."""


class StudyError(ValueError):
    """Bad input to a study: in its file, in an option, or in the folder for its result. The message is one sentence."""
