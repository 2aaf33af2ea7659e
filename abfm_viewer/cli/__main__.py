"""``python -m abfm_viewer.cli``: the command line where no console script is at hand."""

import sys

from abfm_viewer.cli import main

sys.exit(main())
