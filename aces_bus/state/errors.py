"""What a state cannot answer, and checks of what is given."""

from __future__ import annotations

from ..errors import CallerError


class StateError(CallerError):
    """A state was asked for what it cannot know or do: says which state, what was asked, what there is, what next.

    `is_permanent`: waiting does not help, as for the future without an estimator, or a past longer than the history.
    """

    is_permanent = False


def raise_first(error: type[CallerError], *faults: tuple[bool, str]) -> None:
    """Raise `error` with the text of the first fault that is there, of pairs (whether it is there, text).

    >>> raise_first(StateError, (False, "no"), (True, "a rate is above 0"))
    Traceback (most recent call last):
      ...
    aces_bus.state.errors.StateError: a rate is above 0
    """
    for is_there, text in faults:
        if is_there:
            raise error(text)
