"""Motion with a known answer."""

from tests.known import make, robot

__all__ = ["make", "robot"]
