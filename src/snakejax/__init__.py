"""Differentiable simulation and parameter fitting for wheeled vehicles that skid.

Names are imported when first used, so that `snakejax --help` need not wait for JAX; `__init__.pyi` lists them.
"""

import lazy_loader

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    if name == "__version__":
        import importlib.metadata

        return importlib.metadata.version("snakejax")
    return _public(name)
