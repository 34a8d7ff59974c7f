"""The one exception for mistakes that the user of a study can mend."""


class StudyError(ValueError):
    """Bad input to a study (its file, an option, the place for its result). The text is one sentence for the user."""
