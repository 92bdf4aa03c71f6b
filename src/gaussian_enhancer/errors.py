"""The errors that the command line turns into one line: what a user can mend, and a process that was killed."""

from collections.abc import Iterable


class InputError(ValueError):
    """What the user handed in cannot be used; the command line turns it into one line and exit code 2.

    The message is one printable line whatever the parts hold, since they quote files that others wrote.

    Args:
        subject: what is wrong, named as the user knows it: a file, an option.
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
        """Pickle by the three parts, so that the error survives worker processes."""
        return InputError, (self.subject, self.received, self.remedy)


def refuse_unknown(option: str, names: Iterable[object] | None, known: Iterable[object]) -> None:
    """Refuse an option that names what there is not.

    Args:
        option: its name.
        names: what it names; None names nothing.
        known: what it may name, in the order in which an error tells it.

    Raises:
        InputError: a name is unknown.
    """
    listed = [str(name) for name in known]
    for name in names or ():
        if str(name) not in listed:
            raise InputError(option, f"names {str(name)!r}", f"choose from {', '.join(listed)}")


class LostProcessError(RuntimeError):
    """A process that did a part of the work was killed; the command line turns it into one line and exit code 1."""


def one_line(text: str, longest: int = 600) -> str:
    """The text with line breaks and control characters escaped, its middle left out where it is too long."""
    escaped = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    if len(escaped) <= longest:
        return escaped
    half = longest // 2
    return f"{escaped[:half]} ... {escaped[-half:]}"


def reason_of(error: BaseException) -> str:
    """Why something is missing, as a record states it: a user's mistake in its own words, others with their type.

    Args:
        error: what kept it from being made.
    """
    return str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
