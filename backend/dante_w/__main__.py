import sys

from dante_w.commands.supervisor import main

sys.exit(main())
