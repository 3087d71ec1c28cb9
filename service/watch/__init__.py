"""The gap on the running robot: how large it is, whether it has risen, and what has changed."""
