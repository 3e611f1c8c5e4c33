"""What a notebook's cell prints, as it was printed.

IPython hands on what a shell's command prints in pieces of 100 bytes, and myst-nb ends each piece with a new line.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from myst_nb.core import render

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def joined(outputs: list[Any]) -> list[Any]:
    """Return a cell's outputs with the pieces of each stream put together, where its first one stands."""
    kept: list[Any] = []
    streams: dict[str, Any] = {}
    for output in outputs:
        if output["output_type"] != "stream":
            kept.append(output)
        elif output["name"] in streams:
            streams[output["name"]]["text"] += output["text"]
        else:
            streams[output["name"]] = output
            kept.append(output)
    return kept


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry point."""
    del app
    render.coalesce_streams = joined
    return {"parallel_read_safe": True, "parallel_write_safe": True}
