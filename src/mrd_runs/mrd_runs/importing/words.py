"""Words in the names of columns: which quantity they mean, and that a column is no measurement of it."""

import re
import unicodedata
from collections.abc import Mapping

from mrd_runs.importing.units import SYNONYMS

WORDS: Mapping[str, frozenset[str]] = {
    quantity: frozenset(words.split())
    for quantity, words in {
        "time": "time t timestamp elapsed zeit temps tiempo tempo",
        "position": "position pos displacement disp stroke travel extension x lvdt weg hub lage auslenkung verschiebung "
        "deplacement course posicion desplazamiento posicao deslocamento spostamento corsa",
        "velocity": "velocity vel speed v xdot geschwindigkeit vitesse velocidad velocidade velocita",
        "acceleration": "acceleration accel acc a beschleunigung aceleracion aceleracao accelerazione",
        "force": "force f load loadcell effort kraft fuerza forca forza",
        "current": " ".join(
            ["current curr cur i coil strom courant corriente corrente amperage", *SYNONYMS["current"].values()]
        ),
        "temperature": "temperature temp temperatur temperatura",
    }.items()
}
"""Words of each quantity: English, German, French, Spanish, Portuguese, Italian; without accents."""

ALL_WORDS = frozenset().union(*WORDS.values())
_COMPOUNDS = ("zeit", "weg", "hub", "geschwindigkeit", "beschleunigung", "kraft", "strom", "temperatur")  # Kolbenweg
_COMMANDED = (
    "set setpoint soll sollwert command commanded cmd target reference ref desired demand demanded nominal programmed "
    "consigne consigna"
)
_DERIVED = (
    "error err deviation abweichung fehler erreur desviacion peak max maximum min minimum mean avg average mittelwert rms "
    "std envelope limit offset tolerance"
)
_NO_MEASUREMENT = frozenset(f"{_COMMANDED} {_DERIVED}".split())
_OF_OTHERS: Mapping[str, frozenset[str]] = {
    quantity: frozenset(words.split())
    for quantity, words in {
        "current": "motor servo drive actuator antrieb moteur motore",
        "temperature": "motor servo drive ambient room air lab umgebung raum ambiante ambiente",
    }.items()
}
"""Words of what else on a rig has such a quantity: that of the damper is meant."""
_COMPRESSION = frozenset(
    {"compression", "compressive", "jounce", "bump", "einfederung", "druckkraft"}
    | {"compresion", "compressao", "compressione"}  # Spanish, Portuguese, Italian
)


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, without accents and numbers."""
    plain = "".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c)).replace("ß", "ss")
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", plain)]


def is_word_of(word: str, quantity: str) -> bool:
    """Return whether a word means a quantity, by itself or at the end of a German compound."""
    return word in WORDS[quantity] or any(word.endswith(end) for end in _COMPOUNDS if end in WORDS[quantity])


def names_quantity(text: str) -> bool:
    """Return whether a text has a word of any quantity."""
    return any(is_word_of(word, quantity) for word in words_of(text) for quantity in WORDS)


def is_measured(quantity: str, name: str) -> bool:
    """Return whether a name tells nothing against a measurement of a quantity of the damper."""
    return not set(words_of(name)) & (_NO_MEASUREMENT | _OF_OTHERS.get(quantity, frozenset()))


def names_compression(name: str) -> bool:
    """Return whether a name says that it counts compression."""
    return bool(_COMPRESSION & set(words_of(name)))
