"""What a state cannot answer."""

from __future__ import annotations

from ..errors import CallerError


class StateError(CallerError):
    """A state was asked for what it cannot know or do: says which state, what was asked, what there is, what next."""
