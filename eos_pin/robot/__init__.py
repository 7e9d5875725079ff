"""Robots: checked models, their dynamics, and their files."""

import lazy_loader

# The public names of this room are listed in `__init__.pyi`.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
