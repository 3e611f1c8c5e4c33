from .datasets import ELDDataset as ELDDataset
from .datasets import SyntheticPairs as SyntheticPairs
from .evaluation import evaluate as evaluate
from .manifest import verify as verify

__version__: str
