import sys

from dante_w.cli import main

sys.exit(main())
