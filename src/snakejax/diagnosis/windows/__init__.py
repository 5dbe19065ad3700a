"""Explanation of recordings cut into short windows: robust fits, validated on omitted whole recordings."""
