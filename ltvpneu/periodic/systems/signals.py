"""Signals given by name or by number."""

from collections.abc import Sequence


def signal_index(signals: Sequence[str], signal: str | int) -> int:
    """Return the row of a signal given by name or by number.

    Raises
    ------
    ValueError
        No signal has that name or number.
    """
    if isinstance(signal, str):
        if signal not in signals:
            raise ValueError(f"signal: found {signal!r}, expected one of {', '.join(signals)}")
        return list(signals).index(signal)
    if not 0 <= signal < len(signals):
        raise ValueError(f"signal: found {signal}, expected 0 to {len(signals) - 1} ({', '.join(signals)})")
    return int(signal)


def signals_chosen(kind: str, wanted: Sequence[str | int] | None, known: Sequence[str]) -> list[int]:
    """Return the numbers of signals given by name or number."""
    if wanted is None:
        return list(range(len(known)))
    if isinstance(wanted, str):
        raise ValueError(f"{kind}: found {wanted!r}, expected a list of names, such as [{wanted!r}]")
    found: list[int] = []
    for one in wanted:
        number = list(known).index(one) if isinstance(one, str) and one in known else one
        if isinstance(number, str) or not 0 <= number < len(known):
            raise ValueError(f"{kind}: found {one!r}, expected some of {', '.join(known) or 'none'}")
        found.append(int(number))
    if len(set(found)) < len(found):
        raise ValueError(f"{kind}: found {list(wanted)}, expected each once")
    return found
