"""The commands as functions: a case in, a result out, with the options of the command line and their defaults."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
