"""DDS domains for tests, each used once."""

from __future__ import annotations

import itertools
import os

#: A domain for each stage, far from those of other processes that run these tests.
DOMAINS = itertools.cycle((os.getpid() * 7 + n) % 100 for n in range(100))
