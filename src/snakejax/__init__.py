"""Differentiable simulation and parameter fitting for the skidding snakeboard."""
