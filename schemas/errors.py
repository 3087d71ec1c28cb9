"""The one error tree. Every message names the file, key, row or value that is wrong; the CLI prints it as one line."""

LONGEST = 2000  # characters of a message; what a file holds may be of any length


def printable(text: str) -> str:
    """`text` as one line that no terminal obeys: what it may hold comes from files that anybody wrote."""
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    return "".join(c if c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()


class DeltatwinError(Exception):
    """Base of every error a user can cause or has to know about."""

    def __str__(self) -> str:
        return printable(super().__str__())


class RobotError(DeltatwinError):
    """A robot description is unreadable, incomplete or describes an impossible robot."""


class UnansweredError(RobotError):
    """A command asks what a machine of this kind does not answer."""


class TraceError(DeltatwinError):
    """A trace cannot be read, or holds data that cannot be used for what was asked."""


class MessageError(DeltatwinError):
    """Bytes on the wire or in a log are not the message they claim to be."""


class PoseError(DeltatwinError):
    """A pose is unreachable or singular."""


class BusError(DeltatwinError):
    """Zenoh or the field bus cannot be opened, or another role already holds the name."""


class RoleTakenError(BusError):
    """Another process of this host has the role."""


class StorageError(DeltatwinError):
    """A file cannot be written, or a recording not read back."""


class DataError(DeltatwinError):
    """The data do not support the answer that was asked for."""


class NoWindowError(DataError):
    """No stretch of a log is long enough, without fault and in motion, to be simulated."""
