"""Errors that the command line reports in one line: invalid user input, and a process that was killed."""

from collections.abc import Iterable

INTERRUPTED = 130
"""Exit code after Ctrl-C, by the convention of shells."""
LONGEST = 600
"""Maximum number of characters of a part of an error message."""


class InputError(ValueError):
    """The user's input cannot be used. The command line reports it in one line with exit code 2.

    The message is always one printable line. Its parts may quote untrusted files, so they are escaped.

    Args:
        subject: the invalid item, named as the user knows it: a file, an option.
        received: the value or state that was found.
        remedy: what to do instead, as an imperative.

    Example:
        >>> raise InputError("photo a.png", "is truncated after 812 bytes", "replace the file")
        Traceback (most recent call last):
        ...
        gaussian_enhancer.errors.InputError: photo a.png: is truncated after 812 bytes; replace the file
    """

    def __init__(self, subject: object, received: str, remedy: str) -> None:
        super().__init__("{}: {}; {}".format(*(one_line(str(part)) for part in (subject, received, remedy))))
        self.subject = str(subject)
        self.received = received
        self.remedy = remedy

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, str, str]]:
        """Pickle the three parts, so that worker processes can return the error."""
        return InputError, (self.subject, self.received, self.remedy)


def refuse_unknown(option: str, names: Iterable[object] | None, permitted_names: Iterable[object]) -> None:
    """Refuse an option whose value contains an unknown name.

    Args:
        option: the option's name.
        names: names in the option's value; None stands for none.
        permitted_names: permitted names, in the order in which the error lists them.

    Raises:
        InputError: a name is unknown.
    """
    permitted = [str(name) for name in permitted_names]
    for name in names or ():
        if str(name) not in permitted:
            raise InputError(option, f"names {str(name)!r}", f"choose from {', '.join(permitted)}")


class LostProcessError(RuntimeError):
    """A worker process was killed. The command line reports it in one line with exit code 1."""


def one_line(text: str) -> str:
    """Escape line breaks and control characters, and cut out the middle of a text longer than `LONGEST`."""
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(escaped) <= LONGEST:
        return escaped
    half = LONGEST // 2
    return f"{escaped[:half]} ... {escaped[-half:]}"
