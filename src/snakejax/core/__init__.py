"""Parameters with unit and domain, errors, numerics and files; nothing here knows any physics."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
