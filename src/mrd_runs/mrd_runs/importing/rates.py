"""The sample rate that a file states beside its table."""

import re
from collections.abc import Iterable

from mrd_runs.validation import MEDIAN_INTERVALS

_RATE = re.compile(
    r"(sampl\w*|scan|abtast|acquisition|acq|data|erfassungs|mess|[eé]chantillonnage|muestreo|campionamento|amostragem|log\w*)"
    r"[\s_-]*(rate|freq\w*|frequenz)|(fr[eé]quence|frecuencia|frequenza|frequ[eê]ncia|tasa|taxa)\W.*"
    r"([eé]chantillonnage|muestreo|campionamento|amostragem)|^fs$|^samplerate$",
    re.IGNORECASE,
)
_INTERVAL = re.compile(
    r"(sampl\w*|scan|abtast|acquisition|acq|mess|log\w*)[\s_-]*(interval\w*|period\w*|time|zeit|step)"
    r"|^(dt|ts|delta_?[xt]|d_?t|x[\s_]?increment|(time[\s_])?increment|wf_increment|time[\s_]step)$",
    re.IGNORECASE,
)
_SPACES = " \u00a0\u202f"
# Not followed by further digits: a list of rates is none, nor is a number that is written in a way not known here.
_VALUE = re.compile(rf"([+-]?\d+(?:[.,'’{_SPACES}]\d+)*)([eE][+-]?\d+)?(?![.,{_SPACES}]*\d)\s*([^\s\d,;]*)")
_PLAIN = re.compile(r"[+-]?\d+([.,]\d+)?")
_GROUPED = re.compile(rf"\+?[1-9]\d{{0,2}}([.,'’{_SPACES}])\d{{3}}(\1\d{{3}})*((?!\1)[.,]\d+)?")
_UNITS = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]|_(k?hz|m?s|us)$", re.IGNORECASE)
_HERTZ = {"": 1.0, "hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "sps": 1.0, "ks/s": 1e3, "1/s": 1.0, "samples/s": 1.0}
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "µs": 1e-6, "us": 1e-6, "usec": 1e-6, "ns": 1e-9}
_LONGEST = 0.25  # s; an interval without a unit that is longer is one in ms


def stated_rate(facts: Iterable[tuple[str, str | float]]) -> float | None:
    """Return the sample rate in Hz that facts of a file state, each a name and a value; None where none does.

    A text such as ``10,000 Hz`` states none: it may be 10 Hz as well.
    """
    intervals: list[float] = []
    for name, value in facts:
        key = _UNITS.sub("", name).strip(" #%*:=")
        text = value.strip() if isinstance(value, str) else f"{value:.16e}"
        number = _VALUE.match(text)
        if number is None or (not (is_rate := bool(_RATE.search(key))) and not _INTERVAL.search(key)):
            continue
        stated = _UNITS.search(name)
        unit = (number[3] or (stated[1] or stated[2] if stated else "")).strip("[]()").lower().replace("μ", "µ")
        factor = (_HERTZ if is_rate else _SECONDS).get(unit)
        if factor is None:
            continue
        sizes = [size * factor for size in _readings(number[1], number[2] or "")]
        if len(sizes) > 1:
            shortest, longest = MEDIAN_INTERVALS
            sizes = [size for size in sizes if shortest <= (1 / size if is_rate else size) <= longest]
        if len(sizes) != 1 or not sizes[0] > 0:
            continue
        if is_rate:
            return sizes[0]
        if unit or sizes[0] <= _LONGEST:
            intervals.append(sizes[0])
    return 1 / intervals[0] if intervals else None


def _readings(digits: str, exponent: str) -> list[float]:
    """Return the numbers that digits may mean: in 10,000 the comma is a decimal sign, or it groups thousands."""
    readings = [float(digits.replace(",", ".") + exponent)] if _PLAIN.fullmatch(digits) else []
    if not exponent and (grouped := _GROUPED.fullmatch(digits)):
        decimals = grouped[3] or ""
        readings.append(float(re.sub(r"\D", "", digits.removesuffix(decimals)) + decimals.replace(",", ".")))
    return readings


def facts_of_lines(lines: Iterable[str]) -> Iterable[tuple[str, str]]:
    """Yield name and value of each line of text that holds both, such as ``Sampling Rate: 200``."""
    for line in lines:
        match = re.match(r"\W*([^:=;\t,]+?)\s*([:=;\t,]+\s*|\s{2,})(.*)", line)
        if match:
            # Where a comma stands between cells, one in a value does so too, unless it is quoted.
            value = match[3] if "," not in match[2] or match[3].startswith('"') else match[3].replace(",", ", ")
            yield match[1], value.strip('"; \t')
