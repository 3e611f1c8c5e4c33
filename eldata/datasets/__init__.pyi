from .base import PairDataset as PairDataset
from .eld import ELDDataset as ELDDataset
from .registry import dataset_class as dataset_class
from .registry import dataset_names as dataset_names
