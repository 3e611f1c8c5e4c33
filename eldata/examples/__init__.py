"""Programs that users run as they are (``python -m eldata.examples.train_denoiser``), or copy and change."""

import sys
from importlib.util import find_spec

if sys.argv[0] == "-m" and find_spec("torch") is None:  # python -m comes here before it runs a program
    print("eldata.examples needs torch, which is not installed: pip install torch", file=sys.stderr)
    sys.exit(2)
