import sys

from dante_w.guard import main

sys.exit(main())
