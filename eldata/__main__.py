"""`python -m eldata`: the command, where its script is not on the path."""

import sys

from eldata.cli.main import main

sys.exit(main())
