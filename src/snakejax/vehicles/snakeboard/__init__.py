"""Snakeboard: its masses, and the constraints and examples of Salman et al., CDC 2016."""
