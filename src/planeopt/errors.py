"""The one exception that means: what you gave cannot be used, and here is why."""


class InputError(ValueError):
    """An input is missing, unreadable or invalid.

    The message is one line that says what is wrong, where (file, key, row or image) and what to do; the command
    line prints it as it is and exits with status 1.
    """
