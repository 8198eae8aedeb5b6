"""The sample rate that a file states beside its table."""

import re
from collections.abc import Iterable

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
_VALUE = re.compile(r"([+-]?\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)\s*([^\s\d,;]*)")
_UNITS = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]|_(k?hz|m?s|us)$", re.IGNORECASE)
_HERTZ = {"": 1.0, "hz": 1.0, "khz": 1e3, "mhz": 1e6, "s/s": 1.0, "sps": 1.0, "ks/s": 1e3, "1/s": 1.0, "samples/s": 1.0}
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "µs": 1e-6, "us": 1e-6, "usec": 1e-6, "ns": 1e-9}
_LONGEST = 0.25  # s; an interval without a unit that is longer is one in ms


def stated_rate(facts: Iterable[tuple[str, str]]) -> float | None:
    """Return the sample rate in Hz that facts of a file state, each a name and a value; None where none does."""
    intervals: list[float] = []
    for name, value in facts:
        key = _UNITS.sub("", name).strip(" #%*:=")
        number = _VALUE.match(value.strip())
        if number is None or (not (is_rate := bool(_RATE.search(key))) and not _INTERVAL.search(key)):
            continue
        stated = _UNITS.search(name)
        unit = (number[2] or (stated[1] or stated[2] if stated else "")).strip("[]()").lower().replace("μ", "µ")
        factor = (_HERTZ if is_rate else _SECONDS).get(unit)
        size = float(number[1].replace(",", "."))
        if factor is None or not size > 0:
            continue
        if is_rate:
            return size * factor
        if unit or size <= _LONGEST:
            intervals.append(size * factor)
    return 1 / intervals[0] if intervals else None


def facts_of_lines(lines: Iterable[str]) -> Iterable[tuple[str, str]]:
    """Yield name and value of each line of text that holds both, such as ``Sampling Rate: 200``."""
    for line in lines:
        match = re.match(r"\W*([^:=;\t,]+?)\s*(?:[:=;\t,]+\s*|\s{2,})(.*)", line)
        if match:
            yield match[1], match[2].strip('"; \t')
