"""Which robot has changed, in what, since when? Each is judged day after day against what it was on its first."""
