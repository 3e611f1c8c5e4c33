"""Numbers of bytes as people read them."""

from __future__ import annotations


def size_text(size_bytes: int) -> str:
    """Return a size in decimal units, as publishers and disks state it: ``25.1 GB``."""
    size = float(size_bytes)
    for unit in ("bytes", "kB", "MB", "GB"):
        if size < 1000:
            return f"{size_bytes} bytes" if unit == "bytes" else f"{size:.3g} {unit}"
        size /= 1000
    return f"{size:.3g} TB"
