"""Fits of models that are not exact: a random force of estimated strength, noise that wanders, constants as priors."""
