"""Exceptions whose message is meant for the person at the keyboard."""

from xqmap.terminal import one_line

# The environment variable that has commands show where an error came from.
TRACEBACK = "XQMAP_TRACEBACK"


class UserError(Exception):
    """A mistake that the user can mend: the message is one line that names the setting (or file) and the fix."""


class WorldError(UserError):
    """The simulator failed or did not come to an end; the message says where."""


class WorkerLost(WorldError):
    """A process that simulates beside the training came to an end; the message says which and how."""


def brief(error: BaseException, most: int = 200) -> str:
    """What another's exception says, on one line of at most so many characters."""
    return one_line(str(error))[:most]


class Stopped(KeyboardInterrupt):
    """A signal asked to stop at once; ``number`` is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by signal {number}")
        self.number = number
