"""The claims of the paper and what this model says of them, which `fit/paper.py` writes down."""
