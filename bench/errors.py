"""The one error that a user is meant to see; apart so that raising it imports nothing heavy."""


class InputError(Exception):
    """What the user gave cannot be used; the message is one line: what, where, what to do."""
