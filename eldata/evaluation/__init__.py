"""Predictions, a manifest and a protocol in; scores and tables out. The public names load on first use."""

import lazy_loader

from eldata.base.moved import forwarded

_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = forwarded(
    __name__,
    {
        "ImageScore": "eldata.evaluation.scores:UnitScore",
        "VideoScore": "eldata.evaluation.scores:UnitScore",
        "VideoResult": "eldata.evaluation.results:EvaluationResult",
    },
    find=_find,
)
