"""The exceptions of sweeps."""


class SweepError(ValueError):
    """A sweep that cannot run, or not to its end: a folder that cannot be used, points that failed, no memory.

    The message is one sentence, which says what to do.
    """


class DamagedBatchError(ValueError):
    """The bytes of a batch are not what was written. It is removed and done again."""


class UnreadableError(ValueError):
    """A text that is no manifest, or a damaged one."""


class OtherProgramError(UnreadableError):
    """A text that another program wrote."""
