"""Which values of a trace cannot be."""

import numpy as np

from drivers.trace.quality import _middle


def test_the_middle_of_five_is_their_median() -> None:
    five = np.random.default_rng(0).integers(0, 4, (5, 2000, 3)).astype(float)  # many ties
    np.testing.assert_array_equal(_middle(*five), np.median(five, axis=0))
