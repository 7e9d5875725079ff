"""Output on terminals that cannot show every letter: letters they lack are spelled in ASCII, without an error."""

from __future__ import annotations

import codecs
import sys
import unicodedata

#: The name under which Python knows how to spell what an encoding lacks.
SPELLED = "eos_pin.spelled"
_SPELLING = str.maketrans(
    {"…": "...", "→": "->", "←": "<-", "−": "-", "–": "-", "—": "-", "•": "*", "·": "*", "×": "x", "±": "+-", "≤": "<="}
    | {"≥": ">=", "√": "sqrt ", "∞": "inf", "°": " deg", "∂": "d", "∇": "grad ", "ᵀ": "T", "⁻": "-", "’": "'", "‘": "'"}
    | {"“": '"', "”": '"', "µ": "u", "μ": "mu", "Λ": "Lambda", "λ": "lambda", "σ": "sigma", "τ": "tau", "π": "pi"}
    | {"²": "^2", "³": "^3", "█": "#", "▏": "|", "✓": "yes", "✗": "no", "ß": "ss", "ø": "o", "Ø": "O", "æ": "ae"}
)


def spell(text: str) -> str:
    """The text in ASCII: marks and letters in their usual spelling, lines as -, | and +, the rest as code points."""
    return "".join(char if char.isascii() else _letter(char) for char in text.translate(_SPELLING))


def shown(text: str, encoding: str) -> str:
    """The text with letters that an encoding lacks spelled out; its length is that on the screen."""
    try:
        return text.encode(encoding, SPELLED).decode(encoding)
    except (LookupError, UnicodeError):
        return spell(text)


def spell_output() -> None:
    """Spell letters that the encodings of standard output and error lack, if these streams can be changed."""
    for stream in (sys.stdout, sys.stderr):
        if (reconfigure := getattr(stream, "reconfigure", None)) is not None:
            reconfigure(errors=SPELLED)


def _letter(char: str) -> str:
    name = unicodedata.name(char, "")
    if name.startswith("BOX DRAWINGS"):
        across, up = "HORIZONTAL" in name, "VERTICAL" in name
        corner = any(word in name.split() for word in ("UP", "DOWN", "LEFT", "RIGHT", "ARC", "DIAGONAL"))
        return "+" if corner or across == up else "-" if across else "|"
    bare = unicodedata.normalize("NFKD", char).encode("ascii", "ignore").decode()
    return bare or char.encode("ascii", "backslashreplace").decode()


def _is_byte(char: str) -> bool:
    return "\udc80" <= char <= "\udcff"


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    """Handler of letters that an encoding lacks."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    if any(map(_is_byte, text)) and not error.encoding.startswith(("utf-16", "utf-32")):
        # Bytes of a file name that are no letters pass as they came.
        parts = [c.encode("ascii", "surrogateescape") if _is_byte(c) else spell(c).encode() for c in text]
        return b"".join(parts), error.end
    return spell(text), error.end


codecs.register_error(SPELLED, _spelled)
