"""Diagnosis when no model is exact: which effects are there, how sure that is, and what the vehicle itself leaves."""
