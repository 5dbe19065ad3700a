"""Solutions of a model: one run, an ensemble, a sweep over parameters; in chunks, on a cluster."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
