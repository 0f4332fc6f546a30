"""The time that outputs note: the clock's, or one that the environment fixes, so that runs can give the same bytes."""

import os
from datetime import UTC, datetime

from planeopt.errors import InputError

_VARIABLE = "SOURCE_DATE_EPOCH"


def stated_time() -> datetime | None:
    """Return the time of SOURCE_DATE_EPOCH; None where it is not set.

    Raises
    ------
    InputError
        If the variable is no time.
    """
    return now() if os.environ.get(_VARIABLE, "").strip() else None


def now() -> datetime:
    """Return the time of SOURCE_DATE_EPOCH (reproducible-builds.org) where it is set, else the clock's.

    Raises
    ------
    InputError
        If the variable is no time.
    """
    epoch = os.environ.get(_VARIABLE, "").strip()
    if not epoch:
        return datetime.now(UTC)
    try:
        return datetime.fromtimestamp(int(epoch), UTC)
    except (ValueError, OverflowError, OSError) as error:
        wanted = "must be a whole number of seconds since 1970"
        raise InputError(f"the environment's {_VARIABLE} {wanted}, not {epoch!r}") from error
