from . import baselines as baselines
from . import calibration as calibration
from . import datasets as datasets
from . import download as download
from . import errors as errors
from . import evaluation as evaluation
from . import integrations as integrations
from . import isp as isp
from . import manifest as manifest
from . import metrics as metrics
from . import noise as noise
from . import protocols as protocols
from . import raw as raw
from . import records as records
from . import sources as sources
from .calibration import calibrate as calibrate
from .datasets import CalibrationFrames as CalibrationFrames
from .datasets import DRVDataset as DRVDataset
from .datasets import ELDDataset as ELDDataset
from .datasets import PackedClips as PackedClips
from .datasets import PackedStore as PackedStore
from .datasets import SIDDataset as SIDDataset
from .datasets import SyntheticClips as SyntheticClips
from .datasets import SyntheticPairs as SyntheticPairs
from .evaluation.evaluate import evaluate as evaluate
from .manifest import verify as verify

__version__: str
