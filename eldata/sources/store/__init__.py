"""HDF5 stores for training: every frame decoded once, read in random crops. The public names load on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
