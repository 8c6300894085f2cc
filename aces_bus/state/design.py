"""Filters by their frequencies: coefficients from scipy.signal, which is loaded when asked for (extra `[filters]`).

1. What comes out is an `Sos`: plain numbers. scipy does not run with the samples.
2. Frequencies are in hertz; all must lie between 0 and half of the rate.
"""

from __future__ import annotations

import importlib
import math
from types import ModuleType
from typing import Literal

from ..errors import CallerError
from .errors import StateError
from .filters import Initial, Sos

Kind = Literal["lowpass", "highpass", "bandpass", "bandstop"]
Family = Literal["butter", "cheby1", "cheby2", "ellip", "bessel"]


def _scipy_signal() -> ModuleType:
    try:
        return importlib.import_module("scipy.signal")
    except ImportError as missing:
        raise CallerError(
            f"designing filters needs scipy: pip install 'aces-bus[filters]' ({missing}); without it there are LowPass, "
            "MovingAverage, Median, RateLimit, Kalman and Sos with coefficients of your own"
        ) from None


def _checked(cutoff_hz: float | tuple[float, float], rate_hz: float) -> None:
    each = cutoff_hz if isinstance(cutoff_hz, tuple) else (cutoff_hz,)
    if (
        not 0 < rate_hz < math.inf
        or not all(0 < frequency < rate_hz / 2 for frequency in each)
        or list(each) != sorted(set(each))
    ):
        raise StateError(
            f"a filter at {cutoff_hz} Hz for samples at {rate_hz} Hz: frequencies lie between 0 and half of the rate, "
            "two of them in rising order"
        )


def iir(
    order: int,
    cutoff_hz: float | tuple[float, float],
    rate_hz: float,
    *,
    kind: Kind = "lowpass",
    family: Family = "butter",
    ripple_db: float | None = None,
    attenuation_db: float | None = None,
    initial: Initial = "steady",
) -> Sos:
    """Return a filter of one of the classical families; Chebyshev I and elliptic need `ripple_db`, II and elliptic
    `attenuation_db`.
    """
    _checked(cutoff_hz, rate_hz)
    if not 1 <= order <= 32:
        raise StateError(f"a filter of order {order!r}: 1 … 32")
    try:
        rows = _scipy_signal().iirfilter(
            order,
            cutoff_hz,
            rp=ripple_db,
            rs=attenuation_db,
            btype=kind,
            ftype=family,
            output="sos",
            fs=rate_hz,
        )
    except ValueError as error:
        raise StateError(f"a filter ({family}, {kind}) cannot be designed: {error}") from None
    return Sos(tuple(map(tuple, rows.tolist())), rate_hz, initial)


def notch(frequency_hz: float, rate_hz: float, *, quality: float = 30.0, initial: Initial = "steady") -> Sos:
    """Design a filter that takes out one frequency; the notch is `frequency_hz` / `quality` wide at -3 dB."""
    _checked(frequency_hz, rate_hz)
    if not 0 < quality < math.inf:
        raise StateError(f"a notch of quality {quality!r}: > 0")
    over, under = _scipy_signal().iirnotch(frequency_hz, quality, fs=rate_hz)
    return Sos(((*over.tolist(), *under.tolist()),), rate_hz, initial)
