"""What a model lacks: the analysis of residuals, the selection of effects, the latent force."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
