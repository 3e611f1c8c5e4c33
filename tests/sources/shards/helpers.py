"""What the tests of streaming compare: samples as values."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


def identity(sample: Mapping[str, Any]) -> str:
    """Which sample it is, to the bit."""
    digest = hashlib.sha256(sample["input"].numpy().tobytes() + sample["target"].numpy().tobytes())
    rest = sorted((key, value) for key, value in sample.items() if key not in ("input", "target"))
    return f"{sample['path']} {tuple(sample['input'].shape)} {digest.hexdigest()} {rest}"


def identities(samples: Iterable[Mapping[str, Any]]) -> list[str]:
    return [identity(sample) for sample in samples]


def unbatched(batches: Iterable[Mapping[str, Any]]) -> list[str]:
    """The identities of the samples of a DataLoader's batches."""
    found = []
    for batch in batches:
        for number in range(len(batch["path"])):
            sample = {key: value[number] for key, value in batch.items()}
            for key in ("ratio", "nominal_ratio", "iso", "exposure_s"):
                sample[key] = sample[key].item()
            found.append(identity(sample))
    return found
