"""How the values that stages leave are named: these names are stems of files."""

PLANT, RESPONSE, PREFERRED = "plant", "response", "preferred"


def paper(signal: str) -> str:
    """Return the name of the paper's structure fitted to a test signal."""
    return f"paper-{signal}"


def simulated(record: str) -> str:
    """Return the name of what models say to a record."""
    return f"simulated-{record}"


def sensitivity(controller: str, unit: str) -> str:
    """Return the name of the sensitivity matrix measured on a unit."""
    return f"{controller}-{unit}-sensitivity"


def weight(controller: str, function: str) -> str:
    """Return the name of what a design's cost puts on S, T or KS; no controller's own has a plus sign."""
    return f"{controller}+weight-{function}"


def under_tone(controller: str, tone_hz: float) -> str:
    """Return the name of the record of a closed loop under a tone."""
    return f"{controller}-{tone_hz:g}hz"


def open_under_tone(controller: str, tone_hz: float) -> str:
    """Return the name of the record of the open loop under a tone, as it was when the controller was measured.

    Each controller has its own: a bench with noise answers otherwise each time, and facts are those of one answer.
    """
    return f"{under_tone(controller, tone_hz)}-open"
