"""`python -m planeopt`."""

import sys

from planeopt.cli import main

if __name__ == "__main__":
    sys.exit(main())
