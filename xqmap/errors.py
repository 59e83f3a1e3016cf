"""The one exception whose message is meant for the person at the keyboard."""


class UserError(Exception):
    """A mistake that the user can mend: the message is one line that names the setting (or file) and the fix."""
