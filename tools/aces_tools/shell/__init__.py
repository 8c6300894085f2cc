"""What shells and `man` know of the command: completion scripts and manual pages, generated and checked in (`files`).

1. `generate` makes them of the verbs' own tables, with shtab: `make golden` writes them
   anew.
2. The wheel installs them where shells and man look below its prefix (see pyproject.toml); `aces completion` prints a script
   for those that look elsewhere.
"""

from __future__ import annotations

#: Shells → the file of their script.
SCRIPTS = {"bash": "aces.bash", "zsh": "_aces", "fish": "aces.fish"}

__all__ = ["SCRIPTS"]
