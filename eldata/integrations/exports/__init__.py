"""A set as foreign code reads it: names and lists of published training code, and a folder for the Hugging Face Hub."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
