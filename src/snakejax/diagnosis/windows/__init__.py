"""Explaining recordings that are many short windows of longer ones, robustly, judged by whole recordings left out."""
