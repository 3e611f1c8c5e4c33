"""`python -m capture`: the command, where its script is not on the path."""

import sys

from capture.cli import main

sys.exit(main())
