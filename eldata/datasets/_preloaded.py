"""What the server that workers are forked from has done before: libraries loaded, the packer's kernel ready.

Imported by multiprocessing's forkserver (:mod:`eldata.datasets.loading`). The kernel is serial, so no thread is left
running, and a worker reads its first crop half a second sooner.
"""

import numpy as np

import eldata.datasets.packed_store  # torch and h5py with it
import eldata.raw.reading  # noqa: F401 # to be there in each worker
from eldata.raw.levels import pack_normalised

pack_normalised(np.zeros((2, 2), np.uint16), ((0, 1), (3, 2)), (0.0, 0.0, 0.0, 0.0), 1.0)
