"""What a planar wheeled vehicle is, and its equations of motion: inputs, wheels, tyres, constraints, effects."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
