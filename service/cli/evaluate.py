"""`deltatwin evaluate`."""


def command() -> None:
    """Errors of each model on traces."""
