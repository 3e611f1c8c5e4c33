"""The old name of :mod:`eldata.sources.shards`, and of :class:`eldata.datasets.StreamedPairs`, until 0.3."""

from eldata.base.moved import forwarded

_NAMES = ("ShardError", "ShardIndex", "ShardReport", "verify_shards", "write_shards")

__getattr__ = forwarded(
    __name__,
    {"StreamedPairs": "eldata.datasets:StreamedPairs"} | {name: f"eldata.sources.shards:{name}" for name in _NAMES},
)
