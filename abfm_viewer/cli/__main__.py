"""``python -m abfm_viewer.cli``: the command line without the console script."""

import sys

from abfm_viewer.cli import main

sys.exit(main())
