"""What libraries log, kept from the terminal."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def quiet(level: int, *loggers: str | logging.Logger) -> Iterator[None]:
    """Keep what loggers of libraries report below a level from stderr; a name finds those that are registered."""
    known = [logging.getLogger(one) if isinstance(one, str) else one for one in loggers]
    handlers = [handler for logger in known for handler in logger.handlers]
    before = [handler.level for handler in handlers]
    for handler in handlers:
        handler.setLevel(max(level, handler.level))
    try:
        yield
    finally:
        for handler, its_level in zip(handlers, before, strict=True):
            handler.setLevel(its_level)
