"""Cases to run and to read. Each is a script too, so modules beside it are imported without the package."""

import sys
from pathlib import Path

if (folder := str(Path(__file__).parent)) not in sys.path:
    sys.path.append(folder)
