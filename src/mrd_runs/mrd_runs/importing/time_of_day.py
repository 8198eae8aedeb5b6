"""Times of day as other programs write them, maybe with a date, an offset to UTC, or of twelve hours."""

import datetime
import re

_DATE = (
    r"(?:(?P<year>\d{4})[-/.](?P<month>\d\d?)[-/.](?P<day>\d\d?)[T ]\s*|(?P<dotted>\d\d?\.\d\d?\.\d{4})\s+"
    r"|(?P<other>\d\d?[./-]\d\d?[./-]\d{2,4})\s+)?"
)
_TIME = r"(?:(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d(?:[.,:]\d+)?)|(?P<only>\d{1,3}):(?P<rest>\d\d(?:[.,]\d+)?))"
_AFTER = r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?:(?P<sign>[+-])(?P<ahead>\d\d):?(?P<more>\d\d)?|Z|[A-Z]{2,5})?"
_CLOCK = re.compile(_DATE + _TIME + _AFTER, re.ASCII)
_COMPACT = re.compile(r"(\d{4})(\d\d)(\d\d)[T ](\d\d)(\d\d)(\d\d(?:[.,]\d+)?)", re.ASCII)
_NAMED = re.compile(r"(?:[A-Za-z]{2,9}\.?,?\s+)?(\d\d?)[-. ]+([A-Za-z]{3})[a-z]*\.?[-, ]+(\d{4})", re.ASCII)
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_FIRST_DAY = datetime.date(2000, 1, 1).toordinal()  # the nearer to now, the more digits are left for the seconds


def clock_seconds(text: str) -> float | None:
    """Return the seconds of a time of day, counted from the year 2000 where it has a date; None for another text.

    Of dates such as 03/04/2026 the order of day and month is not known: then the date does not count, and midnight
    shows as a jump back. ``12:34.5`` are minutes and seconds.
    """
    match = _match(text)
    if match is None:
        return None
    if match["only"]:
        return None if match["half"] else 60 * int(match["only"]) + float(match["rest"].replace(",", "."))
    hour = int(match["hour"])
    if match["half"]:
        hour = hour % 12 + (12 if match["half"][0] in "pP" else 0)
    second = float(match["second"].replace(",", ".").replace(":", "."))
    if match["second"].count(":"):  # the milliseconds of 12:00:00:05 are a number of their own
        whole, part = match["second"].split(":")
        second = int(whole) + 1e-3 * int(part)
    seconds = 3600 * hour + 60 * int(match["minute"]) + second
    if match["sign"]:
        offset = 3600 * int(match["ahead"]) + 60 * int(match["more"] or 0)
        seconds -= offset if match["sign"] == "+" else -offset
    if not (match["year"] or match["dotted"]):
        return seconds
    year, month, day = match.group("year", "month", "day") if match["year"] else reversed(match["dotted"].split("."))
    try:
        date = datetime.date(int(year), int(month), int(day))
    except ValueError:
        return None
    return 86400.0 * (date.toordinal() - _FIRST_DAY) + seconds


def has_date(text: str) -> bool:
    """Return whether a time of day has a date that counts."""
    match = _match(text)
    return match is not None and (match["year"] or match["dotted"]) is not None


def _match(text: str) -> re.Match[str] | None:
    """Return the parts of a time of day, also of those without marks or with the name of the month."""
    if named := _NAMED.match(text):
        month = named[2].lower()
        if month not in _MONTHS:
            return None
        text = f"{named[3]}-{_MONTHS.index(month) + 1}-{named[1]}{text[named.end() :]}"
    return _CLOCK.fullmatch(_COMPACT.sub(r"\1-\2-\3T\4:\5:\6", text))
