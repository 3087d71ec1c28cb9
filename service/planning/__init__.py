"""Which motion settles it? A run to make, from what a diagnosis left open."""
