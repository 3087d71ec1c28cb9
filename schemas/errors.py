"""The one error tree. Every message names the file, key, row or value that is wrong; the CLI prints it as one line."""


class DeltatwinError(Exception):
    """Base of every error a user can cause or has to know about."""


class RobotError(DeltatwinError):
    """A robot description is unreadable, incomplete or describes an impossible robot."""


class TraceError(DeltatwinError):
    """A trace cannot be read, or holds data that cannot be used for what was asked."""


class MessageError(DeltatwinError):
    """Bytes on the wire or in a log are not the message they claim to be."""


class PoseError(DeltatwinError):
    """A pose is unreachable or singular."""


class BusError(DeltatwinError):
    """Zenoh or the field bus cannot be opened, or another role already holds the name."""


class StorageError(DeltatwinError):
    """A log cannot be written or read back."""


class DataError(DeltatwinError):
    """The data do not support the answer that was asked for."""
