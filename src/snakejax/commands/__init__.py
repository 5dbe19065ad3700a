"""The commands as functions, a case in and a result out, with the options and defaults of the command line (`cli`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
