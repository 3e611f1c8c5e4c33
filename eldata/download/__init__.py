"""Getting a dataset's files: where they are, fetching an archive, checking and unpacking it. Light to import."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
