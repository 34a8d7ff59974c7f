"""The exception of files, options and folders that the command is given."""


class StudyError(ValueError):
    """A mistake in a TOML file or an option of the command, or a folder that cannot hold the result of a study.

    The message is one sentence, which says what to do.
    """
