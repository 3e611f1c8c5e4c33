"""What the server that workers are forked from has done before: libraries loaded, the packer's kernel ready.

Imported by multiprocessing's forkserver (:mod:`eldata.datasets.loading`). The kernel is serial, so no thread is left
running, and a worker reads its first crop half a second sooner.
"""

import numpy as np

import eldata.datasets.packed  # torch and h5py with it
import eldata.raw.reading  # noqa: F401 # to be there in each worker
from eldata.raw.levels import pack_normalised

of_memory, of_a_map = np.zeros((2, 2), np.uint16), np.zeros((2, 2), np.uint16)
of_a_map.flags.writeable = False
for mosaic in (of_memory, of_a_map):
    pack_normalised(mosaic, ((0, 1), (3, 2)), (0.0, 0.0, 0.0, 0.0), 1.0)
