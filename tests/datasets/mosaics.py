"""Clean frames that are given mosaics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from eldata.sources.frames import Frame
from tests.raw.helpers import Cfa, levels_of


class Mosaics:
    """A source of given mosaics."""

    def __init__(
        self, mosaics: Sequence[NDArray[Any]], cfa: Cfa, *, black: float = 0.0, white: float = 65535.0
    ) -> None:
        self.mosaics, self.cfa, self.black, self.white = mosaics, cfa, black, white

    def __len__(self) -> int:
        return len(self.mosaics)

    def frame(self, index: int) -> Frame:
        levels = (self.black,) * levels_of(self.cfa)
        return Frame(self.mosaics[index], self.cfa, levels, self.white, f"mosaic {index}")
