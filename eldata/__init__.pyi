from .base.isolation import isolation as isolation
from .calibration import calibrate as calibrate
from .datasets import CalibrationFrames as CalibrationFrames
from .datasets import DRVDataset as DRVDataset
from .datasets import ELDDataset as ELDDataset
from .datasets import PackedClips as PackedClips
from .datasets import PackedStore as PackedStore
from .datasets import SIDDataset as SIDDataset
from .datasets import StreamedPairs as StreamedPairs
from .datasets import SyntheticClips as SyntheticClips
from .datasets import SyntheticPairs as SyntheticPairs
from .evaluation.evaluate import evaluate as evaluate
from .evaluation.evaluate import evaluate_all as evaluate_all
from .manifest import verify as verify

__version__: str
