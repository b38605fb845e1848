"""``python -m rmesh_nlp.mpcc``."""

import sys

from rmesh_nlp.mpcc.command import main

if __name__ == "__main__":
    sys.exit(main())
