"""`python -m ltvpneu`."""

import sys

from ltvpneu.face.cli import main

if __name__ == "__main__":
    sys.exit(main())
