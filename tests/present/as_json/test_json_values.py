"""Values as JSON can hold them."""

import math

import numpy as np

from snakejax.present.as_json.values import clean


def test_what_is_no_finite_number_is_null() -> None:
    value = {"a": np.array([1.0, np.nan]), "b": (math.inf, 2), "c": np.float64(3.0), "d": None, "e": True}
    assert clean(value) == {"a": [1.0, None], "b": [None, 2], "c": 3.0, "d": None, "e": True}
