"""Run the backend from its sources: `python -I launch.py recover ...`.

The add-on starts this file with an isolated interpreter (`-I`), where neither the working folder nor
PYTHONPATH is on `sys.path`; so the sources beside this file are put there by hand.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from dante_w.commands.supervisor import main

sys.exit(main())
