"""The one exception that a user is meant to see."""


class BadInput(Exception):
    """Something the user gave cannot be used.

    The message is one line: what is wrong, where (file, line, column, value) and what to do.
    The command line prints it on stderr and exits with 2.
    """
