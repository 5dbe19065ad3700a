"""What to do next: gaits by optimisation, experiments by information."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
