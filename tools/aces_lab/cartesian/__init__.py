"""Joint angles that reach a goal for tips of a body (`solve`), and a controller that follows a path (`CartesianPath`)."""

from __future__ import annotations

from .inverse import Goal, Solution, solve
from .path import CartesianPath

__all__ = ["CartesianPath", "Goal", "Solution", "solve"]
