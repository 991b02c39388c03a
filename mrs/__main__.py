"""``python -m mrs`` is the command ``mrs``."""

import sys

from mrs.run.cli import main

if __name__ == "__main__":  # not where a process that this one starts imports it again
    sys.exit(main())
