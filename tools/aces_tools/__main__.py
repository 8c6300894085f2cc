"""`python -m aces_tools VERB …`: the same as `aces VERB …`."""

import sys

from .main import main

sys.exit(main())
